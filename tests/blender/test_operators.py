"""The panel's properties and operators, as a script without a window uses them."""

import dataclasses
import os
import time
from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

import leaflight
from leaflight.addon.app import properties, request, session, words
from leaflight.addon.read.steps import Pause
from leaflight.addon.show import restore
from leaflight.addon.ui import baking, panels
from leaflight.core.util.messages import Preview, Progress, Status
from leaflight.core.util.settings import Settings

pytestmark = pytest.mark.usefixtures("empty_file", "addon")


@pytest.fixture
def scene(tmp_path):
    """A floor under a lamp, with a material of the user's, baked small."""
    bpy.ops.mesh.primitive_plane_add()
    bpy.context.object.name = "Floor"
    bpy.context.object.data.materials.append(bpy.data.materials.new("Grey"))
    bpy.ops.object.light_add(type="POINT", location=(0.0, 0.0, 1.0))
    bpy.context.object.data.energy = 20.0
    chosen = bpy.context.scene.leaflight
    chosen.size, chosen.error, chosen.workers, chosen.output = 16, 0.5, 1, str(tmp_path / "maps")
    return bpy.context.scene


def bake_error():
    with pytest.raises(RuntimeError) as raised:
        bpy.ops.leaflight.bake()
    return str(raised.value)


def is_baked():
    return bpy.data.objects["Floor"].material_slots[0].material.name != "Grey"


def test_untouched_panel_is_the_default_settings():
    assert properties.make_settings(bpy.context.scene.leaflight) == Settings()


def test_panel_has_every_knob_with_its_range():
    rna = bpy.context.scene.leaflight.bl_rna.properties
    for knob in dataclasses.fields(Settings):
        about = rna[knob.name]
        assert about.name == words.name_knob(knob) or knob.name == "passes"
        assert about.description
        if about.type in ("INT", "FLOAT"):
            low, high = knob.metadata["low"], min(knob.metadata["high"], 2**31 - 1 if about.type == "INT" else float("inf"))
            assert (about.hard_min, about.hard_max) == (pytest.approx(low), pytest.approx(high))
    assert [name for group in properties.list_groups() for name in properties.list_knobs(group)] == [
        knob.name for knob in sorted(dataclasses.fields(Settings), key=lambda knob: properties.list_groups().index(knob.metadata["group"]))
    ]


def test_every_group_has_a_panel():
    assert [cls.bl_label for cls in panels.CLASSES] == ["Bake", "Quality", "Lightmap", "Output", "Advanced", "Research"]
    assert {cls.bl_label for cls in panels.CLASSES[1:]} == set(properties.list_groups())


def test_quality_is_the_target_error():
    chosen = bpy.context.scene.leaflight
    assert chosen.quality == "PREVIEW", "as a new file has it"
    for name, error in properties.QUALITY_ERROR.items():
        chosen.quality = name
        assert properties.make_settings(chosen).error == error
        assert chosen.quality == name
    chosen.error = 0.123
    assert chosen.quality == "CUSTOM"


def test_main_pass_comes_first_and_once():
    chosen = bpy.context.scene.leaflight
    chosen.main_pass, chosen.passes, chosen.formats = "lighting", {"albedo", "lighting", "direct"}, {"png", "exr"}
    settings = properties.make_settings(chosen)
    assert settings.passes == ("lighting", "direct", "albedo")
    assert settings.formats == ("exr", "png")
    chosen.formats = set()
    with pytest.raises(ValueError, match="no file format"):
        properties.make_settings(chosen)


@pytest.mark.own_process
def test_bake_is_shown_switched_and_removed(scene, state, tmp_path):
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    assert is_baked()
    assert not state.running
    assert state.summarize()
    assert list((tmp_path / "maps").glob("*.combined.exr"))
    assert bpy.ops.leaflight.toggle_preview() == {"FINISHED"}
    assert not is_baked()
    assert restore.has_bake(scene)
    bpy.ops.leaflight.toggle_preview()
    assert is_baked()
    assert bpy.ops.leaflight.remove() == {"FINISHED"}
    assert not is_baked()
    assert not restore.has_bake(scene)
    assert not bpy.ops.leaflight.remove.poll()
    assert state.summarize() == []


