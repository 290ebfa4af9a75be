"""Every knob has help and a range, and keeps it."""

import dataclasses
import math

import pytest
from leaflight.core.util.settings import Settings

KNOBS = dataclasses.fields(Settings)
RANGED = [knob for knob in KNOBS if knob.metadata["low"] is not None]
CHOSEN = [knob for knob in KNOBS if knob.metadata["choices"]]


def by_name(knobs):
    return pytest.mark.parametrize("knob", knobs, ids=[knob.name for knob in knobs])


@by_name(KNOBS)
def test_knob_has_help_and_a_rule(knob):
    assert knob.metadata["help"]
    about = knob.metadata
    assert isinstance(knob.default, bool) or knob in RANGED or knob in CHOSEN or about["find_error"] or about["metavar"] == "ADDRESS"


@by_name(RANGED)
def test_ends_of_a_range_are_allowed(knob):
    for end in ("low", "high"):
        value = type(knob.default)(knob.metadata[end])
        assert getattr(Settings(**{knob.name: value}), knob.name) == value


@by_name(RANGED)
def test_beyond_the_range_is_a_sentence(knob):
    low, high, unit = (knob.metadata[name] for name in ("low", "high", "unit"))
    for value in (low - 1, high + 1, high * 2 + 1):
        with pytest.raises(ValueError, match=knob.name) as caught:
            Settings(**{knob.name: type(knob.default)(value)})
        assert str(caught.value) == f"{knob.name}: expected {low:g} to {high:g}{' ' * bool(unit)}{unit}, got {value:g}"


@by_name([knob for knob in RANGED if isinstance(knob.default, float)])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_no_number_is_refused(knob, value):
    with pytest.raises(ValueError, match=f"^{knob.name}: "):
        Settings(**{knob.name: value})


@by_name(CHOSEN)
def test_choices_are_kept(knob):
    choices = knob.metadata["choices"]
    many = isinstance(knob.default, tuple)
    for choice in choices:
        Settings(**{knob.name: (choice,) if many else choice})
    with pytest.raises(ValueError, match=f"^{knob.name}: expected one of ") as caught:
        Settings(**{knob.name: (choices[0], "odd") if many else "odd"})
    assert str(caught.value) == f"{knob.name}: expected one of {', '.join(choices)}, got 'odd'"


@pytest.mark.parametrize("value", ["combined", (), ["combined"]])
def test_a_list_of_passes_is_a_tuple_with_something_in_it(value):
    with pytest.raises(ValueError, match="passes: expected at least one of combined"):
        Settings(passes=value)


def test_a_pattern_of_names_is_checked():
    assert Settings(name_pattern="{page}").name_pattern == "{page}"
    with pytest.raises(ValueError, match=r"^name_pattern: expected no other fields than .*, got '{size}'$"):
        Settings(name_pattern="{size}")
    with pytest.raises(ValueError, match=r"^name_pattern: expected {pass} in it, for there are 2 passes, got '{name}'$"):
        Settings(name_pattern="{name}", passes=("combined", "albedo"))
