"""What a scene of the zoo is: paints, things, lamps, and the plan of the whole. No bpy."""

from dataclasses import dataclass

from zoo_shapes import Part, Place, Vec, count_triangles

Rect = tuple[float, float, float, float]  # x and y from, x and y to, metres


@dataclass(frozen=True)
class Paint:
    """A diffuse material.

    color     albedo, linear
    texture   "", "checker", "bricks", "noise" or "stripes": the colour varies between it and its half
    shader    "diffuse" or "principled" (without specular)
    glow      radiance that it emits, W/m^2/sr; 0 of most
    """

    color: Vec
    texture: str = ""
    shader: str = "diffuse"
    glow: Vec = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Thing:
    """One object: parts in one frame.

    role    "structure", "furniture" or "emitter"
    stands  how it meets what is beside it: "touches", "hangs", "floats" or "sinks"
    """

    name: str
    parts: tuple[Part, ...]
    place: Place
    role: str = "furniture"
    stands: str = "touches"
    baked: bool = True


@dataclass(frozen=True)
class Lamp:
    """A light of Blender's.

    kind     POINT, SPOT, SUN or AREA
    power    W, of a sun W/m^2
    extent   radius of a point or spot, m; angle of a sun, rad; sides of an area, m
    """

    kind: str
    place: Vec
    target: Vec
    power: float
    color: Vec
    extent: tuple[float, float] = (0.0, 0.0)
    shape: str = "SQUARE"
    cone_rad: float = 1.0
    blend: float = 0.2


@dataclass(frozen=True)
class Plan:
    """A whole scene.

    kind      "rooms" or "outdoor"
    walls     "boxes" or "planes"
    openness  "closed", "windows" or "roofless"; of an outdoor set "open"
    light     "bright", "ordinary" or "black": of the paints
    layout    "xatlas" (no layer; Leaflight unwraps) or "smart" (a layer by Blender's Smart UV Project)
    sky       radiance of the world, W/m^2/sr
    gaps      metres, of the emitting meshes
    """

    seed: int
    kind: str
    rooms: tuple[Rect, ...]
    height: float
    walls: str
    openness: str
    light: str
    paints: tuple[Paint, ...]
    things: tuple[Thing, ...]
    lamps: tuple[Lamp, ...]
    gaps: tuple[float, ...]
    sky: Vec
    layout: str
    joined: bool
    size: int

    @property
    def lights(self) -> int:
        """Lamps and emitting meshes."""
        return len(self.lamps) + sum(thing.role == "emitter" for thing in self.things)

    @property
    def triangles(self) -> int:
        return sum(count_triangles(part) for thing in self.things for part in thing.parts)

    @property
    def baked(self) -> int:
        return sum(thing.baked for thing in self.things)


def describe(plan: Plan) -> str:
    """One line of what was drawn."""
    place = (
        "outdoor set"
        if plan.kind == "outdoor"
        else f"{len(plan.rooms)} room{'s' * (len(plan.rooms) > 1)}, {plan.openness}, walls of {plan.walls}"
    )
    kinds = [lamp.kind.lower() for lamp in plan.lamps] + ["mesh"] * (plan.lights - len(plan.lamps))
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in ("point", "spot", "sun", "area", "mesh") if kind in kinds)
    gaps = f", nearest {min(plan.gaps) * 1e3:.1f} mm from a surface" if plan.gaps else ""
    sky = ", sky" if any(plan.sky) else ""
    texture = "textured" if any(paint.texture for paint in plan.paints) else "plain"
    return (
        f"seed {plan.seed}: {place}; {plan.lights} lamps ({counts or 'none'}{gaps}){sky}; {len(plan.things)} objects, "
        f"{len(plan.things) - plan.baked} not baked, {'joined' if plan.joined else 'separate'}; {plan.triangles:,} triangles; "
        f"{plan.light} {texture} paints; {plan.layout}, {plan.size}²"
    )
