"""Which side of a surface is shown, which solids keep light inside, and which objects no light reaches."""

import math
from dataclasses import replace

import numpy as np
import pytest
from boxes import bake_folder, room_mesh, solve_scene
from leaflight.core.output.image_file import read_image
from leaflight.core.scene.dark_places import describe_dark
from leaflight.core.scene.light_probe import MOST_LAMPS, LightProbe
from leaflight.core.scene.scene import Light, Material, swap_corners
from leaflight.core.scene.sealed_solids import find_sealed
from leaflight.core.scene.sides import BEHIND, OPEN, TURNED, settle_sides, turn
from leaflight.core.util import ablation
from leaflight.core.util.job import LAYOUT_FILE
from leaflight.core.util.messages import Warning_
from leaflight.core.util.settings import AUTOMATIC, BOTH, FRONT, Settings
from scenes import Mesh, box_mesh, join_meshes, make_scene, moved, quad_mesh, sphere_mesh, split_faces

# Which side of a surface a lightmap shows: the front, unless it is turned the wrong way round beyond doubt.
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
    scene, settled = settle(room, wall, picture, lights=[Light("POINT", "Lamp", (1.5, 0.3, 1.0), power_rgb=(100.0,) * 3)])
    assert settled.warnings == (("Screen", OPEN),)
    paper = tuple(replace(one, through_rgb=(0.3,) * 3) for one in scene.materials)  # its texels show the light of both sides
    assert settle_sides(replace(scene, materials=paper), AUTOMATIC).warnings == ()


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


# Which solids keep the light inside that their faces send inwards; and that without it a bake is the same.
SOLID = box_mesh("Lamp", (0.4, 0.2, 0.1))
LARGE, SMALL = box_mesh("Large", (4.0, 4.0, 4.0)), box_mesh("Small", (0.05, 0.05, 0.05))


def turn_about(mesh, degrees):
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return replace(mesh, vertex=mesh.vertex @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]))


def turn_inside_out(mesh):
    return replace(mesh, polygons=[polygon[::-1] for polygon in mesh.polygons])


def is_sealed(*meshes, **flags):
    """Whether the first object is, all of it; flags are of its SceneObject."""
    scene = make_scene(meshes)
    scene = replace(scene, objects=(replace(scene.objects[0], **flags), *scene.objects[1:]))
    found = find_sealed(scene, scene.tri_object == 0)
    assert not found[scene.tri_object > 0].any(), "nobody asked for the others"
    own = found[scene.tri_object == 0]
    assert own.all() or not own.any()
    return bool(own.all())


@pytest.mark.parametrize(
    "mesh",
    [
        SOLID,
        turn_about(SOLID, 30.0),
        moved(SOLID, (1e4, 0.0, 0.0)),
        moved(SOLID, scale=1e-3),
        split_faces(SOLID),
        box_mesh("Flat", (0.4, 0.2, 0.0)),
        sphere_mesh(),
        replace(sphere_mesh(), vertex=sphere_mesh().vertex * [1.0, 0.2, 1.5]),
    ],
)
def test_closed_convex_solids_are_sealed(mesh):
    assert is_sealed(mesh)
    assert is_sealed(mesh, LARGE), "what is around it is not in it"


@pytest.mark.parametrize(
    "mesh",
    [
        quad_mesh(),
        replace(SOLID, polygons=SOLID.polygons[1:]),
        turn_inside_out(SOLID),
        replace(SOLID, polygons=[SOLID.polygons[0][::-1], *SOLID.polygons[1:]]),
        replace(SOLID, vertex=np.where(np.arange(8)[:, None] == 0, SOLID.vertex * 0.2, SOLID.vertex)),
        room_mesh(),
        Mesh("Twice", SOLID.vertex, [*SOLID.polygons, *SOLID.polygons]),
    ],
    ids=["sheet", "open", "inside out", "one face turned", "dented", "room", "twice"],
)
def test_what_is_open_or_bent_or_shines_on_its_front_alone_is_not(mesh):
    assert not is_sealed(mesh)


