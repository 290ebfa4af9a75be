"""The quadtrees of light over charts.

In: deposits of photons on texels. Out: Galerkin coefficients of irradiance on nodes, and which nodes to split.
Source: Tobler, Feda, Purgathofer & Wilkie 1997, eq. 9 and 10; Feda 1996.
"""
