"""Sentences of the panel and what each is about."""

import pytest
from leaflight.core.util.user_text import Sentence, begin_line, group_warnings, match_name, split_error, write_sentence


def test_warnings_about_many_objects_are_one_sentence():
    told = [("A", "has no faces"), *((name, f"{name}: is too small.") for name in "ABCDEA"), ("", "the sky is dark.")]
    assert group_warnings(told) == [
        Sentence(("A",), "A: has no faces"),
        Sentence(("A", "B", "C", "D", "E"), "A, B, C and 2 more: each is too small."),
        Sentence((), "the sky is dark."),
    ]


@pytest.mark.parametrize(
    ("one", "many"),
    [
        ("has 8 UV layers; remove one to give it a lightmap", "each has 8 UV layers; remove one to give it a lightmap"),
        ("was deleted during the bake", "each was deleted during the bake"),
        ("casts no shadow", "each casts no shadow"),
        ("does not fit a page", "each does not fit a page"),
        ("its mesh is linked, so it shows its copy", "each one's mesh is linked, so it shows its copy"),
        ("half of its charts are smaller than a texel", "half of each one's charts are smaller than a texel"),
        ("no face is within limits", "no face is within limits"),
    ],
)
def test_a_sentence_is_right_about_one_and_about_many(one, many):
    assert write_sentence(["A", "A"], one).text == f"A: {one}"
    assert write_sentence(["A", "B"], one).text == f"A, B: {many}"


def test_an_error_names_its_subject_before_the_colon():
    known = {"Wall", "Wall: left", "nothing"}.__contains__
    assert split_error("Wall: is odd; mend it.", known) == Sentence(("Wall",), "Wall: is odd; mend it.")
    assert split_error("Wall: left: is odd: mend it.", known).names == ("Wall: left",)
    assert split_error("Roof: is odd; mend it.", known).names == ()
    assert split_error("All is dark.", known) == Sentence((), "All is dark.")


def test_a_line_begins_with_a_capital_letter_or_with_a_name_as_it_is():
    assert begin_line("the scene has no light") == "The scene has no light"
    assert begin_line("lamp: is dark", ["lamp"]) == "lamp: is dark"
    assert begin_line("each lamp is dark", ["lamp"]) == "Each lamp is dark"
    assert begin_line("") == ""


@pytest.mark.parametrize(
    ("subject", "name"), [("Chair", "Chair"), ("Chair.001", "Chair.001"), ("Row.Chair.002", "Row"), ("Table", ""), ("Row.", "Row")]
)
def test_instances_are_named_after_what_makes_them(subject, name):
    assert match_name(subject, {"Chair", "Chair.001", "Row"}) == name


def test_fifty_warnings_that_differ_by_numbers_are_one_line():
    told = group_warnings((f"Metal {number}", f"its metallic reflection ({number}%) is left out") for number in range(50))
    assert [one.text for one in told] == [
        "Metal 0, Metal 1, Metal 2 and 47 more: each one's metallic reflection (0%) is left out (numbers of Metal 0)"
    ]
    assert len(told[0].names) == 50
    assert len(group_warnings([("", "has room for 3 MB"), ("", "has room for 4 MB")])) == 2  # of the scene: each says something
