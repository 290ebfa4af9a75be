"""The scenes that each prove one thing."""

from __future__ import annotations

import bpy
import furniture
import numpy as np
from blend_kit import add_camera, add_light, add_mesh, make_mesh, paint, place, set_world, start_scene
from furniture import block
from shapes import Shape, ball, box, cylinder, floor_quad, join, polygon


def cornell_box() -> None:
    """The published Cornell box in metres (its unit is the centimetre), front open, its lamp an area light.

    Source: Cornell University Program of Computer Graphics, Cornell box data.
    """
    start_scene()
    white, red, green = paint("White", (0.725, 0.71, 0.68)), paint("Red", (0.63, 0.065, 0.05)), paint("Green", (0.14, 0.45, 0.091))
    half, depth, height = 2.76, 5.592, 5.488
    add_mesh("Floor", (floor_quad((-half, 0), (half, depth)), white))
    add_mesh("Ceiling", (floor_quad((-half, 0), (half, depth), height).flipped(), white))
    add_mesh("Back wall", (polygon((-half, depth, 0), (half, depth, 0), (half, depth, height), (-half, depth, height)), white))
    add_mesh("Left wall", (polygon((-half, 0, 0), (-half, depth, 0), (-half, depth, height), (-half, 0, height)), red))
    add_mesh("Right wall", (polygon((half, depth, 0), (half, 0, 0), (half, 0, height), (half, depth, height)), green))
    # (x, z) of the published corners; x runs to the left there. As published, the blocks have no underside.
    short = ((1.30, 0.65), (0.82, 2.25), (2.40, 2.72), (2.90, 1.14))
    tall = ((4.23, 2.47), (2.65, 2.96), (3.14, 4.56), (4.72, 4.06))
    for name, corners, top in (("Short block", short, 1.65), ("Tall block", tall, 3.30)):
        ring = [(2.78 - x, y) for x, y in corners]
        points = np.array([(x, y, z) for z in (0.0, top) for x, y in ring])
        add_mesh(name, (Shape(points, [(4, 5, 6, 7), *((k, (k + 1) % 4, (k + 1) % 4 + 4, k + 4) for k in range(4))]), white))
    lamp = add_light(
        "Ceiling light", "AREA", 180.0, (0, 2.795, 5.47), (0, 2.795, 0), shape="RECTANGLE", size=1.3, size_y=1.05, color=(1.0, 0.85, 0.65)
    )
    lamp.visible_camera = True
    add_camera((0, -8.0, 2.73), (0, 0, 2.73), 49)
    bpy.context.scene.render.resolution_x = 360


def figure2_square() -> None:
    """Figure 2 of the paper: a unit square that is lit, then falls off linearly, then is dark.

    A lamp 0.3 m wide hangs 2 m above the middle, and the straight edge of a black sheet 1 m above the middle: the visible
    share of the lamp is exactly (0.65 - x) / 0.3 between x = 0.35 and 0.65.
    """
    start_scene()
    add_mesh("Square", (floor_quad((0, 0), (1, 1)), paint("White", (0.8, 0.8, 0.8))))
    add_mesh("Blocker", (box((0.5, -0.1, 1.0), (1.1, 1.1, 1.01)), paint("Black", (0.0, 0.0, 0.0))))
    add_light("Lamp", "AREA", 40.0, (0.5, 0.5, 2.0), (0.5, 0.5, 0), shape="SQUARE", size=0.3)
    add_camera((0.5, -1.3, 0.85), (0.5, 0.45, 0), 44)


def furnace() -> None:
    """A closed box that glows and reflects everywhere alike: radiance 1 + 1/2 + 1/4 + ... = 2 in every texel."""
    scene = start_scene()
    add_mesh("Furnace", (box((0, 0, 0), (2, 2, 2)).flipped(), paint("Glowing grey", (0.5, 0.5, 0.5), 1.0)))
    add_camera((0.2, 0.2, 1.0), (2, 2, 1.0), 24)
    # Two is beyond white.
    scene.view_settings.exposure = -2.0


def bent_quads() -> None:
    """Three grids of 256 quads, none of them planar, each rougher than the last, under a sun and a point light."""
    start_scene()
    clay = paint("Clay", (0.65, 0.55, 0.45))
    for column, noise in enumerate((0.3, 0.6, 1.5)):
        # The same noise, scaled: xatlas cuts none, some and half of the quads along their diagonals.
        grid = furniture.bent_grid(np.random.default_rng(0), 16, 0.125, noise)
        add_mesh(f"Bent {noise}", (grid, clay), location=(2.3 * (column - 1), 0, 0))
    add_light("Sun", "SUN", 2.2, (-3, -2, 3), (0, 0, 0), angle=0.0093)
    add_light("Point", "POINT", 40.0, (1.0, 0.6, 0.9), (1, 0, 0), shadow_soft_size=0.05, color=(1.0, 0.75, 0.5))
    add_camera((0, -5.6, 4.2), (0, -0.1, 0), 36)


