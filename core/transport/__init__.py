"""Photons from lights through the scene.

In: emitters, surfaces, random numbers of a shard. Out: hits (triangle, u, v, flux) and the energy audit.
Source: Pattanaik & Mudur 1992 (particle tracing); Veach 1997 (Russian roulette, splitting, shading normals).
"""
