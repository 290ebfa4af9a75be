"""A .glb of a baked scene.

In: a scene that wears its bake. Out: a file by Blender's exporter with lightmaps put in.
"""