def test_folder_beside_an_unsaved_file_is_refused(scene, state, tmp_path):
    scene.leaflight.output = "//maps"
    assert not bpy.ops.leaflight.bake.poll()
    assert request.UNSAVED in bake_error(), "the tooltip of the grey button"
    assert not state.running
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "floor.blend"))
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    assert state.error == ""
    assert list((tmp_path / "maps").iterdir())


def test_each_blend_bakes_into_a_folder_of_its_own(scene, tmp_path):
    """With an image for each object those of a copy have the same names."""
    scene.leaflight.property_unset("output")
    scene.leaflight.atlas = False
    written = {}
    for name in ("Küche 2", "Copy"):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / f"{name}.blend"))
        folder = tmp_path / "lightmaps" / name
        assert request.make_request(bpy.context).output == request.find_output(scene) == folder
        assert bpy.ops.leaflight.bake() == {"FINISHED"}
        image = folder / "Floor.combined.exr"
        written[image] = image.stat().st_mtime_ns
    assert {image: image.stat().st_mtime_ns for image in written} == written
    assert bpy.data.images["Floor.combined"].filepath.startswith("//lightmaps/Copy/")


def test_a_folder_that_is_chosen_is_taken_as_it_is(scene, tmp_path):
    scene.leaflight.output = str(tmp_path / "{not_ours}")
    assert request.make_request(bpy.context).output == tmp_path / "{not_ours}"
    scene.leaflight.output = str(tmp_path / "{blend_name} maps")
    assert request.make_request(bpy.context).output == tmp_path / "lightmap maps", "not saved yet"


def test_baked_scene_is_exported(scene, tmp_path):
    assert not bpy.ops.leaflight.export_gltf.poll()
    bpy.ops.leaflight.bake()
    assert bpy.ops.leaflight.export_gltf(filepath=str(tmp_path / "room.glb")) == {"FINISHED"}
    assert (tmp_path / "room.glb").stat().st_size > 1000
    with pytest.raises(RuntimeError, match="cannot be written"):
        bpy.ops.leaflight.export_gltf(filepath=str(tmp_path / "none" / "room.glb"))
    assert bpy.context.window.scene == scene


def test_output_choices_reach_the_bake(scene, tmp_path):
    chosen = scene.leaflight
    chosen.formats, chosen.name_pattern = {"rgbm"}, "{pass}_{page}"
    assert "cannot show RGBM as light; add EXR to the formats" in bake_error()
    chosen.formats, chosen.pack = {"rgbm", "exr"}, True
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    assert sorted(path.name for path in (tmp_path / "maps").glob("combined*")) == ["combined_0.exr", "combined_0.rgbm.png"]
    assert bpy.data.images["combined_0"].packed_file
    chosen.name_pattern = "{size}"
    assert "name_pattern: expected no other fields" in bake_error()


def test_selected_objects_are_baked(scene):
    scene.leaflight.objects = "SELECTED"
    assert "no mesh is selected" in bake_error()  # the lamp is
    floor = bpy.data.objects["Floor"]
    floor.select_set(True)
    assert request.make_request(bpy.context).objects == ("Floor",)
    assert bpy.ops.leaflight.bake() == {"FINISHED"}


def test_selected_copy_stands_for_its_source(scene):
    floor = bpy.data.objects["Floor"]
    floor.modifiers.new("Thick", "SOLIDIFY").thickness = 0.1
    scene.leaflight.size = 64
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    copy = next(obj for obj in scene.objects if obj.name == "Floor.Leaflight")
    copy.select_set(True)
    scene.leaflight.objects = "SELECTED"
    assert request.list_objects(bpy.context) == [floor]
    assert bpy.ops.leaflight.bake() == {"FINISHED"}


