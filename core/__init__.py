"""The core of Leaflight: light for surfaces given as numpy arrays; numpy and the standard library, never Blender.

This package imports nothing by itself, so that a worker or a panel loads only what it uses. What programs need:

    scene.scene     SceneSnapshot, SceneObject, Material, TextureImage, Light      util.settings   Settings
    scene.snapshot  save_snapshot, load_snapshot                                   util.job        Job and the names of its files
    bake.bake       run_bake                                                       util.messages   what it tells meanwhile

Each package imports only from those before it: util, parallel, scene, atlas, texels, lights, transport, radiosity, filter, integrate,
output, bake. The docstring of each says what goes in, what comes out and which papers it follows.

A grey floor of 2 m x 2 m under a lamp of 100 W, baked to `folder` (a pathlib.Path)::

    import numpy as np
    from leaflight.core.bake import bake
    from leaflight.core.scene import scene, snapshot
    from leaflight.core.util import job, settings

    corner = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], float)  # metres
    tri, zero, uv = np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.zeros(2, np.int32), np.zeros((2, 3, 2), np.float32)
    up = np.broadcast_to(np.float32([0, 0, 1]), (2, 3, 3))
    lamp = scene.Light("POINT", "Lamp", position_m=(1.0, 1.0, 1.5), power_rgb=(100.0, 100.0, 100.0))  # watts
    floor, grey = scene.SceneObject("Floor"), scene.Material("Grey", albedo_rgb=(0.5, 0.5, 0.5))
    room = scene.SceneSnapshot(corner, tri, zero, zero, zero, tri, up, uv.astype(float), uv, uv, (floor,), (grey,), lights=(lamp,))
    snapshot.save_snapshot(folder / job.SNAPSHOT_FILE, room)
    job.Job(settings.Settings(size=64, workers=1), output=str(folder), atlas_name="room").save(folder)
    bake.run_bake(folder, tell=print, should_stop=lambda: False)  # writes room_0.combined.exr and result.json

With more workers than one the calling script needs `if __name__ == "__main__":`, as for any use of multiprocessing.
"""
