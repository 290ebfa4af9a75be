"""From a Blender scene to a SceneSnapshot.

In: a context's evaluated objects as they render. Out: arrays of core.scene, and warnings that name what is left out.
"""
