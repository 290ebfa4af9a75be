"""Words for people, and messages between processes: lines of the terminal, sentences of the panel, numbers as they are written."""

import math
from pathlib import Path

import pytest
from leaflight.addon.app.console import describe_files, describe_miss, describe_progress, print_message
from leaflight.addon.app.quantities import read_count, read_duration, read_number, write_count, write_duration
from leaflight.addon.show.bake_text import describe_error
from leaflight.core.util.messages import Done, Error, Preview, Progress, Status, Warning_, decode_message, encode_message
from leaflight.core.util.user_text import Sentence, begin_line, group_warnings, match_name, split_error, write_sentence

# What a person at the terminal sees.
PROGRESS = Progress(fraction=0.25, photons=1_500_000, photons_per_s=2.5e6, estimated_error=0.043, seconds_left=12.4, leaves=900)


@pytest.mark.parametrize(
    ("message", "line", "quiet_line"),
    [
        (Status("charts", "Unwrapping"), "leaflight: Unwrapping\n", ""),
        (PROGRESS, "leaflight:  25%  1.50 M photons  2.50 M/s  error 4.3%  12 s left\n", ""),
        (Warning_("Lamp", "has no power"), *["leaflight: warning: Lamp: has no power\n"] * 2),
        (Warning_("Lamp", "Lamp: has no power"), *["leaflight: warning: Lamp: has no power\n"] * 2),
        (Warning_("is", "is linked"), *["leaflight: warning: is: is linked\n"] * 2),
        (Warning_("", "the scene is dark"), *["leaflight: warning: the scene is dark\n"] * 2),
        (Error("nothing to bake."), *["leaflight: error: nothing to bake.\n"] * 2),
        (Preview(0, "page.npy"), "", ""),
        (Done("result.json", False), "", ""),
    ],
)
def test_each_message_has_its_line_on_standard_error(message, line, quiet_line, capsys):
    print_message(message, quiet=False)
    assert capsys.readouterr() == ("", line)
    print_message(message, quiet=True)
    assert capsys.readouterr() == ("", quiet_line)


def test_names_of_several_lines_and_codes_of_terminals_stay_on_one_line(capsys):
    """Quotes, accents and other scripts are as they are."""
    print_message(Error("a\nleaflight: done\x1b[2J\u202e: 'ä' 灯 is \"no\" mesh."), quiet=True)
    assert capsys.readouterr().err == "leaflight: error: a\\nleaflight: done\\x1b[2J\\u202e: 'ä' 灯 is \"no\" mesh.\n"


def test_images_are_counted_named_and_placed():
    paths = [str(Path("maps", "baked") / f"room_{page}.exr") for page in range(5)]
    folder = Path("maps", "baked")
    assert describe_files(paths[:1]) == f"1 image in {folder}: room_0.exr"
    assert describe_files(paths[:3]) == f"3 images in {folder}: room_0.exr, room_1.exr, room_2.exr"
    assert describe_files(paths) == f"5 images in {folder}: room_0.exr, room_1.exr, room_2.exr and 2 more"


def test_what_cannot_be_told_yet_is_left_out():
    unknown = Progress(0.0, 0, 0.0, estimated_error=math.nan, seconds_left=math.nan, leaves=0)
    assert describe_progress(unknown) == "  0%  0.00 M photons  0.00 M/s"


@pytest.mark.parametrize(
    ("stopped_by", "error", "asked", "sentence"),
    [
        ("error", 0.008, 0.008, ""),
        ("interrupted", 0.5, 0.008, ""),
        ("max_photons", 0.007, 0.008, ""),
        (
            "time_limit",
            0.05001,
            0.05,
            "stopped at --time-limit with an error of 5.001 %, where 5 % was asked for; raise --time-limit or --error",
        ),
        (
            "time_limit",
            math.nan,
            0.05,
            "stopped at --time-limit before its error could be told, where 5 % was asked for; raise --time-limit or --error",
        ),
        (
            "max_rays",
            0.02,
            0.01,
            "stopped at the most shadow rays that a texel takes with an error of 2 %, where 1 % was asked for; raise --error",
        ),
    ],
)
def test_a_bake_that_missed_its_error_says_so(stopped_by, error, asked, sentence):
    assert describe_miss(stopped_by, error, asked) == sentence


def row(name, error, texels=900, lighting=1.0):
    return {"name": name, "estimated_error": error, "texels": texels, "lighting": lighting}


ROWS = [row("Hall", 0.01), row("Den", 0.344), row("Pin", None)]
CELLAR = row("Cellar", 1.05, lighting=0.005)