@pytest.mark.parametrize(("flags", "expected"), [({}, True), ({"casts_shadow": False}, False), ({"two_sided": True}, False)])
def test_light_must_stay_inside_and_no_texel_tell_of_it(flags, expected):
    assert is_sealed(SOLID, **flags) == expected


BASE = moved(quad_mesh("Floor", 4.0, 4.0), (-2.0, -2.0, -0.05))


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (SMALL, False),
        (moved(SMALL, (0.2, 0.0, 0.0)), False),
        (moved(SMALL, (0.3, 0.0, 0.0)), True),
        (BASE, True),
        (moved(BASE, (0.0, 0.0, 0.01)), False),
        (moved(SOLID, (0.4, 0.0, 0.0), name="Beside it"), True),
        (moved(SOLID, (0.39, 0.0, 0.0), name="Into it"), False),
    ],
    ids=["inside", "through a face", "beside", "it stands on it", "it sinks into it", "touching", "cutting"],
)
def test_nothing_else_may_be_inside(other, expected):
    assert is_sealed(SOLID, other) == expected
    assert is_sealed(turn_about(SOLID, 30.0), turn_about(other, 30.0)) == expected, "boxes along the axes overlap there"


def test_a_loose_part_of_the_same_object_counts_as_another_thing():
    assert is_sealed(join_meshes("Two", SOLID, moved(SOLID, (1.0, 0.0, 0.0))))
    assert not is_sealed(join_meshes("Two", SOLID, moved(SOLID, (0.1, 0.05, 0.02))))
    scene = make_scene([join_meshes("Lamp and shade", SOLID, moved(quad_mesh(), (1.0, 0.0, 0.0)))])
    assert find_sealed(scene, np.ones(scene.n_tri, bool)).tolist() == [True] * 12 + [False] * 2


def test_a_bake_is_the_same_with_far_fewer_rays(tmp_path, monkeypatch):
    """The same light, but for noise."""
    materials = [Material("Wall", (0.5,) * 3), Material("Lamp", (0.95,) * 3, emission_rgb=(10.0,) * 3)]
    scene = make_scene([room_mesh(), moved(SOLID, (0.0, 0.1, 0.2))], (), materials)
    scene = replace(scene, tri_material=scene.tri_object)
    settings = Settings(size=64, padding=1, workers=1, error=1e-3, max_photons=200_000, direct="photons")
    sealed = solve_scene(tmp_path / "sealed", scene, settings)
    monkeypatch.setenv(ablation.VARIABLE, "sealed_solids")
    plain = solve_scene(tmp_path / "plain", scene, settings)
    flux = [light.solution.flux[:, light.leaves].sum() for light in (sealed, plain)]
    assert flux[0] == pytest.approx(flux[1], rel=5e-3)
    assert sealed.ledger.rays < 0.4 * plain.ledger.rays
    emitted = [light.ledger.audit_w()["emitted"][0] for light in (sealed, plain)]
    assert emitted[0] == pytest.approx(emitted[1] / 2, rel=1e-9)


