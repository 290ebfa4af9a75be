"""The texels of charts: which parts of which triangles they cover.

In: a ChartAtlas. Out: a TexelMap with each texel's triangle, area, moments and neighbours; the metric of errors over texels.
"""
