"""UV charts and their places on pages.

In: a snapshot's meshes, with UV layers or without. Out: a ChartAtlas: each triangle's chart and place on a page.
Charts are found by xatlas, in a process of its own; packing and density are ours.
Source: Levy et al. 2002 (charts); Jylanki 2010 (packing).
"""
