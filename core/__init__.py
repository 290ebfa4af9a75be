"""The core of Leaflight: light for surfaces given as numpy arrays; numpy and the standard library, never Blender.

A grey floor of 2 m x 2 m under a lamp of 100 W::

    import numpy as np
    from leaflight import core
    from leaflight.core.scene import scene
    from leaflight.core.util.settings import Settings

    corner = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], float)  # metres
    tri, zero, uv = np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.zeros(2, np.int32), np.zeros((2, 3, 2), np.float32)
    up = np.broadcast_to(np.float32([0, 0, 1]), (2, 3, 3))
    lamp = scene.Light("POINT", "Lamp", position_m=(1.0, 1.0, 1.5), power_rgb=(100.0, 100.0, 100.0))  # watts
    floor, grey = scene.SceneObject("Floor"), scene.Material("Grey", albedo_rgb=(0.5, 0.5, 0.5))
    room = scene.SceneSnapshot(corner, tri, zero, zero, zero, tri, up, uv.astype(float), uv, uv, (floor,), (grey,), lights=(lamp,))
    light = core.solve(room, Settings(size=64, passes=("lighting",)))
    light.pages["lighting"]  # (1, 64, 64, 4), and light.tri_uv says where each triangle lies on it

What programs need:

    solve                                                      a scene in, arrays out, in this process
    bake.bake       run_bake                                   a folder in, image files out, in several processes
    scene.scene     SceneSnapshot, SceneObject, Material, TextureImage, Light
    scene.snapshot  save_snapshot, load_snapshot
    util.settings   Settings
    util.job        Job and the names of a folder's files
    util.messages   what a bake says meanwhile

Each package imports only from those before it: util, parallel, scene, atlas, texels, lights, transport, radiosity, filter, integrate,
output, bake. The docstring of each says what goes in, what comes out and which papers it follows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .bake.in_memory import SolvedLight
    from .scene.scene import SceneSnapshot
    from .util.messages import Message
    from .util.settings import Settings


def solve(
    scene: SceneSnapshot,
    settings: Settings,
    tell: Callable[[Message], None] = lambda message: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> SolvedLight:
    """The light of a scene, see bake.in_memory.solve_scene.

    That is imported by the call: workers and panels import this package for less.
    """
    from .bake.in_memory import solve_scene

    return solve_scene(scene, settings, tell, should_stop)
