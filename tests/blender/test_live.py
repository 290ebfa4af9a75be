"""The light of a bake that runs, on the objects: shown, kept up to date, finished, taken off; no process between."""

import shutil
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_dump import differences, dump
from blend_rooms import add_copy, open_room
from leaflight.addon.app import live, session
from leaflight.addon.app.arguments import BakeRequest
from leaflight.addon.app.job import library_paths
from leaflight.addon.read.steps import never_halved
from leaflight.addon.show import restore
from leaflight.core.bake import preview
from leaflight.core.bake.bake import run_bake
from leaflight.core.util.messages import Preview
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=32, max_photons=300_000, error=0.01, workers=1, force=True)


@pytest.fixture(autouse=True)
def _room(monkeypatch):
    open_room()
    monkeypatch.setattr(sys, "path", [*sys.path, *library_paths()])
    monkeypatch.setattr(preview, "LEAST_PAUSE_S", 0.0)
    monkeypatch.setattr(preview, "PAUSE_OF_COST", 0.0)


@pytest.fixture
def start(tmp_path):
    """Starts a bake: its session and the files of its previews, one a page and turn; the core has ended."""
    count = []

    def start_bake(settings=SETTINGS, **changes):
        count.append(True)
        folder = tmp_path / f"job {len(count)}"
        folder.mkdir()
        request = BakeRequest(settings, output=tmp_path / "maps", preview=True, keep=tmp_path / "kept", **changes)
        work, paths = session.prepare(bpy.context, request, folder), []

        def hear(message):
            if isinstance(message, Preview):
                kept = Path(message.path).with_name(f"seen {len(paths)}.npy")  # a bake keeps the newest ones only
                shutil.copyfile(message.path, kept)
                paths.append({message.page: str(kept)})

        run_bake(folder, hear, lambda: False)
        return work, paths

    return start_bake


def whole_bake(start, **changes):
    work, _ = start(**changes)
    session.assign(bpy.context, work, session.read_result(work))


def shown_image(name="Floor"):
    """The image in an object's first material, None without a bake."""
    slots = bpy.data.objects[name].material_slots
    nodes = slots[0].material.node_tree.nodes if slots and slots[0].material else []
    return next((node.image for node in nodes if node.type == "TEX_IMAGE"), None)


def pixels_of(image):
    values = np.empty(4 * image.size[0] * image.size[1], np.float32)
    image.pixels.foreach_get(values)
    return values


def finish(view, work):
    return view.finish(bpy.context, session.read_result(work))


def test_light_comes_and_stays_up_to_date(start):
    work, paths = start()
    assert len(paths) > 1
    view = live.LiveView(work)
    view.show(bpy.context, paths[0])
    assert live.is_live(bpy.context.scene)
    first, material = pixels_of(shown_image()), bpy.data.objects["Floor"].material_slots[0].material.name
    np.testing.assert_allclose(first.reshape(32, 32, 4), np.load(paths[0][0]))
    view.show(bpy.context, paths[-1])
    np.testing.assert_allclose(pixels_of(shown_image("Cube")).reshape(32, 32, 4), np.load(paths[-1][0]))
    assert finish(view, work) == []
    assert shown_image().name == "lightmap_0.combined"
    assert shown_image().source == "FILE"
    assert bpy.data.objects["Floor"].material_slots[0].material.name == material  # no shader has to be made again
    assert not live.is_live(bpy.context.scene)
    assert [image.name for image in bpy.data.images] == ["lightmap_0.combined"]


def test_a_bake_shown_live_is_the_bake_shown_at_its_end(start):
    whole_bake(start)
    at_once = dump()
    restore.remove_bake(bpy.context.scene)
    work, paths = start()
    view = live.LiveView(work)
    view.show(bpy.context, paths[0])
    finish(view, work)
    assert differences(at_once, dump()) == []


def test_nothing_is_left_of_a_bake_that_came_to_nothing(start):
    before = dump()
    work, paths = start()
    view = live.LiveView(work)
    view.show(bpy.context, paths[0])
    assert differences(before, dump())
    view.take_off()
    assert differences(before, dump()) == []


@pytest.mark.parametrize("hidden", [False, True])
def test_an_earlier_bake_comes_back(start, hidden):
    whole_bake(start)
    if hidden:
        restore.toggle_preview(bpy.context.scene, False)
    before, earlier = dump(), bpy.data.images["lightmap_0.combined"]
    work, paths = start(replace(SETTINGS, seed=2))
    view = live.LiveView(work)
    view.show(bpy.context, paths[0])
    assert live.is_live_image(shown_image())
    assert live.is_live(bpy.context.scene)
    view.take_off()
    assert differences(before, dump()) == []
    view.show(bpy.context, paths[-1])
    assert finish(view, work) == []
    assert shown_image() == earlier
    assert len(bpy.data.images) == 1


def test_the_first_light_put_on_in_steps_is_that_put_on_at_once(start):
    work, paths = start()
    view = live.LiveView(work)
    view.show(bpy.context, paths[0])
    at_once = dump()
    view.take_off()
    counted = sum(1 for _ in view.show_steps(bpy.context, paths[0]))
    assert counted >= 4  # a mesh and a material of each of both objects
    assert differences(at_once, dump()) == []


