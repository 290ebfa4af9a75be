"""Types, settings, messages and small mathematics that all other packages use. Knows nothing of scenes.

Out: settings of a bake and its job, array types, geometry, sampling, colours, file names, progress and warnings.
Source: Shirley & Chiu 1997 (warps); Owen 1995 (scrambled points).
"""
