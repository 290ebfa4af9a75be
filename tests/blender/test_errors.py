"""What an artist may run into: each is a sentence in the status bar (the operator's report) and in the panel, and harms nothing."""

import os
import re
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from blend_dump import differences, dump
from blend_rooms import add_copy, add_mesh
from leaflight.addon.app import job, request
from leaflight.addon.read import export_receivers
from leaflight.addon.show import restore
from leaflight.core.util.messages import Done

pytestmark = pytest.mark.usefixtures("addon_room")


def bake_error(state):
    """The report of a bake that fails, which the panel shows too, and which leaves nothing on the scene."""
    with pytest.raises(RuntimeError) as raised:
        bpy.ops.leaflight.bake()
    assert state.error
    assert state.error in str(raised.value)
    assert not state.running
    assert not restore.has_bake(bpy.context.scene)
    return state.error


def bake_warnings(state):
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    assert not state.error
    return dict(state.warnings)


def test_stopped_before_there_was_light_is_no_error_and_changes_nothing(state, monkeypatch):
    """As when an unwrapping was not waited for."""
    bpy.context.scene.leaflight.seed = 1  # as it will be set again: of what nobody set Blender 4.5 keeps nothing
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    before, told = dump(), state.describe_worn(bpy.context.scene.session_uid)
    monkeypatch.setattr(job.BakeProcess, "messages", lambda self: iter([Done("", interrupted=True)]))
    bpy.context.scene.leaflight.seed = 2  # else the bake is kept
    assert bpy.ops.leaflight.bake() == {"CANCELLED"}
    assert (state.running, state.error) == (False, "")
    bpy.context.scene.leaflight.seed = 1
    assert differences(before, dump()) == []
    assert state.describe_worn(bpy.context.scene.session_uid) == told


@pytest.mark.parametrize(("output", "name"), [("./maps", "maps"), ("../maps", "../maps")])
def test_folder_without_a_beginning(state, output, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bpy.context.scene.leaflight.output = output
    sentence = f"{output}: does not say where it begins; write //{name} for a folder beside the .blend, or a whole path."
    with pytest.raises(RuntimeError, match=re.escape(sentence)):  # the tooltip of the grey button
        bpy.ops.leaflight.bake()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="nothing is read-only to the administrator")
def test_read_only_folder(state, tmp_path):
    (tmp_path / "fixed").mkdir(mode=0o555)
    bpy.context.scene.leaflight.output = str(tmp_path / "fixed")
    assert "is no folder that can be written (Permission denied)" in bake_error(state)


def test_meshes_that_take_no_layer(state):
    mesh = bpy.data.objects["Cube"].data
    while len(mesh.uv_layers) < 8:
        mesh.uv_layers.new()
    add_mesh("Wire", [(0, 0, 0), (1, 0, 0)], [])
    add_mesh("Needle", [(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1, 2)])
    told = bake_warnings(state)
    assert told["Cube"] == "has 8 UV layers, as many as Blender allows; remove one to give it a lightmap"
    assert told["Wire"] == "has no faces and is left out"
    assert "give it faces with an area, or leave it out of the bake" in told["Needle"]
    assert "leaflight_bake" not in bpy.data.objects["Cube"]
    assert "leaflight_bake" in bpy.data.objects["Floor"]


def test_objects_without_a_size(state):
    cube, floor = (bpy.data.objects[name] for name in ("Cube", "Floor"))
    cube.scale = (0.0, 0.0, 0.0)
    told = [text for subject, text in state.warnings if subject == "Cube"] if bpy.ops.leaflight.bake() else []
    assert len(told) == 1
    assert "no face can be baked" in told[0]
    bpy.ops.leaflight.remove()
    floor.scale = (0.0, 0.0, 0.0)
    assert bake_error(state) == (
        "nothing to bake: no object has a face that takes light (Cube, Floor: no face can be baked, so it gets no lightmap; "
        "give it faces with an area, or leave it out of the bake)."
    )
    assert state.warnings == []


def test_status_bar_counts_warnings_as_the_panel_does(state, capfd):
    for name in ("Wire", "Rope"):
        add_mesh(name, [(0, 0, 0), (1, 0, 0)], [])
    assert len(bake_warnings(state)) == 2
    assert "; 1 warning in the panel" in capfd.readouterr().out