def stool_collection() -> bpy.types.Collection:
    """A collection of three objects that is not in the scene itself; empties put it there."""
    collection = bpy.data.collections.new("Stool")
    wood, red = paint("Stool wood", (0.5, 0.33, 0.18)), paint("Stool red", (0.6, 0.12, 0.1))
    parts = (
        ("Stool legs", join(*furniture.legs(0.4, 0.4, 0.45, 0.05)), wood, False),
        ("Stool seat", block(0.46, 0.46, 0.04, (0, 0, 0.45)), red, False),
        # Off centre, so that a mirrored stool is told from a turned one.
        ("Stool ball", ball(0.09, 16).moved(0.1, -0.06, 0.58), paint("Stool yellow", (0.75, 0.6, 0.15)), True),
    )
    for name, shape, material, smooth in parts:
        collection.objects.link(bpy.data.objects.new(name, make_mesh(name, (shape, material), smooth=smooth)))
    return collection


def instances() -> None:
    """Everything that makes one mesh appear more than once, or other than it was drawn."""
    start_scene()
    set_world((0.7, 0.8, 1.0), 0.08)
    add_mesh("Ground", (floor_quad((-3.5, -2.5), (3.5, 3)), paint("Ground", (0.6, 0.6, 0.6))))
    blue, green, orange = paint("Blue", (0.15, 0.3, 0.6)), paint("Green", (0.2, 0.5, 0.2)), paint("Orange", (0.75, 0.4, 0.12))
    stair = join(block(0.6, 0.6, 0.2), block(0.3, 0.6, 0.2, (-0.15, 0, 0.2)), block(0.3, 0.3, 0.2, (-0.15, 0.15, 0.4)))
    step = make_mesh("Step", (stair, blue))
    place("Linked 1", step, (-2.7, -1.2, 0))
    place("Linked 2", step, (-1.7, -1.3, 0)).rotation_euler.z = 0.6
    place("Linked stretched", step, (-0.6, -1.3, 0)).scale = (1.3, 0.7, 1.6)
    place("Linked mirrored", step, (0.6, -1.3, 0)).scale = (-1, 1, 1)

    stool = stool_collection()
    for name, location, scale in (("Stool instance", (1.7, -1.3, 0), (1, 1, 1)), ("Stool mirrored", (2.7, -1.3, 0), (-1.2, 0.8, 1))):
        empty = place(name, None, location)
        empty.instance_type, empty.instance_collection, empty.scale = "COLLECTION", stool, scale

    subdivided = add_mesh("Subdivided", (block(0.8, 0.8, 0.8), orange), smooth=True, location=(-2.6, 0.6, 0))
    subdivision = subdivided.modifiers.new("Subdivision", "SUBSURF")
    # Bakes must use the render level, the viewport shows the other.
    subdivision.levels, subdivision.render_levels = 1, 3
    half = box((0, -0.15, 0), (0.5, 0.15, 0.3))
    wing = Shape(half.points + np.where((half.points[:, :1] > 0.4) & (half.points[:, 2:] > 0.2), (0, 0, 0.6), 0.0), half.faces)
    wing = wing._replace(faces=[face for face in wing.faces if wing.points[list(face), 0].max() > 0])
    add_mesh("Mirror modifier", (wing, green), location=(-1.1, 0.7, 0)).modifiers.new("Mirror", "MIRROR")
    post = add_mesh("Array modifier", (block(0.12, 0.12, 0.9), paint("Fence", (0.7, 0.65, 0.5))), location=(-0.1, 0.7, 0))
    array = post.modifiers.new("Array", "ARRAY")
    array.count, array.use_relative_offset, array.use_constant_offset = 5, False, True
    array.constant_offset_displace = (0.25, 0, 0)

    turntable = add_mesh("Turntable", (cylinder(0.55, 0, 0.12), orange), location=(2.0, 0.7, 0))
    turntable.rotation_euler.z, turntable.scale = 0.5, (1.2, 0.9, 1.0)
    arm = add_mesh("Turntable child", (block(0.2, 0.5, 0.4), green), location=(-0.2, 0, 0.12))
    arm.parent, arm.rotation_euler.z = turntable, 0.4
    tip = add_mesh("Turntable grandchild", (ball(0.14, 24), blue), smooth=True, location=(0, 0.1, 0.54))
    tip.parent = arm
    add_light("Point", "POINT", 70.0, (-1.2, -0.3, 2.0), (0, 0, 0), shadow_soft_size=0.05, color=(1.0, 0.85, 0.65))
    add_light("Area", "AREA", 90.0, (2.6, -0.8, 2.8), (1.0, 0.2, 0), shape="RECTANGLE", size=1.2, size_y=0.6, color=(0.8, 0.9, 1.0))
    add_camera((0, -6.4, 3.6), (0, -0.2, 0.2), 36)
