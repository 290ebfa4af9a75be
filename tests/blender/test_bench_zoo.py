"""The zoo's benchmark from end to end, on scenes so small that its figures mean nothing."""

from random import Random

import pytest

bpy = pytest.importorskip("bpy")
import bench_zoo
import blend_kit
import scene_zoo
import zoo_dress
import zoo_matter
from blend_rooms import open_room, save_scene

SMALL = ["--quick", "--max-size", "64", "--reference-seconds", "1", "--budget", "100"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 5])  # one joined mesh; many objects
def test_a_seed_is_baked_and_held_against_cycles(tmp_path, capfd, seed):
    assert bench_zoo.main([*SMALL, "--seeds", str(seed), "--cache", str(tmp_path)]) == 0
    told = capfd.readouterr().out
    rows = [line.split(" | ") for line in told.splitlines() if line.startswith(f"| seed {seed} |")]
    assert len(rows) >= 1
    for row in rows:
        assert 0.0 < float(row[3].rstrip("%")) < 60.0  # rel; of a page that is laid out otherwise it is hundreds
        assert abs(float(row[5].rstrip("%"))) < 10.0
        assert 0 < int(row[9].rstrip("%")) <= 100
    assert list(tmp_path.glob("*/reference_*.npz"))


def test_scenes_are_dressed_by_the_seed(tmp_path):
    """And all kinds of what they are given can be made in this Blender."""
    drawn = []
    for name in ("one", "two"):
        scene_zoo.write_scene(7, tmp_path / f"{name}.blend", 64, 1000, scene_zoo.DRESS)
        trees = [(one.name, sorted(node.bl_idname for node in one.node_tree.nodes)) for one in bpy.data.materials if one.node_tree]
        places = [(one.name, tuple(one.location), one.hide_render) for one in bpy.context.scene.objects]
        drawn.append((trees, places, bpy.context.scene.world.name))
    assert drawn[0] == drawn[1]
    assert drawn[0][2] == "Random World"
    tree = bpy.data.materials.new("All")
    tree.use_nodes = True
    for make in zoo_matter.KINDS.values():
        assert make(zoo_matter.Painter(tree.node_tree, Random(1))).outputs[0].type == "SHADER"


@pytest.mark.parametrize("kind", zoo_dress.KINDS)
def test_casters_are_rendered(kind):
    """Each has faces or strands of its own, or of its instances."""
    blend_kit.start_scene()
    zoo_dress.KINDS[kind](zoo_dress.Builder(Random(1), (0.0, 0.0, 2.0, 2.0), 2.0))
    kinds = set()
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:  # each is valid until the next one
        obj = instance.object
        if obj.type not in ("EMPTY", "LIGHT") and (len(obj.to_mesh().polygons) or obj.particle_systems):
            kinds.add(obj.type)
    assert kinds


@pytest.mark.slow
def test_files_get_a_layer_of_their_own(tmp_path, capfd):
    open_room()
    bpy.context.scene.objects["Cube"].modifiers.new("Array", "ARRAY")
    folder = tmp_path / "files"
    folder.mkdir()
    save_scene(folder / "room.blend")
    assert bench_zoo.main([*SMALL, "--scenes", str(folder), "--cache", str(tmp_path)]) == 0
    assert capfd.readouterr().out.count("| room |") >= 1
