"""The export in steps: the same as at once, with pauses often enough, and nothing left of it wherever it ends."""

import json
import time
from dataclasses import asdict
from itertools import islice, pairwise

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_object, make_material
from leaflight.addon.app.arguments import BakeRequest
from leaflight.addon.app.preparation import Preparation
from leaflight.addon.app.session import prepare_steps
from leaflight.addon.read.object_settings import registered
from leaflight.addon.read.steps import Pause
from leaflight.core.scene.snapshot import describe_snapshot, list_arrays
from leaflight.core.util.progress import unwatched
from leaflight.core.util.settings import Settings

CUBES = 12


@pytest.fixture(autouse=True)
def _choices():
    with registered():
        yield


@pytest.fixture
def cubes():
    """Cubes that share a mesh, some hidden in the viewport and one smoother in render; one's texture lies on its bounds."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add(size=0.5)
    mesh = bpy.context.object.data
    material = make_material("Paint")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture, place = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeTexCoord")
    texture.image = bpy.data.images.new("Dots", 8, 8)
    texture.image.pixels = np.random.default_rng(1).random(8 * 8 * 4).astype(np.float32).tolist()
    links.new(place.outputs["Generated"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    mesh.materials.append(material)
    for number in range(1, CUBES):
        add_object(f"Cube {number}", mesh, location=(number, 0.3 * number, 0.0))
    bpy.data.objects["Cube 1"].modifiers.new("Smooth", "SUBSURF").render_levels = 3
    bpy.data.objects["Cube 2"].hide_set(True)
    bpy.data.objects["Cube 3"].hide_viewport = True
    bpy.data.objects["Cube 4"].select_set(True)
    add_object("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    bpy.context.view_layer.update()


def begin(folder, watch=unwatched):
    folder.mkdir(exist_ok=True)
    request = BakeRequest(Settings(size=64, force=True), output=folder / "maps")
    return prepare_steps(bpy.context.scene, bpy.context.view_layer, request, folder, watch)


def take(steps, sent):
    """The session, and the pauses before it."""
    pauses = [next(steps)]
    while True:
        try:
            pauses.append(steps.send(sent))
        except StopIteration as end:
            return end.value, pauses


def describe(session):
    arrays = {name: (array.dtype.str, array.shape, array.tobytes()) for name, array in list_arrays(session.export.snapshot).items()}
    objects = [asdict(one) for one in session.export.objects]
    return arrays, json.dumps(describe_snapshot(session.export.snapshot)), objects, session.export.warnings, session.prints


def note_scene():
    layer = bpy.context.view_layer
    levels = bpy.data.objects["Cube 1"].modifiers[0].levels
    return levels, [(o.name, o.hide_viewport, o.hide_get(view_layer=layer), o.select_get(view_layer=layer)) for o in bpy.data.objects]


def test_pauses_change_nothing_of_the_export(cubes, tmp_path):
    at_once, _ = take(begin(tmp_path / "one"), None)
    in_steps, pauses = take(begin(tmp_path / "two"), True)
    assert describe(at_once) == describe(in_steps)
    assert pauses.count(Pause.HOLD) > CUBES  # one for each piece at least


def test_a_large_mesh_is_placed_in_blocks(tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    counts = []
    for side in (10, 260):
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=side, y_subdivisions=side)
        _, pauses = take(begin(tmp_path), True)
        counts.append(pauses.count(Pause.FREE))
        bpy.data.objects.remove(bpy.context.object)
    assert counts[1] >= counts[0] + 3


def test_closed_at_any_pause_it_leaves_the_scene_as_it_was(cubes, tmp_path):
    before, lent = note_scene(), False
    _, pauses = take(begin(tmp_path), True)
    assert note_scene() == before
    for count in np.unique(np.geomspace(1, len(pauses), 16).astype(int)):  # on a busy machine there are very many, while a thread works
        steps = begin(tmp_path)
        for _ in islice(steps, count):  # slices are cut by processor time, so that there may be fewer
            pass
        lent = lent or note_scene() != before
        steps.close()
        assert note_scene() == before
    assert lent


@pytest.mark.parametrize("told", [False, True])
def test_what_changes_between_two_steps_is_read_anew(cubes, tmp_path, told):
    """Whether it is told before, as undo and saving are, or found out afterwards."""
    before, changes = note_scene(), []
    preparation = Preparation(lambda: begin(tmp_path), lambda: len(changes))
    for _ in range(4):
        assert preparation.advance(0.0) is None
    assert note_scene() != before
    if told:
        preparation.give_back()
        assert note_scene() == before
    else:
        changes.append("Cube 9 was moved")
    bpy.data.objects["Cube 9"].location.z = 7.0
    found = preparation.advance(0.0)  # the rest at once, for the next change may come as soon
    assert found is not None
    assert found.export.snapshot.vertex_position[:, 2].max() > 7.0
    assert note_scene() == before


def test_once_nothing_more_is_asked_of_blender_changes_do_not_matter(cubes, tmp_path):
    changes = []
    preparation = Preparation(lambda: begin(tmp_path), lambda: len(changes))
    while preparation.holds:
        assert preparation.advance(0.0) is None
    changes.append("Cube 9 was moved")
    bpy.data.objects["Cube 9"].location.z = 7.0
    found = preparation.advance(float("inf"))
    assert found is not None
    assert found.export.snapshot.vertex_position[:, 2].max() < 1.0


def test_it_is_told_how_far_the_scene_is_read(cubes, tmp_path):
    told = []
    take(begin(tmp_path, lambda said, share, about: told.append((said.text, share, about))), True)
    shares = [share for _, share, _ in told]
    assert shares == sorted(shares)
    assert shares[0] < 0.1 < 0.9 < shares[-1] < 1.0
    assert max(b - a for a, b in pairwise(shares)) < 0.1
    assert {about for _, _, about in told} >= {"Cube", "Cube 5"}


def test_a_slice_is_of_work_and_not_of_the_clock():
    """Blender may take seconds between two slices on a busy machine, in which the clock passes and little is done."""

    def work():
        for _ in range(10):
            time.sleep(0.01)
            yield Pause.HOLD
        return "read"

    assert Preparation(work, lambda: 0).advance(0.05) == "read"


def test_a_slice_ends_after_its_seconds_of_work():
    def work():
        while True:
            sum(range(10_000))
            yield Pause.HOLD

    began = time.thread_time()
    assert Preparation(work, lambda: 0).advance(0.02) is None
    assert 0.02 <= time.thread_time() - began < 0.2


def test_where_only_a_thread_works_blender_goes_on():
    def work():
        yield Pause.ASIDE
        return "read"

    assert Preparation(work, lambda: 0).advance(1.0) is None


@pytest.mark.parametrize("pause", list(Pause))
def test_a_script_waits_for_the_whole_scene(pause):
    """It has no timer that goes on later."""

    def work():
        assert (yield pause) is None
        return "read"

    assert Preparation(work, lambda: 0).advance(float("inf")) == "read"