def test_a_dense_ball_is_sealed_and_one_with_a_dent_is_not():
    ball = sphere_mesh("Ball", rings=40, segments=80)
    assert is_sealed(ball)
    dented = ball.vertex.copy()
    dented[len(dented) // 2] *= 0.99
    assert not is_sealed(replace(ball, vertex=dented))


# A bake that finds no light ends soon, and says which objects are dark and why.
FLOOR = moved(quad_mesh("Floor", 2.0, 2.0), (-1.0, -1.0, 0.0))
SHADE = box_mesh("Shade", (0.4, 0.4, 0.4), (0.0, 0.0, 1.0))
BULB = Light("POINT", "Bulb", (0.0, 0.0, 1.0), power_rgb=(100.0,) * 3, radius_m=0.02)
SUN = Light("SUN", "Sun", power_rgb=(3.0,) * 3)


def bake_dark(folder, scene, **settings):
    """Warnings and result."""
    chosen = Settings(size=16, padding=1, workers=1, error=0.02, passes=("lighting",), sides="front", **settings)
    messages, result = bake_folder(folder, scene, chosen)
    return [(message.subject, message.text) for message in messages if isinstance(message, Warning_)], result


def describe(scene):
    return describe_dark(LightProbe(scene), range(len(scene.objects)))


@pytest.mark.usefixtures("open_image_io")
def test_a_floor_whose_only_lamp_is_enclosed_ends_the_bake(tmp_path):
    scene = make_scene([FLOOR, replace(SHADE, receives=False)], [BULB])
    told, result = bake_dark(tmp_path, scene)
    assert ("Floor", "is reached by no light: Bulb is enclosed by Shade") in told
    assert result["photons"] < 1_000_000


@pytest.mark.usefixtures("open_image_io")
def test_what_is_lit_is_not_named(tmp_path):
    told, result = bake_dark(tmp_path, make_scene([FLOOR, SHADE], [replace(BULB, position_m=(0.5, 0.5, 0.5))]), max_photons=100_000)
    assert told == []
    assert result["photons"] > 0


def test_lamps_and_what_glows_are_enclosed():
    filament = box_mesh("Filament", (0.1, 0.1, 0.1), (0.0, 0.0, 1.0))
    grey, hot = Material("Grey"), Material("Hot", emission_rgb=(9.0,) * 3)
    lit = replace(make_scene([FLOOR, SHADE, filament]), materials=(grey, hot))
    scene = replace(lit, tri_material=(lit.tri_object == 2).astype("int32"))
    assert describe(scene)[0] == ("Floor", "is reached by no light: Filament is enclosed by Shade")
    spot = Light("SPOT", "Spot", (0.0, 0.0, 3.0), power_rgb=(100.0,) * 3, cone_angle_rad=0.1)
    lid = box_mesh("Lid", (2.0, 2.0, 0.1), (0.0, 0.0, 2.0))
    assert ("Floor", "is reached by no light: Spot is enclosed by Lid") in describe(make_scene([FLOOR, lid], [spot]))


def test_a_closed_room_with_the_sun_outside_is_named():
    room = room_mesh("Room", (4.0, 4.0, 3.0))
    said = dict(describe(make_scene([room, FLOOR], [SUN])))
    assert said["Floor"] == "is reached by no light: it is enclosed by Room, and the light is outside"
    assert said["Room"] == "is reached by no light: it is closed in by its surroundings, and the light is outside"
    sky = replace(make_scene([room, FLOOR]), world_rgb=(1.0,) * 3)
    assert dict(describe(sky)) == said


def test_a_surface_that_faces_away_has_no_reason():
    away = replace(SUN, rotation=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)))
    assert describe(make_scene([FLOOR], [away])) == [("Floor", "is reached by no light")]


def test_light_through_a_small_opening_is_light():
    slot = [moved(quad_mesh(name, 2.0, 0.95), (-1.0, y, 0.5)) for name, y in (("Left", -1.0), ("Right", 0.05))]
    assert "Floor" not in dict(describe(make_scene([FLOOR, *slot], [replace(SUN, angle_rad=math.radians(1.0))])))


# Rough light at points, beside closed forms.
GREY = Material("Grey", (0.5, 0.5, 0.5))


def measure(meshes, lights=(), *, world=(0.0, 0.0, 0.0), materials=(GREY,), count=20000):
    """Mean irradiance on the first mesh's first triangle, a small quad around the origin that faces up."""
    probe = LightProbe(replace(make_scene(meshes, lights, materials), world_rgb=world))
    point, side = probe.spread_points(np.zeros(count, np.int32))
    return float(probe.find_irradiance(point, side).mean()), probe, point, side