def test_a_fault_of_ours_leaves_no_bake_running(scene, state, monkeypatch):
    def fail(*_):
        raise AttributeError("planted")

    monkeypatch.setattr(session, "assign_steps", fail)
    assert "planted" in bake_error()
    assert not state.running
    assert "fault of Leaflight's" in state.error
    assert state.result is None


def test_a_fault_while_the_light_is_shown_ends_the_bake(scene, state):
    """Blender forgets a modal operator that raises, without a word to it."""

    class FakeProcess:
        killed = False

        def messages(self):
            return iter(())

        def kill(self):
            self.killed = True

    class FakeLive:
        taken_off = False

        def show_steps(self, *_):
            yield Pause.HOLD
            raise ValueError("planted")

        def take_off(self):
            self.taken_off = True

    process, follower = FakeProcess(), baking.Baking()
    state.begin(process, time.monotonic(), [])
    follower._ended, follower._live, follower._scene_uid = None, FakeLive(), scene.session_uid
    state.previews[0] = "page.npy"
    with pytest.raises(ValueError, match="planted"):
        follower.modal(bpy.context, SimpleNamespace(type="TIMER", value="NOTHING"))
    assert process.killed
    assert follower._live.taken_off
    assert not state.running
    assert "fault of Leaflight's" in state.error


class Follower(baking.Baking):
    """Follows a bake without a process; what it asks of Blender is written down."""

    def __init__(self, state, monkeypatch):
        state.begin(SimpleNamespace(messages=lambda: iter(()), kill=lambda: None), time.monotonic(), [])
        self._ended, self.state, self.written = None, state, []
        self._live = SimpleNamespace(show_steps=self.put_on)
        self._scene_uid = bpy.context.scene.session_uid
        self.clock_s = 100.0
        monkeypatch.setattr(baking, "time", SimpleNamespace(monotonic=lambda: self.clock_s))
        self.context = SimpleNamespace(
            mode="OBJECT",
            scene=bpy.context.scene,
            window="window",
            workspace=SimpleNamespace(status_text_set=lambda text: self.written.append(text.split("  ")[2])),
            window_manager=SimpleNamespace(
                leaflight_state=state,
                windows=(),
                event_timer_add=lambda seconds, window: self.written.append(seconds) or object(),
                event_timer_remove=lambda timer: self.written.append("removed"),
            ),
        )

    def put_on(self, *_):
        yield Pause.WAIT
        self.written.append("light")
        return True

    def hear(self, message, after_s):
        self.clock_s += after_s
        self.state.hear(message)
        self.tick()

    def tick(self):
        self.modal(self.context, SimpleNamespace(type="TIMER", value="NOTHING"))


def test_it_is_looked_for_the_first_light_often_and_for_what_follows_seldom(state, scene, monkeypatch):
    follower = Follower(state, monkeypatch)
    follower._set_timer(follower.context, baking.FIRST_TIMER_SECONDS)
    for _ in range(3):
        follower.hear(Preview(0, "page.npy"), 1.0)
        follower.tick()
    timers = [entry for entry in follower.written if entry != "Starting"]
    assert timers == [0.02, "light", "removed", 0.1, "light", "light"]


def test_nothing_reaches_the_scene_while_light_is_put_on(state, scene, monkeypatch):
    follower = Follower(state, monkeypatch)
    event = SimpleNamespace(type="X", value="PRESS")
    assert follower.modal(follower.context, event) == {"PASS_THROUGH"}
    follower.hear(Preview(0, "page.npy"), 1.0)
    assert follower.modal(follower.context, event) == {"RUNNING_MODAL"}
    state.give_back()  # an undo or a save by a script; then all is done anew
    assert "light" not in follower.written
    follower.tick()
    assert "light" in follower.written
    assert follower.modal(follower.context, event) == {"PASS_THROUGH"}


