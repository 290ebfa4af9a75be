"""Which side of a surface a lightmap shows: the front, unless it is turned the wrong way round beyond doubt."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import bake_folder, room_mesh
from leaflight.core.output.image_file import read_image
from leaflight.core.scene.scene import Light, Material, swap_corners
from leaflight.core.scene.sides import BEHIND, OPEN, TURNED, settle_sides, turn
from leaflight.core.util.job import LAYOUT_FILE
from leaflight.core.util.messages import Warning_
from leaflight.core.util.settings import AUTOMATIC, BOTH, FRONT, Settings
from scenes import box_mesh, join_meshes, make_scene, moved, quad_mesh, sphere_mesh

SKY = (1.0, 1.0, 1.0)
GROUND = moved(quad_mesh("Ground", 10.0, 10.0), (-5.0, -5.0, 0.0))
LAMP = Light("POINT", "Lamp", (0.2, 0.1, 0.9), power_rgb=(100.0,) * 3)


def inside_out(mesh):
    return replace(mesh, polygons=[face[::-1] for face in mesh.polygons])


def settle(*meshes, lights=(), world=SKY, sides=AUTOMATIC, objects=None):
    scene = replace(make_scene(meshes, lights), world_rgb=world)
    if objects:
        scene = replace(scene, objects=tuple(replace(one, **objects.get(one.name, {})) for one in scene.objects))
    return scene, settle_sides(scene, sides)


def names_turned(scene, settled):
    """Objects all of whose triangles are turned; no other may have a turned one."""
    found = []
    for number, one in enumerate(scene.objects):
        turned = settled.tri_turned[scene.tri_object == number]
        assert turned.all() == turned.any()
        found += [one.name] * bool(turned.any())
    return found


def is_front_up(settled, name):
    snapshot = settled.snapshot
    tri = snapshot.tri_object == [one.name for one in snapshot.objects].index(name)
    corner = snapshot.tri_position[tri]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (np.sign(normal[:, 2]) == np.sign(snapshot.tri_normal[tri][:, 0, 2])).all()
    return bool((normal[:, 2] > 0.0).all())


def test_what_has_its_normals_outwards_is_left_alone():
    scene, settled = settle(GROUND, box_mesh("Box", centre_m=(0.0, 0.0, 0.5)), moved(sphere_mesh("Ball"), (3.0, 0.0, 1.0)))
    assert settled.snapshot is scene
    assert settled.warnings == ()
    assert not settled.tri_turned.any()


@pytest.mark.parametrize("lights", [(), (Light("SUN", "Sun", power_rgb=(3.0,) * 3),)])
def test_a_solid_that_is_inside_out_is_turned(lights):
    stone = inside_out(moved(sphere_mesh("Stone"), (0.0, 0.0, 0.5)))
    scene, settled = settle(GROUND, stone, lights=lights, world=(0.0, 0.0, 0.0) if lights else SKY)
    assert names_turned(scene, settled) == ["Stone"]
    assert settled.warnings == (("Stone", TURNED),)


def test_a_slab_that_lies_on_the_ground_face_down_is_turned():
    slab = inside_out(moved(quad_mesh("Slab", 1.0, 1.0), (0.0, 0.0, 0.02)))
    scene, settled = settle(GROUND, slab)
    assert names_turned(scene, settled) == ["Slab"]
    assert is_front_up(settled, "Slab")


def test_the_ground_is_not_turned_below_a_floor():
    scene, settled = settle(GROUND, moved(quad_mesh("Boards", 10.0, 10.0), (-5.0, -5.0, 0.01)))
    assert names_turned(scene, settled) == []


def test_one_part_of_an_object_is_turned_by_itself():
    whole = join_meshes("Both", box_mesh(centre_m=(2.0, 0.0, 0.5)), inside_out(box_mesh(centre_m=(-2.0, 0.0, 0.5))))
    scene, settled = settle(GROUND, whole)
    assert settled.tri_turned[scene.tri_object == 1].tolist() == [False] * 12 + [True] * 12


def test_a_room_with_a_lamp_is_seen_from_inside():
    scene, settled = settle(room_mesh("Room", (4.0, 4.0, 2.0)), box_mesh("Table", (0.5, 0.5, 0.5), (1.0, 1.0, -0.7)), lights=[LAMP])
    assert names_turned(scene, settled) == []


def test_a_room_with_a_small_window_is_seen_from_inside():
    room = room_mesh("Room", (4.0, 4.0, 2.0))
    corner = np.array([[2.0, -0.4, -0.4], [2.0, -0.4, 0.4], [2.0, 0.4, 0.4], [2.0, 0.4, -0.4]])
    wall = next(i for i, face in enumerate(room.polygons) if (room.vertex[face][:, 0] > 0).all())
    outer = room.polygons[wall]
    by_place = {tuple(np.sign(room.vertex[k][1:])): k for k in outer}
    ring = [by_place[tuple(np.sign(one[1:]))] for one in corner]
    first = len(room.vertex)
    frame = [[ring[k], ring[(k + 1) % 4], first + (k + 1) % 4, first + k] for k in range(4)]
    polygons = [face for i, face in enumerate(room.polygons) if i != wall] + frame
    scene, settled = settle(replace(room, vertex=np.concatenate([room.vertex, corner]), polygons=polygons))
    assert names_turned(scene, settled) == []


def test_nothing_is_turned_where_no_light_is_on_either_side():
    scene, settled = settle(GROUND, inside_out(box_mesh("Box", centre_m=(0.0, 0.0, 0.5))), world=(0.0, 0.0, 0.0))
    assert names_turned(scene, settled) == []


@pytest.mark.parametrize("by", ["object", "material"])
def test_what_light_passes_hides_nothing(by):
    pane = moved(quad_mesh("Water", 10.0, 10.0), (-5.0, -5.0, 0.1))
    bed = moved(quad_mesh("Bed", 8.0, 8.0), (-4.0, -4.0, 0.0))
    below = moved(quad_mesh("Below", 9.0, 9.0), (-4.5, -4.5, -9.0))
    scene = replace(make_scene([pane, bed, below], materials=[Material("Grey"), Material("Water", passing_rgb=(0.9,) * 3)]), world_rgb=SKY)
    assert names_turned(scene, settle_sides(scene, AUTOMATIC)) == ["Bed"]
    if by == "object":
        scene = replace(scene, objects=(replace(scene.objects[0], casts_shadow=False, receives=False), *scene.objects[1:]))
    else:
        scene = replace(scene, tri_material=np.int32(scene.tri_object == 0))
    assert names_turned(scene, settle_sides(scene, AUTOMATIC)) == []


def test_choices_are_followed():
    stone = inside_out(box_mesh("Stone", centre_m=(0.0, 0.0, 0.5)))
    scene, settled = settle(GROUND, stone, sides=FRONT)
    assert settled.snapshot is scene
    scene, settled = settle(GROUND, stone, objects={"Stone": {"sides": FRONT}})
    assert settled.snapshot is scene
    scene, settled = settle(GROUND, stone, sides=BOTH, objects={"Ground": {"sides": AUTOMATIC}})
    assert [one.two_sided for one in settled.snapshot.objects] == [False, True]
    assert not settled.tri_turned.any()


def test_sheets_that_are_seen_from_both_sides_are_named():
    wall = replace(quad_mesh("Screen"), vertex=np.array([[0, -1, 0.2], [0, 1, 0.2], [0, 1, 2], [0, -1, 2]], float))
    room = room_mesh("Room", (6.0, 6.0, 5.0))
    picture = replace(quad_mesh("Picture"), vertex=np.array([[-2.98, -1, 0], [-2.98, 1, 0], [-2.98, 1, 1], [-2.98, -1, 1]], float))
    _, settled = settle(room, wall, picture, lights=[Light("POINT", "Lamp", (1.5, 0.3, 1.0), power_rgb=(100.0,) * 3)])
    assert settled.warnings == (("Screen", OPEN),)


def make_wall(x, faces_right):
    """A plane of 2.6 by 5 m, upright at x."""
    wall = quad_mesh("Wall", 2.6, 5.0)
    wall = replace(wall, vertex=np.stack([np.full(4, x), wall.vertex[:, 0] - 1.3, wall.vertex[:, 1] + 5.0], axis=1))
    return wall if faces_right else inside_out(wall)


@pytest.mark.parametrize(("left_faces_right", "warnings"), [(True, (("Sign", BEHIND),)), (False, ())])
def test_a_side_of_a_hollow_sign_that_looks_at_the_back_of_the_other_is_named(left_faces_right, warnings):
    sign = join_meshes("Sign", make_wall(-0.25, left_faces_right), make_wall(0.25, True))
    _, settled = settle(GROUND, sign)
    assert settled.warnings == warnings
    assert not settled.tri_turned.any()


def test_a_ground_below_another_is_not_named():
    _, settled = settle(GROUND, moved(quad_mesh("Below", 10.0, 10.0), (-5.0, -5.0, -1.0)))
    assert settled.warnings == ()


def test_objects_that_share_a_mesh_are_turned_together_or_not_at_all():
    stones = [inside_out(box_mesh(name, centre_m=(x, 0.0, 0.5))) for name, x in (("One", -2.0), ("Two", 2.0))]
    shared = {"One": {"mesh": 0}, "Two": {"mesh": 0}}
    scene, settled = settle(GROUND, *stones, objects=shared)
    assert names_turned(scene, settled) == ["One", "Two"]
    hidden = inside_out(room_mesh("Vault", (1.4, 1.4, 1.4)))  # nothing is lit in it
    scene, settled = settle(GROUND, stones[0], moved(stones[1], (0.0, 0.0, 0.0)), moved(hidden, (2.0, 0.0, 0.6)), objects=shared)
    assert names_turned(scene, settled) == []


def test_turning_swaps_all_that_is_at_corners():
    scene = make_scene([quad_mesh(uv=np.array([[0, 0], [1, 0], [1, 1], [0, 1]]))])
    turned = turn(scene, np.array([True, False]))
    assert turned.tri_uv[0].tolist() == scene.tri_uv[0][[0, 2, 1]].tolist()
    assert turned.tri_corner.tolist() == [scene.tri_corner[0][[0, 2, 1]].tolist(), scene.tri_corner[1].tolist()]
    assert turned.tri_normal[0].tolist() == (-scene.tri_normal[0]).tolist()
    assert turned.tri_normal[1].tolist() == scene.tri_normal[1].tolist()
    assert swap_corners(turned.tri_vertex, np.array([True, False])).tolist() == scene.tri_vertex.tolist()


def bake(folder, scene, **settings):
    """The lighting page, and where its triangles lie in Blender's order of corners."""
    chosen = Settings(size=64, padding=1, workers=1, error=0.3, max_photons=20_000, passes=("lighting",), **settings)
    messages, _ = bake_folder(folder, scene, chosen)
    [path] = (folder / "images").glob("*.exr")
    with np.load(folder / LAYOUT_FILE) as layout:
        return read_image(path)[0][..., :3], layout["tri_uv"], {message.text for message in messages if isinstance(message, Warning_)}


