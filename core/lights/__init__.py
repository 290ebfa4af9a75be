"""Lights: emission of photons, and direct light at points.

In: a snapshot's lights and emitting triangles. Out: emitted photons (position, direction, flux), and irradiance at points, with closed
forms.
Source: Lambert 1760 and Arvo 1994 (polygons); Conty Estevez & Kulla 2018 (many lights).
"""