@pytest.mark.parametrize("copies", [False, True])
def test_the_first_light_is_taken_off_wherever_putting_it_on_ends(start, copies):
    if copies:
        bpy.data.objects["Cube"].modifiers.new("Mirror", "MIRROR")
    before, touched = dump(), False
    work, paths = start()
    view, count = live.LiveView(work), 0
    while True:
        steps = view.show_steps(bpy.context, paths[0])
        if len(list(islice(steps, count))) < count:
            break  # it came to its end
        touched = touched or bool(differences(before, dump()))
        steps.close()
        assert differences(before, dump()) == []
        count += 1
    assert touched
    assert live.is_live(bpy.context.scene)


def test_an_earlier_bake_of_another_layout_stays_until_the_end(start):
    whole_bake(start)
    before = dump()
    work, paths = start(replace(SETTINGS, size=48))
    view = live.LiveView(work)
    view.show(bpy.context, paths[0])
    assert differences(before, dump()) == []
    finish(view, work)
    assert tuple(shown_image().size) == (48, 48)


@pytest.mark.parametrize("copies", [False, True])
def test_where_the_result_is_put_on_in_steps_it_is_whole_wherever_they_end(start, copies):
    """Saving, or an undo, comes between two of them."""
    if copies:
        bpy.data.objects["Cube"].modifiers.new("Mirror", "MIRROR")
    whole_bake(start)
    work, _ = start(replace(SETTINGS, size=48))
    result = session.read_result(work)
    live.LiveView(work).finish(bpy.context, result)
    wanted, halved, count = dump(), False, 1
    while True:
        steps = never_halved(live.LiveView(work).finish_steps(bpy.context, result))
        if len(list(islice(steps, count))) < count:
            break  # it came to its end
        halved = halved or bool(differences(wanted, dump()))
        steps.close()
        assert differences(wanted, dump()) == []
        count += 1
    assert halved


def test_a_bake_is_removed_wholly_wherever_its_steps_end(start):
    before = dump()
    for count in range(1, 4):
        whole_bake(start)
        steps = never_halved(restore.remove_steps(bpy.context.scene))
        assert len(list(islice(steps, count))) == count
        assert differences(before, dump())
        steps.close()
        assert differences(before, dump()) == []
    whole_bake(start)
    scene = bpy.context.scene
    steps = never_halved(restore.remove_steps(scene))
    next(steps)
    bpy.context.window.scene = bpy.data.scenes.new("Other")
    bpy.data.scenes.remove(scene)
    steps.close()  # a scene that a script has deleted meanwhile is no fault


@pytest.mark.parametrize("again", [False, True])
def test_copies_are_shown_and_follow_their_sources(start, again):
    bpy.data.objects["Cube"].modifiers.new("Mirror", "MIRROR")
    if again:
        whole_bake(start)
        bpy.data.objects["Cube"].hide_viewport = bpy.data.objects["Cube"].hide_render = False
        restore.toggle_preview(bpy.context.scene, True)
    work, paths = start()
    view = live.LiveView(work)
    view.show(bpy.context, paths[0])
    assert live.is_live_image(shown_image("Cube.Leaflight"))
    assert finish(view, work) == []
    assert shown_image("Cube.Leaflight").source == "FILE"
    assert len([obj for obj in bpy.data.objects if obj.name.startswith("Cube.")]) == 1


def test_what_undo_or_saving_took_away_is_shown_again(start):
    work, paths = start()
    view = live.LiveView(work)
    view.show(bpy.context, paths[0])
    live.take_off()
    assert shown_image() is None
    view.show(bpy.context, paths[-1])
    assert live.is_live(bpy.context.scene)
    np.testing.assert_allclose(pixels_of(shown_image()).reshape(32, 32, 4), np.load(paths[-1][0]))
    live.take_off()
    finish(view, work)  # and there was no page left to come
    assert shown_image().source == "FILE"


@pytest.mark.parametrize("again", [False, True])
def test_who_wears_a_copy_of_its_mesh_is_told(start, again):
    twin = add_copy(bpy.data.objects["Cube"])
    twin.name, twin.location.x, twin.scale = "Twin", 3.0, (20.0, 1.0, 1.0)
    if again:
        whole_bake(start, settings=replace(SETTINGS, size=64))
    work, paths = start(replace(SETTINGS, size=64))
    view = live.LiveView(work)
    view.show(bpy.context, paths[0])
    assert live.is_live(bpy.context.scene)
    view.show(bpy.context, paths[-1])
    ((subject, text),) = finish(view, work)
    assert subject in ("Cube", "Twin")
    assert "a copy of the mesh" in text


def test_nothing_is_shown_before_every_page_is_there(start):
    bpy.ops.mesh.primitive_plane_add(size=1.0, location=(3.0, 0.0, 0.0))
    work, paths = start(replace(SETTINGS, atlas=False))
    view, before = live.LiveView(work), dump()
    view.show(bpy.context, paths[0])
    view.show(bpy.context, {1: str(work.folder / "gone.npy")})
    assert differences(before, dump()) == []
    view.show(bpy.context, paths[1] | paths[2])
    assert {page for page in range(3) if live._find_image(page)} == {0, 1, 2}
    assert shown_image("Floor") != shown_image("Cube")
    assert finish(view, work) == []
