"""A scene as arrays, and rays through it.

In: a SceneSnapshot (triangles, materials, textures, lights) in metres and watts. Out: the surface at a hit, the nearest hit of a ray.
embreex is imported in rays alone.
Source: Walter et al. 2007 (GGX); Williams 1983 (mipmaps); Zeltner et al. 2022 (sheen); Conty Estevez et al. 2019 (bumps).
"""