def test_where_no_first_light_comes_the_first_progress_ends_the_haste(state, scene, monkeypatch):
    follower = Follower(state, monkeypatch)
    follower._set_timer(follower.context, baking.FIRST_TIMER_SECONDS)
    for _ in range(2):
        follower.hear(Progress(0.1, 10, 1.0, 0.5, 1.0, 1), 0.1)
    assert [entry for entry in follower.written if entry in (0.02, "removed", 0.1)] == [0.02, "removed", 0.1]


def test_texts_change_no_faster_than_they_can_be_read(state, scene, monkeypatch):
    follower = Follower(state, monkeypatch)
    for stage, after_s in (("One", 1.0), ("Two", 0.1), ("Three", 0.1), ("Four", 0.1), ("Five", 0.1)):
        follower.hear(Status("stage", stage), after_s)
    assert follower.written == ["One", "Four"]
    follower.hear(Status("stage", "Five"), 0.2)
    assert follower.written == ["One", "Four", "Five"]


def test_opening_a_file_forgets_the_last_bake(scene, state):
    bpy.ops.leaflight.bake()
    bpy.ops.wm.read_homefile(use_empty=True)
    assert state.summarize() == []


@pytest.mark.own_process
@pytest.mark.skipif(os.name != "posix", reason="process groups are POSIX's")
def test_unregistering_ends_a_bake_with_its_workers(scene, state, tmp_path):
    from leaflight.addon.app import job

    chosen = scene.leaflight
    chosen.error, chosen.size, chosen.workers, chosen.max_photons = 1e-4, 64, 2, 2**31 - 1
    chosen.direct = "photons"  # a floor sends itself nothing, so that rays alone would end the bake
    session.prepare(bpy.context, request.make_request(bpy.context), tmp_path)
    process = job.BakeProcess(tmp_path, tuple(bpy.app.python_args))
    state.begin(process, time.monotonic(), [])
    give_up = time.monotonic() + 30.0
    while state.progress is None and time.monotonic() < give_up:
        assert state.drain() is None
        time.sleep(0.05)
    group = process._process.pid
    os.killpg(group, 0)  # it is there
    leaflight.unregister()
    leaflight.register()
    assert wait_until_gone(group)


def wait_until_gone(group):
    for _ in range(100):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def test_registering_twice_leaves_nothing_between():
    leaflight.unregister()
    assert not hasattr(bpy.types.Scene, "leaflight")
    assert not hasattr(bpy.types.WindowManager, "leaflight_state")
    assert not hasattr(bpy.types, "LEAFLIGHT_PT_main")
    leaflight.register()
    assert bpy.context.scene.leaflight.size == Settings().size


def test_a_failed_registration_is_taken_back(monkeypatch):
    leaflight.unregister()

    def refuse(*_):
        raise RuntimeError("planted")

    with monkeypatch.context() as patch:
        patch.setattr(bpy.utils, "register_cli_command", refuse)
        with pytest.raises(RuntimeError, match="planted"):
            leaflight.register()
    assert not hasattr(bpy.types.Scene, "leaflight")
    leaflight.register()


def test_an_unchanged_scene_keeps_its_bake_until_it_is_forced(scene, state, monkeypatch):
    """Nor does the bake that it wears change it, or that it was removed meanwhile, where no state went with it (see test_refine)."""
    scene.leaflight.main_pass = "direct"
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    began = []
    messages = baking.BakeProcess.messages
    monkeypatch.setattr(baking.BakeProcess, "messages", lambda process: began.append(process) or messages(process))
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    assert state.summarize()[0] == "Unchanged since the last bake: 1 file kept"
    assert bpy.ops.leaflight.remove() == {"FINISHED"}
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    assert (is_baked(), state.running, began) == (True, False, [])
    scene.leaflight.force = True
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    assert state.summarize()[0].startswith("Baked in ")
    assert len(began) == 1
