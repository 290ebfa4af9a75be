"""Types, settings, messages and small mathematics that everything else uses.

In: nothing of a scene. Out: settings of a bake and its job, arrays, geometry, sampling, colours, file names, progress and warnings.
Source: Shirley & Chiu 1997 (warps); Owen 1995 (scrambled points).
"""
