"""The two interiors."""

from __future__ import annotations

import furniture
import numpy as np
from blend_kit import add_camera, add_light, add_mesh, paint, set_world, start_scene, textured
from furniture import block
from shapes import ball, cylinder, floor_quad, polygon, shell

WALL_M = 0.2


def wood_planks(rng: np.random.Generator, side: int = 256, planks: int = 8) -> np.ndarray:
    """Tileable boards along u with their own tone, grain and dark joints.

    out  (side, side, 3) float32, sRGB
    """
    row, column = np.mgrid[0:side, 0:side]
    plank = row * planks // side
    shift = rng.integers(0, side, planks)
    tone = rng.uniform(-0.06, 0.06, planks)[plank]
    noise = rng.normal(size=(side, side))
    waves = np.fft.fftfreq(side) * side
    # Low along u, high along v: streaks.
    smoothing = np.exp(-((waves[None, :] / 5) ** 2) - (waves[:, None] / 60) ** 2)
    grain = np.fft.ifft2(np.fft.fft2(noise) * smoothing).real
    grain = 0.035 * grain / grain.std()
    joint = (row % (side // planks) == 0) | ((column + shift[plank]) % side < 1)
    value = np.where(joint, 0.5, 1.0 + tone + grain)
    return (np.array([0.66, 0.47, 0.31]) * value[..., None]).clip(0, 1).astype(np.float32)


def landscape(width: int = 128, height: int = 96) -> np.ndarray:
    """A sun over hills.

    out  (height, width, 3) float32, sRGB
    """
    v, u = np.mgrid[0:height, 0:width] / np.array([height, width]).reshape(2, 1, 1)
    picture = np.array([0.95, 0.75, 0.5]) + (np.array([0.35, 0.55, 0.8]) - np.array([0.95, 0.75, 0.5])) * v[..., None]
    picture[(u - 0.68) ** 2 * (width / height) ** 2 + (v - 0.62) ** 2 < 0.015] = (0.95, 0.9, 0.65)
    for level, wave, color in ((0.48, 5.0, (0.35, 0.45, 0.5)), (0.34, 8.0, (0.3, 0.45, 0.3)), (0.2, 6.0, (0.2, 0.3, 0.2))):
        picture[v < level + 0.07 * np.sin(wave * u + 10 * level)] = color
    return picture.astype(np.float32)


def furnished_room() -> None:
    """Figure 3 of the paper and more: a room of 5 x 4 x 2.7 m with sun, sky, a glowing ceiling lamp and a floor lamp."""
    rng = np.random.default_rng(1997)
    start_scene()
    set_world((0.75, 0.87, 1.0), 1.2)
    white, wood = paint("White paint", (0.8, 0.8, 0.77)), paint("Oak", (0.45, 0.28, 0.15))
    size, sill, lintel, south, north = (5.0, 4.0, 2.7), 0.9, 2.2, 1.1, 2.9
    grid = ((-WALL_M, 0, 5, 5 + WALL_M), (-WALL_M, 0, south, north, 4, 4 + WALL_M), (-WALL_M, 0, sill, lintel, 2.7, 2.7 + WALL_M))

    def is_solid(i: int, j: int, k: int) -> bool:
        is_window = i == 0 and j == 2 and k == 2
        return not is_window and (i in (0, 2) or j in (0, 4) or k in (0, 4))

    def is_outside(centre: np.ndarray) -> bool:
        return bool(np.any(centre < -WALL_M + 1e-6) or np.any(centre > np.array(size) + WALL_M - 1e-6))

    def is_wall(centre: np.ndarray, normal: np.ndarray) -> bool:
        is_level = bool(normal[2]) and not -WALL_M < centre[0] < 0
        return not is_outside(centre) and not is_level

    add_mesh("Walls", (shell(grid, is_solid, is_wall), paint("Wall paint", (0.78, 0.72, 0.6))))
    add_mesh("Exterior", (shell(grid, is_solid, lambda centre, normal: is_outside(centre)), paint("Render", (0.6, 0.6, 0.58))))
    planks = textured("Wood planks", wood_planks(rng), (2.5, 2.0))
    add_mesh("Floor", (floor_quad((0, 0), (5, 4)), planks), unit_uv=True)
    add_mesh("Ceiling", (floor_quad((0, 0), (5, 4), 2.7).flipped(), white))
    opening = furniture.window_frame(north - south, lintel - sill, 0.05, 0.06)
    add_mesh("Window frame", (opening.moved(-0.12, (south + north) / 2, (sill + lintel) / 2, turn=90), white))
    cloth = paint("Curtain cloth", (0.62, 0.26, 0.2))
    for name, y in (("Curtain left", south - 0.42), ("Curtain right", north + 0.02)):
        add_mesh(name, (furniture.curtain(0.4, 2.35, 4).moved(0.12, y, 0.02, turn=90), cloth))

    add_mesh("Rug", (block(2.6, 1.9, 0.012), paint("Rug wool", (0.2, 0.27, 0.42))), location=(2.5, 1.65, 0))
    add_mesh("Table", (furniture.table(1.5, 0.85, 0.75), wood), location=(2.5, 1.65, 0.012))
    blue = paint("Blue lacquer", (0.12, 0.3, 0.5))
    for number, x, y, turn in ((1, 2.15, 1.05, 180), (2, 2.9, 0.98, 168), (3, 2.1, 2.28, 4), (4, 2.85, 2.3, -3)):
        add_mesh(f"Chair {number}", (furniture.chair().moved(turn=turn), blue), location=(x, y, 0.012))
    add_mesh("Bowl", (furniture.bowl(), paint("Celadon", (0.45, 0.62, 0.5))), smooth=True, location=(2.7, 1.7, 0.762))

    sofa = furniture.sofa(1.9)
    fabric, cushion = paint("Sofa fabric", (0.35, 0.4, 0.3)), paint("Cushion fabric", (0.55, 0.58, 0.42))
    add_mesh("Sofa", (sofa["body"], fabric), (sofa["cushions"], cushion), smooth=True, location=(1.75, 3.55, 0))
    add_mesh("Shelf", (furniture.shelf(1.3, 0.32, 1.85, 5), wood), location=(3.75, 3.84, 0))
    cover_rgb = {"red": (0.55, 0.1, 0.08), "green": (0.1, 0.35, 0.18), "cream": (0.7, 0.62, 0.45)}
    covers = [paint(f"Book {color}", rgb) for color, rgb in cover_rgb.items()]
    rows = [(3.15, 0.755, 0.7), (3.55, 1.12, 0.75), (3.15, 1.485, 0.45), (3.2, 0.025, 0.9)]
    placed = [book.moved(x, 3.72, z) for x, z, width in rows for book in furniture.books(rng, width)]
    add_mesh("Books", *((book, covers[int(rng.integers(3))]) for book in placed))
    add_mesh("Vase", (furniture.vase(), paint("Terracotta", (0.6, 0.3, 0.17))), smooth=True, location=(3.6, 3.84, 1.85))
    add_mesh("Ball", (ball(0.11, 20), paint("Yellow rubber", (0.75, 0.55, 0.1))), smooth=True, location=(4.1, 3.82, 0.5))

    add_mesh("Picture frame", (furniture.frame(0.8, 0.6, 0.04, 0.03), wood), location=(1.75, 3.97, 1.65))
    canvas = polygon((-0.4, 0, -0.3), (0.4, 0, -0.3), (0.4, 0, 0.3), (-0.4, 0, 0.3))
    add_mesh("Picture", (canvas, textured("Landscape", landscape(), (1.0, 1.0))), unit_uv=True, location=(1.75, 3.985, 1.65))

    shade = paint("Lamp glass", (0.8, 0.8, 0.8), 6.0, (1.0, 0.85, 0.65))
    add_mesh("Ceiling lamp", (cylinder(0.32, -0.1, 0.0, 32), shade), location=(2.5, 1.65, 2.66))
    add_mesh("Floor lamp stand", (furniture.lamp_stand(1.5), paint("Dark iron", (0.08, 0.08, 0.08))), location=(0.42, 3.6, 0))
    add_mesh("Floor lamp shade", (furniture.lamp_shade(1.4), paint("Lamp paper", (0.8, 0.72, 0.55))), location=(0.42, 3.6, 0))
    add_light("Floor lamp", "POINT", 18.0, (0.42, 3.6, 1.56), (0.42, 3.6, 0), shadow_soft_size=0.04, color=(1.0, 0.8, 0.55))
    add_light("Sun", "SUN", 14.0, (-4, 1.1, 2.5), (0, 2.1, 0.1), angle=0.0093, color=(1.0, 0.93, 0.82))
    add_camera((4.8, 0.2, 1.6), (2.05, 2.6, 1.05), 19)


def two_rooms() -> None:
    """A bright and a dark room of 3 x 4 x 2.6 m, 0.1 m of wall with a doorway between them, one floor beneath it all."""
    start_scene()
    white, oak = paint("White paint", (0.6, 0.6, 0.6)), paint("Oak", (0.45, 0.28, 0.15))
    grid = ((-WALL_M, 0, 6.1, 6.1 + WALL_M), (-WALL_M, 0, 4, 4 + WALL_M), (0, 2.6))

    def is_inner(centre: np.ndarray, normal: np.ndarray) -> bool:
        return bool(0 <= centre[0] <= 6.1 and 0 <= centre[1] <= 4 and not normal[2])

    add_mesh("Walls", (shell(grid, lambda i, j, k: i != 1 or j != 1, is_inner), paint("Wall paint", (0.5, 0.5, 0.47))))
    add_mesh("Floor", (floor_quad((-WALL_M, -WALL_M), (6.1 + WALL_M, 4 + WALL_M)), paint("Screed", (0.35, 0.33, 0.3))))
    add_mesh("Ceiling", (floor_quad((-WALL_M, -WALL_M), (6.1 + WALL_M, 4 + WALL_M), 2.6).flipped(), white))

    def is_reveal_or_side(centre: np.ndarray, normal: np.ndarray) -> bool:
        # Ends, top and foot touch other surfaces, where nobody looks.
        return 0 < centre[1] < 4 and 0 < centre[2] < 2.6

    partition = shell(((3.0, 3.1), (0, 0.7, 1.5, 4), (0, 2.05, 2.6)), lambda i, j, k: not (j == 1 and k == 0), is_reveal_or_side)
    add_mesh("Partition", (partition, paint("Partition paint", (0.6, 0.48, 0.32))))
    add_mesh("Cabinet", (block(0.4, 1.0, 0.9), oak), location=(3.3, 2.6, 0))
    add_mesh("Sideboard", (block(0.4, 1.4, 0.75), oak), location=(2.8, 2.7, 0))
    add_mesh("Bench", (furniture.table(1.2, 0.35, 0.45), oak), location=(4.7, 3.825, 0))
    add_mesh("Stool", (block(0.4, 0.4, 0.45), paint("Green paint", (0.15, 0.4, 0.2))), location=(0.2, 1.6, 0))
    add_light("Ceiling light", "AREA", 90.0, (1.5, 1.9, 2.58), (1.5, 1.9, 0), shape="RECTANGLE", size=0.8, size_y=0.4)
    add_camera((5.85, 0.3, 1.6), (3.1, 2.0, 0.95), 20)
