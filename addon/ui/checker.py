"""A view of the texel density: drawn over the 3D View, so that nothing of the file changes."""

from __future__ import annotations

from typing import Any

import bpy
import gpu
from gpu_extras.batch import batch_for_shader

from ..show.redraw import redraw
from .checker_arrays import CheckerArrays, CheckerMaker

_STEP_S, _PAUSE_S = 0.03, 0.02  # of making it at a time, and until the next

_VERTEX = """
void main() {
    vec4 seen = ModelViewMatrix * vec4(pos, 1.0);
    if (ProjectionMatrix[3][3] == 0.0) seen.xyz *= 0.998;  // a little before the surface itself
    else seen.z += 0.002 / ProjectionMatrix[0][0];
    gl_Position = ProjectionMatrix * seen;
    at = texel;
    fineness = ratio;
    place = seen.xyz;
}
"""

# Squares of one texel, and of eight for the distance; each fades to grey before it would flicker.
_FRAGMENT = """
float squares(vec2 uv) {
    vec2 blur = max(fwidth(uv), vec2(1e-6));
    vec2 wave = 2.0 * abs(fract(uv * 0.5) - 0.5) - 0.5;
    vec2 side = clamp(wave / blur, -1.0, 1.0);
    return side.x * side.y * clamp(2.0 - 2.0 * max(blur.x, blur.y), 0.0, 1.0);
}
void main() {
    float finer = clamp(log2(fineness) / 1.5, -1.0, 1.0);
    vec3 tint = mix(vec3(0.30, 0.60, 0.34), finer > 0.0 ? vec3(0.85, 0.25, 0.16) : vec3(0.16, 0.36, 0.85), abs(finer));
    float facing = abs(normalize(cross(dFdx(place), dFdy(place))).z);
    float bright = 0.75 + 0.20 * squares(at / 8.0) + 0.12 * squares(at);
    color = vec4(tint * bright * (0.55 + 0.45 * facing), 1.0);
}
"""


class Checker:
    """What is drawn, and whether; it belongs to this Blender, not to a file."""

    def __init__(self) -> None:
        self._handle: Any = None
        self._shader: Any = None
        self._batch: Any = None
        self._version = -1  # of the scene's meter, that is drawn or being made
        self._maker: CheckerMaker | None = None
        self._made: CheckerArrays | None = None

    @property
    def on(self) -> bool:
        """Whether the checker is shown."""
        return self._handle is not None

    def show(self, on: bool) -> None:
        """Begin or end to draw."""
        if on and not self.on:
            self._handle = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), "WINDOW", "POST_VIEW")
        elif not on and self.on:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
            self._handle = self._batch = self._maker = self._made = None
            self._version = -1

    def work(self, context: bpy.types.Context) -> bool:
        """Go on making what is to be drawn; gives whether there is more to do."""
        self._made = self._maker.work(context, _STEP_S) if self._maker else None
        if self._made is not None:
            self._maker = None
        return self._maker is not None

    def _draw(self) -> None:
        context = bpy.context
        meter = context.window_manager.leaflight_meter
        meter.watch(context)
        if meter.estimate is None:
            return
        if self._version != meter.version and not meter.stale:
            factor = dict(meter.estimate.evened) | dict(zip(meter.estimate.too_large, meter.estimate.fitting, strict=True))
            self._maker, self._version = CheckerMaker(meter.estimate.density, factor), meter.version
            if not bpy.app.timers.is_registered(_tick):
                bpy.app.timers.register(_tick, first_interval=0.0)
        if self._made is not None:
            self._shader = self._shader or _make_shader()
            content = {"pos": self._made.position, "texel": self._made.texel, "ratio": self._made.ratio}
            self._batch, self._made = batch_for_shader(self._shader, "TRIS", content), None
        if self._batch is not None:
            gpu.state.depth_test_set("LESS_EQUAL")
            gpu.state.depth_mask_set(True)
            self._batch.draw(self._shader)
            gpu.state.depth_mask_set(False)
            gpu.state.depth_test_set("NONE")


def is_checker_on(context: bpy.types.Context) -> bool:
    """Whether the checker is shown."""
    return bool(context.window_manager.leaflight_checker.on)


def _tick() -> float | None:
    """The timer that makes what is drawn; ends when all is made."""
    context = bpy.context
    if context.window_manager.leaflight_checker.work(context):
        return _PAUSE_S
    redraw(context, "WINDOW")
    return None


def _make_shader() -> Any:
    about = gpu.types.GPUShaderCreateInfo()
    about.push_constant("MAT4", "ModelViewMatrix")
    about.push_constant("MAT4", "ProjectionMatrix")
    for index, (kind, name) in enumerate((("VEC3", "pos"), ("VEC2", "texel"), ("FLOAT", "ratio"))):
        about.vertex_in(index, kind, name)
    between = gpu.types.GPUStageInterfaceInfo("leaflight_checker")
    for kind, name in (("VEC2", "at"), ("FLOAT", "fineness"), ("VEC3", "place")):
        between.smooth(kind, name)
    about.vertex_out(between)
    about.fragment_out(0, "VEC4", "color")
    about.vertex_source(_VERTEX)
    about.fragment_source(_FRAGMENT)
    return gpu.shader.create_from_info(about)


class LEAFLIGHT_OT_checker(bpy.types.Operator):
    bl_idname = "leaflight.checker"
    bl_label = "Texel Checker"
    bl_description = (
        "Show how large texels are on what is to be baked: squares of one texel and of eight; "
        "green is the wanted density, blue coarser, red finer. It is drawn over the view and changes nothing"
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        checker: Checker = context.window_manager.leaflight_checker
        checker.show(not checker.on)
        redraw(context, "WINDOW")
        redraw(context, "UI")
        return {"FINISHED"}


CLASSES = (LEAFLIGHT_OT_checker,)


def register() -> None:
    """Have a checker that is not shown."""
    bpy.types.WindowManager.leaflight_checker = Checker()


def unregister() -> None:
    """Take it off the views and away."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    bpy.context.window_manager.leaflight_checker.show(False)
    del bpy.types.WindowManager.leaflight_checker