@pytest.mark.usefixtures("open_image_io")
def test_a_bake_shows_the_light_outside_a_solid_that_is_inside_out(tmp_path):
    stone = box_mesh("Stone", centre_m=(0.0, 0.0, 0.6))
    scene, wrong = (replace(make_scene([GROUND, mesh]), world_rgb=SKY) for mesh in (stone, inside_out(stone)))
    tri = np.flatnonzero(scene.tri_object == 1)
    page, tri_uv, told = bake(tmp_path / "right", scene)
    turned_page, turned_uv, told_turned = bake(tmp_path / "wrong", wrong)
    assert (told, told_turned) == (set(), {TURNED})

    def find_light(page, tri_uv):
        """(6,) lighting of the stone's faces: at the middles of their two triangles."""
        row, column = (tri_uv[tri].mean(axis=1)[:, ::-1] * page.shape[0]).astype(int).T
        return page[row, column, 0].reshape(6, 2).mean(axis=1)

    lit, lit_turned = find_light(page, tri_uv), find_light(turned_page, turned_uv)
    assert np.median(lit) > 0.5
    assert lit_turned == pytest.approx(lit, rel=0.1, abs=0.02)
    # Charts are laid out as they are seen, so in Blender's order the turned ones are mirrored.
    uv = turned_uv[tri]
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    assert (first[:, 0] * second[:, 1] < first[:, 1] * second[:, 0]).all()
    dark, dark_uv, _ = bake(tmp_path / "front", wrong, sides=FRONT)
    assert find_light(dark, dark_uv).max() < 0.02
