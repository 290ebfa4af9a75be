"""Custom properties that are called like ours and hold something else are taken off; those that we write stay."""

import json

import pytest

bpy = pytest.importorskip("bpy")

from blend_dump import differences, dump
from blend_rooms import add_object, bake, save_scene
from leaflight.addon.app.marks_check import drop_broken_marks
from leaflight.addon.read.tags import find_original

JUNK = [True, "junk", -1, [1, 2], {"name": 5}, {}, "[[["]
# Where each mark belongs, and what else may not be in it.
MARKS = {
    "leaflight_uv_layer": ("meshes", [{"name": "a", "digest": 3, "active": "", "render": ""}]),
    "leaflight_active_layer": ("meshes", [{"before": 1, "shown": "a"}]),
    "leaflight_uv": ("objects", [[0.0, 1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, float("nan"), 0.0, 0.0]]),
    "leaflight_hidden": ("objects", [{"viewport": "no", "render": True}]),
    "leaflight_bake": (
        "objects",
        [{"mode": "nonsense", "uv_layer": ""}, {"mode": "combined", "uv_layer": "", "slots": {"0": {"link": 7}}}],
    ),
    "leaflight_layout": ("scenes", [{"digest": "a", "images": {"x": 1}}, {"digest": "a", "images": {}, "warnings": "[[1, 2]]"}]),
    "leaflight_state_objects": ("scenes", ['["a", 5]', '{"a": 1}', "[" * 100_000]),
}


@pytest.mark.parametrize(("mark", "kind", "values"), [(mark, kind, values) for mark, (kind, values) in MARKS.items()])
@pytest.mark.usefixtures("room")
def test_what_is_no_mark_of_ours_goes(mark, kind, values):
    block = getattr(bpy.data, kind)[0]
    before = dump()
    for value in [*(one for one in JUNK if not (kind == "scenes" and isinstance(one, str))), *values]:
        block[mark] = value
        drop_broken_marks()
        assert differences(before, dump()) == [], value
    bpy.data.images.new("i", 4, 4)[mark] = "on another kind of block"
    drop_broken_marks()
    assert mark not in bpy.data.images["i"]


@pytest.mark.usefixtures("room")
def test_originals_in_a_ring_are_let_go():
    one, other = (bpy.data.materials.new(name) for name in ("One", "Other"))
    for material, original in ((one, other), (other, one)):
        material["leaflight_made"], material["leaflight_original"] = True, original
    drop_broken_marks()
    assert sum("leaflight_original" in material for material in (one, other)) == 1
    assert find_original(one) == find_original(other)  # an end is found


@pytest.mark.parametrize("words", [("--own-meshes",), ("--per-object", "--pass", "lighting")])
def test_the_marks_of_a_bake_stay(room, words):
    """Copies of meshes, places of linked duplicates, slots and layers among them."""
    cube = bpy.data.objects["Cube"]
    cube.modifiers.new("Round", "SUBSURF")
    twin = add_object("Twin", bpy.data.objects["Floor"].data)
    twin.location.z = 2.5
    bpy.data.objects["Floor"].data.materials.append(bpy.data.materials.new("Wood"))
    save_scene(room)
    saved = room.with_name("saved.blend")
    assert bake(room, "--save", str(saved), "--keep", str(room.parent / "state"), *words) == 0
    bpy.ops.wm.open_mainfile(filepath=str(saved))
    before = dump()
    assert json.dumps(before).count("leaflight_") > 10
    drop_broken_marks()
    assert differences(before, dump()) == []