def test_a_bake_over_one_in_the_eighth_layer_works(state):
    mesh = bpy.data.objects["Cube"].data
    while len(mesh.uv_layers) < 7:
        mesh.uv_layers.new()
    assert bake_warnings(state) == {}
    assert bake_warnings(state) == {}
    assert len(mesh.uv_layers) == 8


@pytest.mark.parametrize("what", ["objects", "meshes"])
def test_linked_from_another_file(state, tmp_path, what):
    library = str(tmp_path / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=library, copy=True)
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    bpy.data.orphans_purge()
    with bpy.data.libraries.load(library, link=True) as (_, to):
        setattr(to, what, ["Cube"])
    cube = bpy.data.objects["Cube"] if what == "objects" else bpy.data.objects.new("Own", bpy.data.meshes["Cube"])
    bpy.context.scene.collection.objects.link(cube)
    told = [text for subject, text in state.warnings if subject == cube.name] if bpy.ops.leaflight.bake() else []
    if what == "meshes":  # baked on a copy, which may be shown in its place
        assert told == ["its mesh is linked from another file; a copy of what you see is baked, and stands in its place until Remove"]
        assert "Cube.Leaflight" in {obj.name for obj in bpy.context.scene.objects} or cube.hide_render
    else:
        assert told == [export_receivers.LINKED]
    assert bpy.ops.leaflight.remove() == {"FINISHED"}


def test_object_in_edit_mode(state):
    bpy.context.view_layer.objects.active = bpy.data.objects["Cube"]
    bpy.ops.object.mode_set(mode="EDIT")
    assert request.find_mode_error(bpy.context) == "Cube: is in Edit Mode; leave it (Tab) to bake."
    with pytest.raises(RuntimeError, match=r"Cube: is in Edit Mode; leave it \(Tab\) to bake\."):
        bpy.ops.leaflight.bake()
    assert not state.error  # the panel tells it while it holds, and no longer
    bpy.ops.object.mode_set(mode="OBJECT")
    assert request.find_mode_error(bpy.context) == ""


def test_hidden_collection(state):
    hidden = bpy.data.collections.new("Hidden")
    bpy.context.scene.collection.children.link(hidden)
    for name in ("Cube", "Floor"):
        hidden.objects.link(bpy.data.objects[name])
        bpy.context.scene.collection.objects.unlink(bpy.data.objects[name])
    hidden.hide_render = True
    assert bake_error(state).startswith("nothing to bake: no mesh object with faces is shown in render")
    bpy.context.scene.leaflight.objects = "SELECTED"
    bpy.data.objects["Cube"].select_set(True)
    assert bake_error(state) == "Cube: is hidden in render, or its collection is; show it in render, or leave it out of the bake."
    hidden.hide_render, hidden.hide_viewport = False, True  # what only the viewport hides is rendered, and baked
    bpy.context.scene.leaflight.objects = "ALL"
    assert bake_warnings(state) == {}
    assert hidden.hide_viewport


@pytest.mark.own_process
@pytest.mark.slow  # of the everyday tests test_job_process has the sentence
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory can be limited on Linux")
@pytest.mark.parametrize("limit_mb", [500, 700, 1000, 1500])  # where embree is loaded, builds its tree, and long after
def test_child_out_of_memory(state, monkeypatch, limit_mb):
    import resource

    popen = job.subprocess.Popen

    def start_limited(*arguments, **options):
        limit = limit_mb * 1_000_000
        return popen(*arguments, **options, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)))

    monkeypatch.setattr(job.subprocess, "Popen", start_limited)
    bpy.context.scene.leaflight.size = 4096
    assert bake_error(state) == "The bake ran out of memory: choose a smaller page size or density, or fewer processes."


def test_sentences_name_no_flag_of_the_command_line(state):
    chosen = bpy.context.scene.leaflight
    chosen.size = 4
    assert "--" not in bake_error(state)
    chosen.size, chosen.density = 32, 200.0
    assert not [text for text in bake_warnings(state).values() if "--" in text]


def test_many_meshes_of_one_fault_make_one_short_sentence(state):
    for name in ("A", "B", "C", "D", "E"):
        twin = add_copy(bpy.data.objects["Cube"])
        twin.name, twin.data = name, twin.data.copy()
    for obj in (obj for obj in bpy.context.scene.objects if obj.type == "MESH"):
        while len(obj.data.uv_layers) < 8:
            obj.data.uv_layers.new()
    room = "each has 8 UV layers, as many as Blender allows; remove one to give it a lightmap"
    assert bake_error(state) == f"nothing to bake: Floor, Cube, A and 4 more: {room}."
