"""Faults in running bakes: nothing is lost, there is a sentence, and the next bake works. tests/fuzz/fault_rows.py lists them all."""

import contextlib
import importlib.util
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import leaflight
from blend_rooms import ask_quick_bake, bake, list_files, open_room, read_pixels, save_scene
from fault_rows import FAULTS, NOT_RUN, STAGES, read_results, tabulate_faults
from fuzz_judge import MARK, find_left
from leaflight.addon.ui import baking
from tables import put_tables

TESTS = Path(__file__).resolve().parents[1]
IMAGE = "room_0.combined.exr"
HANGS_S = 600.0  # an end is long overdue then, also beside others' work
ENDLESS = ("--error", "0.0001", "--max-photons", "1000000000000")
SHORT = ("--error", "0.005", "--max-photons", "200000")
on_linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are found in /proc")


@pytest.fixture
def room(tmp_path):
    open_room()
    (tmp_path / "tmp").mkdir()
    return save_scene(tmp_path / "room.blend")


def start_bake(room, *words, temporary=None, **options):
    """The command line in a process of its own, with its own temporary folder and a mark that its processes inherit."""
    argv = [sys.executable, "-m", "leaflight", "bake", str(room), "--size", "64", "--workers", "2", "--output", "maps", *words]
    # Python leaves a .pyc cut off where the disk is full.
    env = os.environ | {"TMPDIR": str(temporary or room.parent / "tmp"), MARK: str(room), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.Popen(argv, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, encoding="utf-8", cwd=room.parent, env=env, **options)


def wait_for(process, text):
    """Reads what is printed until a line has the text."""
    read = []
    for line in process.stderr:
        read.append(line)
        if text in line:
            return
    pytest.fail(f"{text!r} never came: {read}")


def end_of(process):
    """Exit code, and the sentences of errors."""
    told = process.communicate(timeout=HANGS_S)[1]
    assert "Traceback" not in told
    return process.returncode, [line.removeprefix("leaflight: error: ") for line in told.splitlines() if "error: " in line]


def list_children(pid):
    """(process, command line) of all below this one."""
    found = []
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            found.append((int(child), Path(f"/proc/{child}/cmdline").read_bytes().replace(b"\0", b" ").decode()))
            found += list_children(int(child))
    return found


def find_baking(process):
    return next(pid for pid, words in list_children(process.pid) if "boot.py" in words)


def hold_aftermath(room, before):
    """Nobody runs any more, nothing half lies about, the scene is as it was, and a bake works."""
    assert find_left(str(room)) == []
    assert [path.name for path in (room.parent / "tmp").iterdir() if not path.name.startswith("blender_")] == []  # that is Blender's own
    assert not [path for path in room.parent.rglob("*") if ".part" in path.name]
    assert room.read_bytes() == before
    assert bake(room, "--quiet") == 0
    assert np.isfinite(read_pixels(room.parent / "maps" / IMAGE)).all()


def at_stages(*everyday):
    """Each stage; those that are not named are slow tests."""
    return pytest.mark.parametrize(
        "stage", [stage if stage in everyday else pytest.param(stage, marks=pytest.mark.slow) for stage in STAGES]
    )


@on_linux
@at_stages("photons")
def test_the_baking_process_is_killed(room, stage):
    before = room.read_bytes()
    process = start_bake(room, *(SHORT if stage == "writing" else ENDLESS), "--keep", "state", "--save", "saved.blend")
    wait_for(process, STAGES[stage])
    os.kill(find_baking(process), signal.SIGKILL)
    code, told = end_of(process)
    if stage != "writing" or code:  # which may be over before it is killed
        assert code == 1
        assert told[0].startswith(
            "The baking process was killed, most likely for lack of memory: choose a smaller page size or fewer processes."
        )
        assert not (room.parent / "saved.blend").exists()
    hold_aftermath(room, before)


@on_linux
@at_stages()
def test_a_worker_is_killed(room, stage):
    """They are copies of the baking process, there from its first stage on. Before there is work for them another one takes the place."""
    before = room.read_bytes()
    process = start_bake(room, *(ENDLESS if stage == "photons" else SHORT))
    wait_for(process, STAGES[stage])
    baking_pid, limit, workers = find_baking(process), time.monotonic() + 20, []
    while not workers and time.monotonic() < limit and process.poll() is None:
        workers = [pid for pid, words in list_children(baking_pid) if "boot.py" in words or "spawn_main" in words]
    for pid in workers:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    code, told = end_of(process)
    assert code in ((1,) if stage == "photons" else (0, 1))
    assert [text.partition(":")[0] for text in told] == ["A worker of the bake was killed, most likely for lack of memory"] * code
    hold_aftermath(room, before)


@on_linux
@pytest.mark.slow
def test_the_unwrapping_process_is_killed(room):
    before = room.read_bytes()
    process = start_bake(room, *SHORT)
    wait_for(process, STAGES["reading"])
    baking_pid, limit, unwrapping = find_baking(process), time.monotonic() + 20, []
    while not unwrapping and time.monotonic() < limit and process.poll() is None:
        unwrapping = [pid for pid, words in list_children(baking_pid) if "xatlas_process" in words]
    os.kill(unwrapping[0], signal.SIGKILL)
    assert end_of(process) == (0, [])
    hold_aftermath(room, before)


@on_linux
@pytest.mark.slow
@pytest.mark.parametrize("stage", ["unwrapping", "photons"])
def test_blender_is_killed(room, stage):
    before = room.read_bytes()
    process = start_bake(room, *ENDLESS)
    wait_for(process, STAGES[stage])
    process.kill()
    process.communicate(timeout=60)
    hold_aftermath(room, before)


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@at_stages()  # of the everyday tests test_cli has signals
def test_a_signal_at_each_stage(room, stage, number):
    before = room.read_bytes()
    process = start_bake(room, *(SHORT if stage == "writing" else ENDLESS))
    wait_for(process, STAGES[stage])
    process.send_signal(number)
    code, _ = end_of(process)
    assert code == 130 or (stage == "writing" and code == 0)
    images = list_files(room.parent / "maps")
    assert images in ([], [IMAGE])
    for name in images:
        assert np.isfinite(read_pixels(room.parent / "maps" / name)).all()
    hold_aftermath(room, before)


@pytest.mark.slow  # of the everyday tests test_cli_bad_input.test_full_disk has a full disk
@pytest.mark.parametrize("most_bytes", [100_000, 1000, 3000, 10_000, 30_000, 300_000, 1_000_000])
def test_the_disk_is_full(room, most_bytes):
    """On a system where no file grows beyond this; everything that can be written is asked for, over earlier files."""
    resource = pytest.importorskip("resource")
    before = room.read_bytes()
    words = (*SHORT, "--size", "256", "--keep", "state", "--save", "saved.blend", "--gltf", "scene.glb", "--report", "report.json")
    words += ("--pass", "combined", "stderr", "--format", "exr", "png")
    if most_bytes == 100_000:
        assert end_of(start_bake(room, *words)) == (0, [])
    earlier = {path: path.read_bytes() for path in (room.parent / "maps").glob("*.exr")}

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))

    code, told = end_of(start_bake(room, *words, "--force", preexec_fn=limit))
    assert code in (0, 1)
    assert (code == 1) == bool(told)
    assert all(re.search(r"room|written|kept|save", sentence) for sentence in told), told
    for path in (room.parent / "maps").glob("*.*r"):
        assert path.read_bytes() == earlier.get(path) or np.isfinite(read_pixels(path)).all()
    for spare in (room.parent / "tmp").glob("leaflight_images_*"):  # named in a sentence, and ours to take away here
        shutil.rmtree(spare)
    hold_aftermath(room, before)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of its own of 8 MB, where the system lets us have one; free(count) leaves so many bytes of it."""
    place = tmp_path / "small"
    place.mkdir()
    if not shutil.which("mount") or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", place], check=False).returncode:
        pytest.skip("mounting a file system is not allowed here")  # it takes root; no other disk can be filled without harm

    def free(count):
        (place / "filler").write_bytes(bytes(max(shutil.disk_usage(place).free - count, 0)))

    yield place, free
    subprocess.run(["umount", "--lazy", place], check=True)


WRITES = {  # what is on the small disk, and the words that have it written
    "images": ("--output", "small/maps", "--pass", "combined", "stderr", "--format", "exr", "png"),
    "state": ("--keep", "small/state"),
    "report": ("--report", "small/report.json"),
    "glb": ("--gltf", "small/scene.glb"),
    "blend": ("--save", "small/saved.blend"),
    "temporary files": (),
}


@on_linux
@pytest.mark.slow
@pytest.mark.parametrize("free_bytes", [0, 20_000, 200_000])
@pytest.mark.parametrize("what", WRITES)
def test_the_disk_of_one_write_is_full(room, small_disk, what, free_bytes):
    """All else is written; nothing half stays, and the scene is as it was."""
    place, free = small_disk
    before = room.read_bytes()
    free(free_bytes)
    words = (*SHORT, "--size", "256", *WRITES[what])
    process = start_bake(room, *words, **({"temporary": place} if what == "temporary files" else {}))
    code, told = end_of(process)
    assert code in (0, 1)
    assert (code == 1) == bool(told)
    assert all(re.search(r"room|written|kept|save", sentence) for sentence in told), told
    if what not in ("images", "temporary files") and free_bytes:  # a disk without any room is found before the bake
        assert np.isfinite(read_pixels(room.parent / "maps" / IMAGE)).all()
    for path in place.rglob("*.exr"):
        assert np.isfinite(read_pixels(path)).all()
    (place / "filler").unlink()
    for spare in (room.parent / "tmp").glob("leaflight_images_*"):  # named in a sentence, and ours to take away here
        assert np.isfinite(read_pixels(spare / IMAGE)).all()
        shutil.rmtree(spare)
    assert [path.name for path in place.iterdir() if path.name.startswith("leaflight_")] == []
    hold_aftermath(room, before)
    assert end_of(start_bake(room, *words)) == (0, [])


@pytest.mark.parametrize("stage", [pytest.param("unwrapping", marks=pytest.mark.slow), "photons"])
def test_the_output_folder_is_deleted(room, stage):
    before = room.read_bytes()
    process = start_bake(room, *SHORT, "--save", "saved.blend")
    wait_for(process, STAGES[stage])
    shutil.rmtree(room.parent / "maps")
    assert end_of(process) == (0, [])
    assert list_files(room.parent / "maps") == [".leaflight_pages", IMAGE] or IMAGE in list_files(room.parent / "maps")
    hold_aftermath(room, before)


def test_no_time_of_day_is_read():
    """Durations come from a clock that nobody can set."""
    sources = [path for folder in ("core", "addon") for path in (TESTS.parent / folder).rglob("*.py")]
    assert len(sources) > 100
    pattern = re.compile(r"time\.time\(|time\.localtime|time\.gmtime|datetime")
    assert [path.name for path in sources if pattern.search(path.read_text(encoding="utf-8"))] == []


def test_two_bakes_into_one_folder(room):
    processes = [start_bake(room, *SHORT, "--workers", "1", "--error", "0.05", "--seed", seed) for seed in ("1", "2")]
    assert [end_of(process) for process in processes] == [(0, [])] * 2
    assert np.isfinite(read_pixels(room.parent / "maps" / IMAGE)).all()
    assert list_files(room.parent / "maps") == [IMAGE]
    assert find_left(str(room)) == []


# in a Blender that goes on


class Events:
    """With the class Baking of an installed extension: Bake as Blender runs it beside its window, one event after the other."""

    def __init__(self):
        self.told = []

    def report(self, kinds, text):
        self.told.append(text)

    def run_to_light(self, **knobs):
        chosen = bpy.context.scene.leaflight
        for name, value in knobs.items():
            setattr(chosen, name, value)
        assert self._start(bpy.context, preview=True)
        assert self._prepare(bpy.context, math.inf) is None
        state, limit = bpy.context.window_manager.leaflight_state, time.monotonic() + 60.0
        while state.progress is None and not self._ended and time.monotonic() < limit:
            self._ended = state.drain()
            time.sleep(0.02)
        assert state.progress is not None

    def show_light(self):
        state, limit = bpy.context.window_manager.leaflight_state, time.monotonic() + 60.0
        while not state.previews and time.monotonic() < limit:
            state.drain()
            time.sleep(0.02)
        self._live.show(bpy.context, state.take_previews())

    def run_to_end(self):
        self._ended = self._ended or bpy.context.window_manager.leaflight_state.wait()
        return self._finish(bpy.context, self._ended)


class Modal(Events, baking.Baking):
    pass


@pytest.fixture
def modal(room):
    leaflight.register()
    bpy.ops.wm.open_mainfile(filepath=str(room))
    ask_quick_bake(room.parent / "maps")
    yield Modal()
    leaflight.unregister()


def hold_next_bake(room):
    """Blender is as usable as before."""
    ask_quick_bake(room.parent / "next")
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    assert bpy.context.window_manager.leaflight_state.error == ""


@pytest.mark.own_process
def test_the_scene_is_deleted(room, modal):
    modal.run_to_light(direct="photons", error=1e-4, max_photons=200_000)
    scene = bpy.context.scene
    other = bpy.data.scenes.new("Other")
    bpy.context.window.scene = other
    bpy.data.scenes.remove(scene)
    assert modal.run_to_end() == {"CANCELLED"}
    assert modal.told == ["the scene was deleted during the bake; the images are in the output folder."]
    assert IMAGE in list_files(room.parent / "maps")
    bpy.ops.wm.open_mainfile(filepath=str(room))
    hold_next_bake(room)


@pytest.mark.own_process
def test_another_file_is_opened(room, modal):
    modal.run_to_light(direct="photons", error=1e-4, max_photons=2**31 - 1)
    folder = Path(modal._folder.name)
    modal.cancel(bpy.context)  # as Blender does first
    bpy.ops.wm.open_mainfile(filepath=str(room))
    assert not bpy.context.window_manager.leaflight_state.running
    assert not folder.exists()
    hold_next_bake(room)


@pytest.mark.own_process
@pytest.mark.slow  # of the everyday tests test_operators has the end of a bake whose extension goes
def test_the_extension_is_disabled_and_enabled(room, modal):
    modal.run_to_light(direct="photons", error=1e-4, max_photons=2**31 - 1)
    pid = bpy.context.window_manager.leaflight_state._process._process.pid
    leaflight.unregister()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    leaflight.register()
    bpy.ops.wm.open_mainfile(filepath=str(room))
    hold_next_bake(room)


def load_extension(folder):
    """A copy of the package in a new folder, as an update of the extension puts it there, loaded under a name of its own."""
    for name in [name for name in sys.modules if name.partition(".")[0] == folder.name]:
        del sys.modules[name]
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copy(TESTS.parent / "__init__.py", folder)
    for part in ("core", "addon"):
        shutil.copytree(TESTS.parent / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    spec = importlib.util.spec_from_file_location(folder.name, folder / "__init__.py", submodule_search_locations=[str(folder)])
    sys.modules[folder.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[folder.name])
    return sys.modules[folder.name]


@pytest.mark.own_process
@pytest.mark.slow
def test_the_extension_is_updated(room, tmp_path):
    """Blender disables it, puts other files into its folder, and enables it."""
    folder = tmp_path / "leaflight_update"
    earlier = load_extension(folder)
    earlier.register()
    bpy.ops.wm.open_mainfile(filepath=str(room))
    ask_quick_bake(room.parent / "maps")
    event_loop = type("Modal", (Events, importlib.import_module("leaflight_update.addon.ui.baking").Baking), {})()
    event_loop.run_to_light(direct="photons", error=1e-4, max_photons=2**31 - 1)
    event_loop.show_light()
    pid = bpy.context.window_manager.leaflight_state._process._process.pid
    earlier.unregister()
    updated = load_extension(folder)
    updated.register()
    try:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
        assert find_shown() == {"Floor": "", "Cube": ""}
        hold_next_bake(room)
        assert "" not in find_shown().values()
    finally:
        updated.unregister()


def find_shown():
    """By object, the image that its material shows; "" where it wears its own material."""
    shown = {}
    for name in ("Floor", "Cube"):
        trees = [slot.material.node_tree for slot in bpy.data.objects[name].material_slots if slot.material]
        found = [node.image for tree in trees for node in tree.nodes if node.type == "TEX_IMAGE" and node.image]
        shown[name] = found[0].filepath or "light so far" if found else ""
    return shown


@pytest.mark.own_process
@pytest.mark.parametrize("worn", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("ends", [pytest.param("done", marks=pytest.mark.slow), "discarded"])
def test_a_step_is_undone_while_a_bake_runs(room, modal, worn, ends):
    """With light on the objects, and over two earlier bakes, the second of which the undo takes off."""
    bpy.ops.ed.undo_push(message="opened")
    shown = [find_shown()]
    for size in (32, 48) if worn else ():
        bpy.context.scene.leaflight.size = size
        assert bpy.ops.leaflight.bake() == {"FINISHED"}
        bpy.ops.ed.undo_push(message="bake")
        shown.append(find_shown())
    bpy.data.objects["Cube"].location.x += 0.25
    bpy.ops.ed.undo_push(message="move")
    place = bpy.data.objects["Cube"].location.x
    modal.run_to_light(direct="photons", error=1e-4, max_photons=300_000 if ends == "done" else 2**31 - 1)
    modal.show_light()
    for _ in range(2 if worn else 1):
        bpy.ops.ed.undo()
    assert bpy.data.objects["Cube"].location.x == pytest.approx(place - 0.25)
    state = bpy.context.window_manager.leaflight_state
    modal.show_light()
    if ends == "discarded":
        state.discard()
    assert modal.run_to_end() == {"FINISHED" if ends == "done" else "CANCELLED"}
    assert (state.running, state.error) == (False, "")
    if ends == "discarded":
        assert find_shown() == shown[-2 if worn else 0]
    else:
        assert IMAGE in list_files(room.parent / "maps")
        assert set(find_shown().values()).isdisjoint({"", "light so far"})
        assert find_shown() not in shown
    if bpy.ops.leaflight.remove.poll():
        bpy.ops.leaflight.remove()
    assert find_shown() == {"Floor": "", "Cube": ""}
    hold_next_bake(room)


def test_every_fault_of_the_table_has_its_test_and_is_in_the_docs():
    page = (TESTS.parent / "docs" / "reliability.md").read_text(encoding="utf-8")
    assert put_tables(page, {"faults": tabulate_faults(read_results(page))}) == page
    assert NOT_RUN not in read_results(page).values()
    for fault in FAULTS:
        file, name = fault.test.split("::")
        assert f"def {name}(" in (TESTS / file).read_text(encoding="utf-8"), fault
