"""Lights: how they emit photons, and the direct light they send to a point.

In: a snapshot's lights and emitting triangles. Out: births of photons (position, direction, flux), and
irradiance at points, with closed forms.
Source: Lambert 1760 and Arvo 1994 (polygons); Conty Estevez & Kulla 2018 (many lights).
"""
