"""Sentences of the panel and what each is about."""

import pytest
from leaflight.core.told import Told, group_warnings, match_name, split_error


def test_warnings_about_many_objects_are_one_sentence():
    told = [("A", "has no faces"), *((name, f"{name}: is too small.") for name in "ABCDEA"), ("", "the sky is dark.")]
    assert group_warnings(told) == [
        Told(("A",), "A: has no faces"),
        Told(("A", "B", "C", "D", "E"), "A, B, C and 2 more: is too small."),
        Told((), "the sky is dark."),
    ]


def test_an_error_names_its_subject_before_the_colon():
    known = {"Wall", "Wall: left", "nothing"}.__contains__
    assert split_error("Wall: is odd; mend it.", known) == Told(("Wall",), "Wall: is odd; mend it.")
    assert split_error("Wall: left: is odd: mend it.", known).names == ("Wall: left",)
    assert split_error("Roof: is odd; mend it.", known).names == ()
    assert split_error("All is dark.", known) == Told((), "All is dark.")


@pytest.mark.parametrize(
    ("subject", "name"), [("Chair", "Chair"), ("Chair.001", "Chair.001"), ("Row.Chair.002", "Row"), ("Table", ""), ("Row.", "Row")]
)
def test_instances_are_named_after_what_makes_them(subject, name):
    assert match_name(subject, {"Chair", "Chair.001", "Row"}) == name