@pytest.mark.parametrize(
    ("error", "error_of", "rows", "lines"),
    [
        (0.021, "bake", ROWS, ["Error 2.1 %", "Worst object: Den, 34 %"]),
        (0.35, "bake", ROWS, ["Error 35.0 %"]),
        (0.021, "bake", ROWS[2:], ["Error 2.1 %"]),
        (0.021, "objects", ROWS, ["Error 2.1 %, of the worst object", "Worst object: Den"]),
        (0.021, "objects", ROWS[2:], ["Error 2.1 %, of the worst object"]),
        # An error of what is nearly black is seen less: a cellar with a hundredth of the mean light
        (0.021, "bake", [*ROWS, CELLAR], ["Error 2.1 %", "Worst object: Den, 34 %"]),
        (0.021, "bake", [ROWS[0], CELLAR], ["Error 2.1 %", "Worst object: Cellar, 105 % (nearly black)"]),
        (0.11, "bake", [ROWS[0], CELLAR], ["Error 11.0 %"]),
        (1.05, "objects", [*ROWS, CELLAR], ["Error 105.0 %, of the worst object", "Worst object: Cellar (nearly black)"]),
        (0.021, "bake", [*ROWS, row("Nail", 0.5, texels=40)], ["Error 2.1 %", "Worst object: Nail, 50 % (only 40 texels)"]),
        (0.021, "bake", [row("Hall", 0.3, lighting=0.0)], ["Error 2.1 %", "Worst object: Hall, 30 %"]),
    ],
)
def test_the_object_that_errs_most_is_named_where_it_errs_more_than_the_whole(error, error_of, rows, lines):
    assert describe_error({"estimated_error": error, "error_of": error_of, "objects": rows}) == lines


def test_an_error_that_is_not_known_is_no_number():
    assert describe_error({"estimated_error": math.nan, "error_of": "bake", "objects": []}) == ["Error not known"]


# Sentences of the panel and what each is about.
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


# Numbers as people write them.
@pytest.mark.parametrize(
    ("count", "text"), [(64_000_000, "64 M"), (1_500_000, "1.5 M"), (1000, "1 k"), (10**12, "1000 G"), (1_234_567, "1,234,567")]
)
def test_counts_are_written_short_and_read_again(count, text):
    assert write_count(count) == text
    assert read_count(text) == count


@pytest.mark.parametrize(("text", "count"), [("64m", 64_000_000), ("2e6", 2_000_000), ("1,000", 1000), (" 3.5 M photons ", 3_500_000)])
def test_counts_may_be_written_in_many_ways(text, count):
    assert read_count(text) == count


@pytest.mark.parametrize("text", ["", "many", "-5", "64 Q", "1e999", "0x10", "5 M M"])
def test_what_is_no_count_is_none(text):
    assert read_count(text) is None


@pytest.mark.parametrize(("seconds", "text"), [(90.0, "1.5 min"), (45.0, "45 s"), (3600.0, "1 h"), (61.0, "61 s")])
def test_durations_are_written_and_read_again(seconds, text):
    assert write_duration(seconds) == text
    assert read_duration(text) == seconds


@pytest.mark.parametrize(("text", "seconds"), [("90", 90.0), ("5min", 300.0), ("2:30", 150.0), ("1:00:05", 3605.0), ("1.5 H", 5400.0)])
def test_durations_may_be_written_in_many_ways(text, seconds):
    assert read_duration(text) == seconds


@pytest.mark.parametrize("text", ["", "soon", "-5", "5 weeks", "1:2:3:4"])
def test_what_is_no_duration_is_none(text):
    assert read_duration(text) is None


def test_plain_numbers():
    assert (read_number("12.5"), read_number(" 1e3 "), read_number("twelve")) == (12.5, 1000.0, None)


# Each kind of message is one line there and the same object back.
MESSAGES = {
    "STATUS": Status("charts", "Unwrapping, 37%: Floor", 0.37),
    "PROGRESS": Progress(0.25, 65_536, 1e6, 0.071, 12.5, 300),
    "PREVIEW": Preview(2, "/a folder/page 2.npy"),
    "WARNING": Warning_("Lampe \u00e4\u4e2d", 'two lines\nand "quotes"'),
    "ERROR": Error("Table: has no faces; add some."),
    "DONE": Done("C:\\temp\\result.json", True),
}


@pytest.mark.parametrize(("kind", "message"), MESSAGES.items(), ids=MESSAGES)
def test_round_trip(kind, message):
    line = encode_message(message)
    assert "\n" not in line
    assert f'"kind": "{kind}"' in line
    assert decode_message(line + "\n") == message


def test_numbers_that_cannot_be_told_stay_nan():
    back = decode_message(encode_message(Progress(0.0, 0, 0.0, math.nan, math.nan, 0)))
    assert math.isnan(back.estimated_error)
    assert math.isnan(back.seconds_left)


@pytest.mark.parametrize(
    "line",
    [
        "",
        "Blender 5.0.1 (hash 1234)",
        "[]",
        "null",
        '{"text": "no kind"}',
        '{"kind": "WARN", "subject": "", "text": ""}',
        '{"kind": "ERROR"}',
        '{"kind": "ERROR", "text": "", "more": 1}',
        '{"kind": "DONE", "result": "x", ',
        '{"kind": ["ERROR"], "text": ""}',
    ],
)
def test_another_line_is_refused_and_named(line):
    with pytest.raises(ValueError, match="not a Leaflight message") as caught:
        decode_message(line)
    assert line[:20] in str(caught.value).encode().decode("unicode_escape")
