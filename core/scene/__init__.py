"""A scene as arrays, and rays through it.

In: a SceneSnapshot (triangles, materials, textures, lights) in metres and watts. Out: the surface at a hit, the nearest hit of a ray.
embreex is imported in rays alone.
"""
