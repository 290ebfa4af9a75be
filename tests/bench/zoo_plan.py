"""What a seed of the zoo draws: rooms or an outdoor set, lamps, furniture, paints, and how it is to be baked. No bpy, nothing is built.

The numbers come from Python's own generator, by `random()` alone, whose sequence is the same in every version.
"""

import math
import random
from collections.abc import Sequence
from dataclasses import replace

from zoo_scene import Lamp, Paint, Plan, Rect, Thing
from zoo_shapes import LEAST_DETAIL, ROUND, Hole, Part, Place, Vec, count_triangles

SIZES = ((256, 4.0), (384, 2.0), (512, 2.0), (768, 1.0), (1024, 1.5))
TRIANGLES = (500, 200_000)
GAP_M = (0.001, 0.1)  # between an emitting mesh and the surface it sits on
NOT_BAKED = 1 / 3
MAX_LAMPS = 50


def draw_plan(seed: int, max_size: int = 0, max_triangles: int = 0) -> Plan:
    """The scene of a seed.

    max_size, max_triangles   bounds for quick runs: the rest of the scene stays what it is
    """
    return _Draw(seed).draw(max_size, max_triangles)


class _Dice:
    """Draws from one stream."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed * 2654435761 % 2**32).random

    def between(self, low: float, high: float) -> float:
        return low + (high - low) * self.random()

    def by_size(self, low: float, high: float) -> float:
        """Uniform in the logarithm."""
        return low * (high / low) ** self.random()

    def chance(self, share: float) -> bool:
        return self.random() < share

    def pick(self, items: Sequence, weights: Sequence[float] = ()):
        """One of them, in proportion to the weights."""
        left = self.random() * (sum(weights) if weights else len(items))
        for item, weight in zip(items, weights or [1.0] * len(items), strict=True):
            left -= weight
            if left < 0.0:
                return item
        return items[-1]


class _Draw:
    """The scene of a seed while it is drawn."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.dice = _Dice(seed)
        self.paints: list[Paint] = []
        self.things: list[Thing] = []
        self.lamps: list[Lamp] = []
        self.gaps: list[float] = []
        self.taken: list[tuple[float, float, float]] = []  # x, y, radius of what stands on the floor

    def draw(self, max_size: int, max_triangles: int) -> Plan:
        dice = self.dice
        outdoor = dice.chance(0.2)
        self.light = dice.pick(("bright", "ordinary", "black"), (4.0, 4.0, 2.0))
        self.walls = dice.pick(("boxes", "planes"), (6.0, 4.0))
        self.openness = "open" if outdoor else dice.pick(("closed", "windows", "roofless"), (4.0, 5.0, 1.0))
        self.height = dice.between(2.2, 3.6)
        self.textures = dice.chance(0.65)
        self.plain = [self._add_paint() for _ in range(8)]
        self.sky = (0.0, 0.0, 0.0)
        rooms = self._draw_grounds() if outdoor else self._draw_house()
        self.rooms = rooms
        self._draw_lights(outdoor)
        for room in rooms:
            self._furnish(room, outdoor)
        self._draw_daylight(outdoor)
        size, layout, joined = dice.pick(*zip(*SIZES, strict=True)), dice.pick(("xatlas", "smart")), dice.chance(0.4)
        target = dice.by_size(*TRIANGLES)
        things = self._refine(self._choose_baked(), min(target, max_triangles or target))
        return Plan(
            self.seed,
            "outdoor" if outdoor else "rooms",
            tuple(rooms),
            self.height,
            self.walls,
            self.openness,
            self.light,
            tuple(self.paints),
            tuple(things),
            tuple(self.lamps),
            tuple(self.gaps),
            self.sky,
            layout,
            joined,
            min(size, max_size or size),
        )

    # -- paints --

    def _add_paint(self) -> int:
        dice = self.dice
        low, high = {"bright": (0.6, 0.9), "ordinary": (0.15, 0.7), "black": (0.02, 0.08)}[self.light]
        level, tint = dice.between(low, high), dice.pick((0.0, 0.15, 0.6), (4.0, 3.0, 1.0))
        color = tuple(level * (1.0 - tint * dice.random()) for _ in range(3))
        texture = dice.pick(("checker", "bricks", "noise", "stripes")) if self.textures and dice.chance(0.5) else ""
        self.paints.append(Paint(color, texture, dice.pick(("diffuse", "principled"))))
        return len(self.paints) - 1

    def _add_glow(self, power_w: float, area_m2: float, color: Vec) -> int:
        radiance = power_w / (math.pi * area_m2)
        texture = "checker" if self.textures and self.dice.chance(0.15) else ""
        self.paints.append(Paint((0.5, 0.5, 0.5), texture, "principled", tuple(radiance * channel for channel in color)))
        return len(self.paints) - 1

    def _paint(self) -> int:
        return self.dice.pick(self.plain)

    # -- what rooms are made of --

    def _draw_house(self) -> list[Rect]:
        """Rooms by halving a rectangle; every wall between two has a door."""
        dice = self.dice
        count = dice.pick((1, 2, 3, 4), (3.0, 3.0, 2.0, 2.0))
        rooms: list[Rect] = [(0.0, 0.0, dice.between(2.8, 4.5) * math.sqrt(count), dice.between(2.8, 4.5) * math.sqrt(count))]
        inner: list[tuple[bool, float, float, float]] = []  # whether it runs along y; where; from, to
        while len(rooms) < count:
            room = max(rooms, key=lambda rect: (rect[2] - rect[0]) * (rect[3] - rect[1]))
            rooms.remove(room)
            x0, y0, x1, y1 = room
            share = dice.between(0.38, 0.62)
            if x1 - x0 > y1 - y0:
                cut = x0 + share * (x1 - x0)
                inner.append((True, cut, y0, y1))
                rooms += [(x0, y0, cut, y1), (cut, y0, x1, y1)]
            else:
                cut = y0 + share * (y1 - y0)
                inner.append((False, cut, x0, x1))
                rooms += [(x0, y0, x1, cut), (x0, cut, x1, y1)]
        x1, y1 = max(room[2] for room in rooms), max(room[3] for room in rooms)
        thin, thick = dice.by_size(0.01, 0.03), dice.between(0.08, 0.25)
        self.thickness = dice.pick((thin, thick), (2.0, 3.0))
        self._add_slabs(x1, y1)
        for along_y, at, low, high in inner:
            self._add_wall(along_y, at, low, high, self._cut_door(high - low))
        for along_y, at, length in ((True, 0.0, y1), (True, x1, y1), (False, 0.0, x1), (False, y1, x1)):
            has_window = self.openness == "windows" and dice.chance(0.7)
            self._add_wall(along_y, at, 0.0, length, self._cut_windows(length) if has_window else ())
        return rooms

    def _add_slabs(self, x1: float, y1: float) -> None:
        depth = 0.1 if self.walls == "boxes" else 0.0
        middle, size = (x1 / 2, y1 / 2), (x1 + 0.3, y1 + 0.3, depth)
        kind = "box" if depth else "panel"
        floor = Part(kind, size, self._paint())
        self.things.append(Thing("Floor", (floor,), Place(*middle, -depth), "structure"))
        if self.openness != "roofless":
            ceiling = Part(kind, size, self._paint())
            tilt = 0.0 if depth else 180.0
            self.things.append(Thing("Ceiling", (ceiling,), Place(*middle, self.height, tilt=tilt), "structure"))

    def _add_wall(self, along_y: bool, at: float, low: float, high: float, holes: tuple[Hole, ...]) -> None:
        """One box, which reaches into what it meets, or a plane on each of its sides.

        Its ends lie within the wall they meet: of two faces in one plane that look the same way Cycles lets each shade the other.
        """
        name = f"Wall {len(self.things)}"
        middle = (low + high) / 2
        x, y = (at, middle) if along_y else (middle, at)
        turn = 90.0 if along_y else 0.0
        paint = self._paint()
        if self.walls == "boxes":
            part = Part("wall", (high - low + self.thickness / 2, self.thickness, self.height), paint, holes=holes)
            self.things.append(Thing(name, (part,), Place(x, y, 0.0, turn), "structure"))
            return
        size, half = (high - low, 0.0, self.height), self.thickness / 2
        front = Part("wall", size, paint, Place(0.0, -half), holes=holes)
        mirrored = tuple((-right, -left, bottom, top) for left, right, bottom, top in holes)
        back = Part("wall", size, self._paint(), Place(0.0, half, turn=180.0), holes=mirrored)
        self.things.append(Thing(name, (front, back), Place(x, y, 0.0, turn), "structure"))

    def _cut_door(self, length: float) -> tuple[Hole, ...]:
        width = min(self.dice.between(0.7, 1.4), 0.6 * length)
        at = self.dice.between(-0.45, 0.45) * (length - width)
        return ((at - width / 2, at + width / 2, 0.0, min(self.dice.between(1.9, 2.2), self.height - 0.15)),)

    def _cut_windows(self, length: float) -> tuple[Hole, ...]:
        count = self.dice.pick((1, 2, 3), (3.0, 2.0, 1.0))
        pitch = length / count
        holes = []
        for index in range(count):
            width, bottom = pitch * self.dice.between(0.25, 0.7), self.dice.between(0.3, 1.1)
            middle = pitch * (index + 0.5) - length / 2
            holes.append((middle - width / 2, middle + width / 2, bottom, self.height - self.dice.between(0.2, 0.6)))
        return tuple(holes)

    def _draw_grounds(self) -> list[Rect]:
        """Ground, huts, free walls; gives the one area that is furnished."""
        dice = self.dice
        side = dice.between(8.0, 20.0)
        self.thickness = dice.by_size(0.02, 0.25)
        if dice.chance(0.5):
            ground = Part("sheet", (side, side, 0.3), self._paint(), detail=12, smooth=True)
            self.things.append(Thing("Ground", (ground,), Place(side / 2, side / 2, -0.2), "structure"))
        else:
            self.things.append(Thing("Ground", (Part("panel", (side, side, 0.0), self._paint()),), Place(side / 2, side / 2), "structure"))
        for index in range(dice.pick((0, 1, 2))):
            wide, deep, high = dice.between(2.0, 4.0), dice.between(2.0, 4.0), dice.between(2.0, 3.0)
            thick, paint = self.thickness, self._paint()
            door: tuple[Hole, ...] = ((-0.5, 0.5, 0.0, 1.9),)
            parts = [
                Part("wall", (wide, thick, high), paint, Place(0.0, -deep / 2), holes=door),
                Part("wall", (wide, thick, high), paint, Place(0.0, deep / 2)),
                Part("wall", (deep, thick, high), paint, Place(-wide / 2, 0.0, turn=90.0)),
                Part("wall", (deep, thick, high), paint, Place(wide / 2, 0.0, turn=90.0)),
                Part("box", (wide + 0.4, deep + 0.4, 0.08), self._paint(), Place(z=high)),
            ]
            x, y, turn = self._find_place((0.0, 0.0, side, side), 2.2)
            self.things.append(Thing(f"Hut {index}", tuple(parts), Place(x, y, 0.0, turn), "structure"))
        return [(0.0, 0.0, side, side)]

    # -- lamps --

    def _draw_lights(self, outdoor: bool) -> None:
        dice = self.dice
        dark_outside = not outdoor or dice.chance(0.4)
        self.night = outdoor and dark_outside
        count = min(MAX_LAMPS, int(dice.by_size(1.0, MAX_LAMPS + 1.0))) if dark_outside else 0
        favourite = dice.pick(("POINT", "SPOT", "AREA", "mesh", "any"), (1.0, 1.0, 1.0, 1.5, 2.0))
        levels = [dice.by_size(0.05, 1.0) for _ in self.rooms]
        for index in range(count):
            of_room = index % len(self.rooms) if dice.chance(0.8) else 0
            room, level = self.rooms[of_room], 1.0 if not of_room else levels[of_room]
            mixed = favourite == "any" or dice.chance(0.25)
            kind = dice.pick(("POINT", "SPOT", "AREA", "mesh")) if mixed else favourite
            power = level * dice.by_size(20.0, 200.0) / math.sqrt(count)
            color = dice.pick(((1.0, 1.0, 1.0), (1.0, 0.75, 0.45), (0.6, 0.75, 1.0), (1.0, 0.3, 0.25)), (4.0, 3.0, 1.0, 0.5))
            if kind == "mesh":
                self._add_emitter(room, power, color, outdoor)
            else:
                self._add_lamp(kind, room, power, color, outdoor)

    def _add_lamp(self, kind: str, room: Rect, power: float, color: Vec, outdoor: bool) -> None:
        dice = self.dice
        x, y = self._point_in(room, 0.25)
        z = self.height - dice.pick(
            (dice.by_size(0.05, 0.3), dice.between(0.3, 1.0), self.height - dice.between(0.3, 1.2)), (3.0, 3.0, 1.0)
        )
        target = (x, y, 0.0) if dice.chance(0.5) else (*self._point_in(room, 0.3), 0.0)
        if kind == "AREA":
            extent = (dice.by_size(0.1, 1.2), dice.by_size(0.1, 1.2))
            shape = dice.pick(("SQUARE", "RECTANGLE", "DISK", "ELLIPSE"))
            self.lamps.append(Lamp(kind, (x, y, z), (x, y, 0.0), power, color, extent, shape))
            return
        radius = 0.0 if dice.chance(0.2) else dice.by_size(0.01, 0.12)
        self.lamps.append(
            Lamp(
                kind,
                (x, y, z),
                target,
                power,
                color,
                (radius, 0.0),
                cone_rad=dice.between(0.5, 2.4),
                blend=dice.pick((0.0, 0.15, 0.6, 1.0)),
            )
        )

    def _add_emitter(self, room: Rect, power: float, color: Vec, outdoor: bool) -> None:
        """A glowing panel, tube, ball or ring beside the ceiling, a wall or the floor."""
        dice = self.dice
        gap = dice.by_size(*GAP_M)
        wide, deep = dice.by_size(0.1, 1.2), dice.by_size(0.05, 0.6)
        kind = dice.pick(("panel", "box", "ball", "torus", "cylinder"), (3.0, 3.0, 1.0, 1.0, 1.0))
        at = "floor" if self.openness in ("roofless", "open") else dice.pick(("ceiling", "wall", "floor"), (5.0, 3.0, 1.0))
        size = {"panel": (wide, deep, 0.0), "box": (wide, deep, 0.03)}.get(kind, (deep, deep, deep if kind == "ball" else 0.1))
        area = 2.0 * (size[0] * size[1] + (size[0] + size[1]) * size[2])
        paint = self._add_glow(power, area, color)
        detail = 12 if kind in ROUND else 0
        x, y = self._point_in(room, 0.4)
        if at == "ceiling":
            part = Part(kind, size, paint, detail=detail, smooth=bool(detail), place=Place(tilt=180.0 if kind == "panel" else 0.0))
            place = Place(x, y, self.height - gap - size[2], dice.pick((0.0, dice.between(0.0, 90.0))))
        elif at == "floor":
            part = Part(kind, size, paint, detail=detail, smooth=bool(detail))
            place = Place(x, y, gap, dice.between(0.0, 90.0))
        else:  # on the wall at the room's low y, looking into the room
            part = Part(kind, size, paint, Place(tilt=-90.0), detail=detail, smooth=bool(detail))
            place = Place(x, room[1] + self.thickness / 2 + gap, dice.between(0.8, self.height - 0.5))
        self.gaps.append(gap)
        self.things.append(Thing(f"Glow {len(self.things)}", (part,), place, "emitter", "floats"))

    def _draw_daylight(self, outdoor: bool) -> None:
        """Sky and sun of what is open; every scene has some light."""
        dice = self.dice
        if self.openness == "closed":
            return
        level = dice.by_size(0.005, 0.05) if self.night else dice.by_size(0.2, 2.0)
        self.sky = tuple(level * (1.0 - shift) for shift in ((0.3, 0.15, 0.0) if dice.chance(0.6) else (0.0, 0.0, 0.0)))
        if not self.night and dice.chance(0.6):
            turn, height = dice.between(0.0, 2.0 * math.pi), dice.between(0.4, 1.3)
            towards = (math.cos(turn) * math.cos(height), math.sin(turn) * math.cos(height), math.sin(height))
            sun = Lamp(
                "SUN",
                (0.0, 0.0, 20.0),
                tuple(-20.0 * axis + 20.0 * up for axis, up in zip(towards, (0, 0, 1), strict=True)),
                0.0,
                (1.0, 0.93, 0.8),
            )
            self.lamps.append(replace(sun, power=dice.by_size(1.0, 8.0), extent=(dice.pick((0.0, 0.00918, 0.1)), 0.0)))

    # -- furniture --

    def _point_in(self, room: Rect, margin: float) -> tuple[float, float]:
        x0, y0, x1, y1 = room
        return self.dice.between(x0 + margin, max(x0 + margin, x1 - margin)), self.dice.between(y0 + margin, max(y0 + margin, y1 - margin))

    def _find_place(self, room: Rect, radius: float) -> tuple[float, float, float]:
        """x, y and turn: the freest of some places; one time in six just any, so that things interpenetrate."""
        dice = self.dice
        tries = [self._point_in(room, min(radius, 0.9)) for _ in range(1 if dice.chance(0.17) else 6)]

        def freedom(point: tuple[float, float]) -> float:
            return min((math.dist(point, other[:2]) - other[2] for other in self.taken), default=0.0)

        x, y = max(tries, key=freedom)
        self.taken.append((x, y, radius))
        return x, y, dice.pick((0.0, 90.0, dice.between(0.0, 360.0)))

    def _furnish(self, room: Rect, outdoor: bool) -> None:
        dice = self.dice
        makers = (
            self._make_table,
            self._make_shelf,
            self._make_seat,
            self._make_round,
            self._make_pillar,
            self._make_screen,
            self._make_heap,
        )
        weights = (2.0, 2.0, 2.0, 3.0, 1.5, 1.0, 1.0)
        if outdoor:
            makers, weights = (*makers, self._make_tree), (1.0, 0.5, 1.0, 3.0, 2.0, 2.0, 2.0, 4.0)
        area = (room[2] - room[0]) * (room[3] - room[1])
        for _ in range(int(dice.between(0.15, 0.45) * min(area, 60.0)) + 1):
            dice.pick(makers, weights)(room)
        if not outdoor and self.openness != "roofless" and dice.chance(0.7):
            self._hang_shade(room)

    def _add(self, name: str, parts: Sequence[Part], room: Rect, radius: float) -> Thing:
        """On the floor: it touches it, floats a little above, or sinks in."""
        dice = self.dice
        x, y, turn = self._find_place(room, radius)
        stands = dice.pick(("touches", "floats", "sinks"), (6.0, 2.0, 2.0))
        z = {"touches": 0.0, "floats": dice.by_size(0.0005, 0.01), "sinks": -dice.by_size(0.001, 0.05)}[stands]
        thing = Thing(f"{name} {len(self.things)}", tuple(parts), Place(x, y, z, turn), stands=stands)
        self.things.append(thing)
        return thing

    def _make_table(self, room: Rect) -> None:
        dice, paint = self.dice, self._paint()
        x, y, z = dice.between(0.6, 1.6), dice.between(0.5, 0.9), dice.between(0.4, 0.8)
        leg = dice.between(0.03, 0.08)
        top = Part(dice.pick(("box", "bevelled")), (x, y, 0.04), paint, Place(z=z - 0.04), smooth=dice.chance(0.3))
        legs = [
            Part("box", (leg, leg, z - 0.04), paint, Place(side * (x - leg) / 2, end * (y - leg) / 2))
            for side in (-1, 1)
            for end in (-1, 1)
        ]
        table = self._add("Table", (top, *legs), room, x / 2)
        for _ in range(dice.pick((0, 1, 3))):
            place = table.place
            part = self._round_part(dice.between(0.08, 0.3))
            turn = math.radians(place.turn)
            a, b = dice.between(-0.35, 0.35) * x, dice.between(-0.35, 0.35) * y
            spot = Place(place.x + a * math.cos(turn) - b * math.sin(turn), place.y + a * math.sin(turn) + b * math.cos(turn), place.z + z)
            self.things.append(Thing(f"Piece {len(self.things)}", (part,), spot))

    def _make_shelf(self, room: Rect) -> None:
        """Boards with rows of books: many small charts."""
        dice, paint = self.dice, self._paint()
        wide, deep, boards = dice.between(0.5, 1.4), dice.between(0.2, 0.4), dice.pick((2, 3, 4))
        pitch = dice.between(0.3, 0.45)
        parts = [Part("box", (wide, deep, 0.025), paint, Place(z=level * pitch)) for level in range(boards + 1)]
        parts += [Part("box", (0.025, deep, boards * pitch + 0.025), paint, Place(side * wide / 2)) for side in (-1, 1)]
        for level in range(boards):
            x = -wide / 2 + 0.02
            while dice.chance(0.9) and x < wide / 2 - 0.1:
                thick, high = dice.between(0.02, 0.08), pitch * dice.between(0.5, 0.85)
                book = Place(
                    x + thick / 2, dice.between(-0.03, 0.03), level * pitch + 0.025, tilt=dice.pick((0.0, dice.between(-8.0, 8.0)))
                )
                parts.append(Part("box", (thick, deep * 0.7, high), self._paint(), book))
                x += thick + dice.pick((0.0, 0.001, dice.between(0.0, 0.1)))
        self._add("Shelf", parts, room, wide / 2)

    def _make_seat(self, room: Rect) -> None:
        dice, paint = self.dice, self._paint()
        wide, deep = dice.between(0.5, 1.8), dice.between(0.5, 0.9)
        smooth = dice.chance(0.6)
        parts = [
            Part("bevelled", (wide, deep, 0.3), paint, smooth=smooth),
            Part("cushion", (wide * 0.95, deep * 0.9, 0.22), self._paint(), Place(z=0.26), detail=6, smooth=smooth),
            Part("bevelled", (wide, 0.15, 0.8), paint, Place(y=deep / 2), smooth=smooth),
        ]
        self._add("Seat", parts, room, wide / 2)

    def _round_part(self, across: float) -> Part:
        dice = self.dice
        kind = dice.pick(("ball", "rock", "torus", "cushion", "cylinder", "shade", "box", "bevelled"))
        size = (across, across * dice.between(0.6, 1.4), across * dice.between(0.4, 1.5))
        tilt = dice.between(0.0, 60.0) if dice.chance(0.15) else 0.0
        return Part(kind, size, self._paint(), Place(tilt=tilt), detail=12 if kind in ROUND else 0, smooth=dice.chance(0.6))

    def _make_round(self, room: Rect) -> None:
        across = self.dice.by_size(0.15, 1.2)
        self._add("Solid", (self._round_part(across),), room, across / 2)

    def _make_pillar(self, room: Rect) -> None:
        """From the floor into the ceiling, turned by any angle."""
        dice = self.dice
        across, kind = dice.between(0.08, 0.5), dice.pick(("box", "cylinder", "bevelled"))
        part = Part(kind, (across, across, self.height), self._paint(), detail=12 if kind in ROUND else 0, smooth=kind == "cylinder")
        pillar = self._add("Pillar", (part,), room, across)
        self.things[-1] = replace(pillar, place=replace(pillar.place, turn=dice.between(0.0, 90.0)))

    def _make_screen(self, room: Rect) -> None:
        """A free-standing thin wall, with an opening or without."""
        dice = self.dice
        wide, high = dice.between(0.8, 2.2), dice.between(1.0, min(2.4, self.height))
        holes: tuple[Hole, ...] = ((-wide / 6, wide / 5, high / 3, high * 0.7),) if dice.chance(0.4) else ()
        part = Part("wall", (wide, dice.by_size(0.004, 0.12), high), self._paint(), holes=holes)
        screen = self._add("Screen", (part,), room, wide / 2)
        self.things[-1] = replace(screen, place=replace(screen.place, turn=dice.between(0.0, 180.0)))

    def _make_heap(self, room: Rect) -> None:
        """Boxes that lie against and in each other."""
        dice = self.dice
        parts = []
        for _ in range(int(dice.between(3.0, 25.0))):
            across = dice.by_size(0.05, 0.3)
            place = Place(
                dice.between(-0.4, 0.4), dice.between(-0.4, 0.4), dice.between(-0.05, 0.25), dice.between(0, 90), dice.between(0, 40)
            )
            parts.append(Part("box", (across, across * dice.between(0.5, 1.5), across), self._paint(), place))
        self._add("Heap", parts, room, 0.5)

    def _make_tree(self, room: Rect) -> None:
        """A trunk and a crown, of one lump or of leaves."""
        dice = self.dice
        high, crown = dice.between(1.5, 4.0), dice.between(0.8, 2.2)
        parts = [Part("cylinder", (0.2, 0.2, high), self._paint(), detail=8, smooth=True)]
        if dice.chance(0.6):
            parts.append(Part("rock", (crown, crown, crown), self._paint(), Place(z=high - 0.3), detail=12, smooth=dice.chance(0.5)))
        else:
            paint = self._paint()
            for _ in range(int(dice.between(20.0, 120.0))):
                spot = [dice.between(-crown / 2, crown / 2) for _ in range(2)]
                leaf = Place(*spot, high + dice.between(-0.4, crown - 0.4), dice.between(0.0, 360.0), dice.between(-80.0, 80.0))
                parts.append(Part("panel", (dice.between(0.1, 0.3), dice.between(0.1, 0.3), 0.0), paint, leaf))
        self._add("Tree", parts, room, 0.6)

    def _hang_shade(self, room: Rect) -> None:
        """A lampshade or a ball on a rod that reaches into the ceiling."""
        dice = self.dice
        long, across = dice.between(0.2, 0.9), dice.between(0.15, 0.6)
        kind = dice.pick(("shade", "ball", "torus", "bevelled"))
        parts = (
            Part("cylinder", (0.02, 0.02, long + 0.02), self._paint(), Place(z=0.0), detail=6, smooth=True),
            Part(
                kind, (across, across, across * 0.6), self._paint(), Place(z=-across * 0.5), detail=12 if kind in ROUND else 0, smooth=True
            ),
        )
        x, y = self._point_in(room, 0.5)
        self.things.append(Thing(f"Pendant {len(self.things)}", parts, Place(x, y, self.height - long), stands="hangs"))

    # -- the whole --

    def _choose_baked(self) -> list[Thing]:
        """A third of the things is not baked; what rooms are made of least often."""
        keys = []
        for index, thing in enumerate(self.things):
            weight = 0.3 if thing.role == "structure" else 1.0
            keys.append((self.dice.random() ** (1.0 / weight), index))
        left_out = {index for _, index in sorted(keys, reverse=True)[: round(NOT_BAKED * len(self.things))]}
        return [replace(thing, baked=index not in left_out) for index, thing in enumerate(self.things)]

    def _refine(self, things: list[Thing], target: float) -> list[Thing]:
        """Round shapes get the detail by which the whole has the wanted triangles, as nearly as it can be had."""

        parts = [part for thing in things for part in thing.parts]
        fixed = sum(count_triangles(part) for part in parts if part.kind not in ROUND)
        parts = [part for part in parts if part.kind in ROUND]
        low, high = 0.3, 40.0
        for _ in range(16):
            factor = math.sqrt(low * high)
            if fixed + sum(count_triangles(_scale_detail(part, factor)) for part in parts) > target:
                high = factor
            else:
                low = factor
        return [replace(thing, parts=tuple(_scale_detail(part, low) for part in thing.parts)) for thing in things]


def _scale_detail(part: Part, factor: float) -> Part:
    if part.kind not in ROUND:
        return part
    return replace(part, detail=max(LEAST_DETAIL, 2 * round(part.detail * factor / 2.0)))
