"""The faults that are put into running bakes, what must come of each, and the tests that do it: the table in docs/reliability.md."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from tables import Table


@dataclass(frozen=True)
class Fault:
    """What happens, when, what must come of it, and the test, as file::name below tests/."""

    what: str
    when: str
    outcome: str
    test: str


STAGES = {  # line on the command line with which it begins
    "reading": "Reading the scene",
    "unwrapping": "Unwrapping",
    "measuring": "Measuring texels",
    "ray tracer": "Preparing the scene for rays",
    "contacts": "Looking for contacts",
    "photons": "Tracing photons",
    "writing": "Writing images",
}
_EVERY = ", ".join(STAGES)
_NOTHING = "a sentence; no file is left, the scene is as it was, the next bake works"
_FAULTS = "blender/test_faults.py"

FAULTS = (
    Fault("the baking process is killed", _EVERY, _NOTHING, f"{_FAULTS}::test_the_baking_process_is_killed"),
    Fault(
        "a worker is killed", _EVERY, "a sentence, or another takes its place; the next bake works", f"{_FAULTS}::test_a_worker_is_killed"
    ),
    Fault("the unwrapping process is killed", "reading", "another takes its place", f"{_FAULTS}::test_the_unwrapping_process_is_killed"),
    Fault("Blender is killed", "unwrapping, photons", "no process and no temporary file is left", f"{_FAULTS}::test_blender_is_killed"),
    Fault("Blender crashes over a file", "opening", "a sentence, exit code 1", "unit/test_watched.py::test_a_crash_is_a_sentence"),
    Fault(
        "SIGINT and SIGTERM",
        _EVERY,
        "exit code 130; whole images of the light so far, or none; the next bake works",
        f"{_FAULTS}::test_a_signal_at_each_stage",
    ),
    Fault("SIGINT and SIGTERM", "Blender starts", "exit code 130", "blender/test_cli.py::test_a_signal_while_blender_starts_is_kept"),
    Fault(
        "the disk is full",
        "each write that is larger than 1 kB to 1 MB",
        "a sentence; files are whole or not there; earlier ones stay",
        f"{_FAULTS}::test_the_disk_is_full",
    ),
    Fault(
        "the disk of one write is full",
        "images, state, report, .glb, .blend, temporary files; with 0 to 200 kB left",
        "a sentence, before the bake if it can be known; all else is written",
        f"{_FAULTS}::test_the_disk_of_one_write_is_full",
    ),
    Fault("the disk is full", "images", "the earlier image stays whole", "blender/test_cli_bad_input.py::test_full_disk"),
    Fault("the disk is full", "state", "a sentence, and no half state", "unit/test_checkpoint.py::test_a_full_disk_leaves_no_half_state"),
    Fault(
        "images cannot be written",
        "writing",
        "they are kept in another folder, which is named",
        "blender/test_cli_bad_input.py::test_images_that_cannot_be_written_are_kept_elsewhere",
    ),
    Fault("the output folder is deleted", "unwrapping, photons", "it is made again", f"{_FAULTS}::test_the_output_folder_is_deleted"),
    Fault("out of memory", "four limits from 500 MB", "a sentence", "blender/test_errors.py::test_child_out_of_memory"),
    Fault("the clock jumps", "any", "nothing: no time of day is read", f"{_FAULTS}::test_no_time_of_day_is_read"),
    Fault("another .blend is opened", "photons", "the bake ends; the next one works", f"{_FAULTS}::test_another_file_is_opened"),
    Fault("the scene is deleted", "photons", "a sentence; the images are written", f"{_FAULTS}::test_the_scene_is_deleted"),
    Fault(
        "the extension is disabled and enabled",
        "photons",
        "the bake ends with its workers; the next one works",
        f"{_FAULTS}::test_the_extension_is_disabled_and_enabled",
    ),
    Fault(
        "the extension is updated",
        "photons",
        "the bake ends with its workers; objects wear their own materials; the next bake works",
        f"{_FAULTS}::test_the_extension_is_updated",
    ),
    Fault(
        "Ctrl+Z",
        "photons; over earlier bakes or none; then done or discarded",
        "the step is undone, the light comes back; nothing is lost, the next bake works",
        f"{_FAULTS}::test_a_step_is_undone_while_a_bake_runs",
    ),
    Fault("two Blenders bake into one folder", "all", "both end well; the images are whole", f"{_FAULTS}::test_two_bakes_into_one_folder"),
)


NOT_RUN = "not run"
_RESULT = re.compile(r"\| `(\S+::\w+)` \| ([^|]+) \|$", re.MULTILINE)


def tabulate_faults(results: Mapping[str, str]) -> Table:
    """As docs/reliability.md has it; `results` by test."""
    rows = [[one.what, one.when, one.outcome, f"`{one.test}`", results.get(one.test, NOT_RUN)] for one in FAULTS]
    return Table(["fault", "when", "what comes of it", "test", "passed, and when it was run"], rows)


def read_results(page: str) -> dict[str, str]:
    """Those that stand in the page."""
    return dict(_RESULT.findall(page))
