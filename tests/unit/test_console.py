"""What a person at the terminal sees."""

import math
from pathlib import Path

import pytest
from leaflight.addon.app.console import describe_files, describe_miss, describe_progress, print_message
from leaflight.addon.show.bake_text import describe_error
from leaflight.core.util.messages import Done, Error, Preview, Progress, Status, Warning_

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