PATCH = moved(quad_mesh("Patch", 0.002, 0.002), (-0.001, -0.001, 0.0))
DOWN = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        (Light("SUN", "Sun", power_rgb=(3.0,) * 3), 3.0),
        (Light("POINT", "Point", (0.0, 0.0, 2.0), power_rgb=(10.0,) * 3), 10.0 / (4 * math.pi * 4.0)),
        (Light("SPOT", "Spot", (0.0, 0.0, 2.0), power_rgb=(10.0,) * 3, cone_angle_rad=0.5), 10.0 / (4 * math.pi * 4.0)),
        (Light("SPOT", "Aside", (2.0, 0.0, 2.0), power_rgb=(10.0,) * 3, cone_angle_rad=0.5), 0.0),
        (Light("AREA", "Area", (0.0, 0.0, 2.0), DOWN, (10.0,) * 3, size_m=(0.01, 0.01)), 10.0 / (math.pi * 4.0)),
    ],
)
def test_lamps_have_their_irradiance(light, expected):
    assert measure([PATCH, moved(PATCH, (50.0, 0.0, 0.0))], [light], count=200)[0] == pytest.approx(expected, rel=1e-3)


def test_many_lamps_count_together():
    lamps = [Light("POINT", f"{i}", (0.0, 0.0, 2.0), power_rgb=(0.1,) * 3) for i in range(4 * MOST_LAMPS)]
    assert measure([PATCH], lamps, count=200)[0] == pytest.approx(4 * MOST_LAMPS * 0.1 / (4 * math.pi * 4.0), rel=1e-3)


def test_sky_and_glow_and_one_bounce():
    assert measure([PATCH], world=(1.0, 2.0, 3.0))[0] == pytest.approx(2.0 * math.pi)
    ceiling = moved(box_mesh("Ceiling", (4.0, 4.0, 0.1)), (0.0, 0.0, 1.05))
    covered = measure([PATCH, ceiling], world=(1.0,) * 3, materials=[Material("Black", (0.0,) * 3)])[0]
    form = sum(_form_factor(2.0, 2.0) for _ in range(4))  # four corners of a quad of 4 m, 1 m above
    assert covered == pytest.approx(math.pi * (1.0 - form), rel=0.05)
    glowing = measure([PATCH, ceiling], materials=[Material("Glow", (0.0,) * 3, emission_rgb=(1.0, 1.0, 1.0))])[0]
    assert glowing == pytest.approx(math.pi * form, rel=0.05)
    below = Light("SUN", "From below", rotation=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)), power_rgb=(2.0,) * 3)
    assert measure([PATCH, ceiling], [below])[0] == pytest.approx(0.5 * 2.0 * form, rel=0.05)


def _form_factor(a, b):
    """Of a point to a rectangle above it, one corner straight over it: sides a and b by the height. Source: Howell, B-3."""
    p, q = math.hypot(1.0, a), math.hypot(1.0, b)
    return (a / p * math.atan(b / p) + b / q * math.atan(a / q)) / (2 * math.pi)


def test_shadows_fall_where_the_lamp_and_the_object_cast_them():
    roof = box_mesh("Roof", (2.0, 2.0, 0.1), (0.0, 0.0, 1.0))
    sun = Light("SUN", "Sun", power_rgb=(3.0,) * 3)
    assert measure([PATCH, roof], [sun], count=500)[0] == 0.0
    assert measure([PATCH, roof], [replace(sun, casts_shadow=False)], count=500)[0] == pytest.approx(3.0)
    scene = make_scene([PATCH, roof], [sun], [GREY])
    probe = LightProbe(replace(scene, objects=(scene.objects[0], replace(scene.objects[1], casts_shadow=False))))
    assert probe.find_irradiance(*probe.spread_points(np.zeros(500, np.int32))).mean() == pytest.approx(3.0)
