"""Light at texels by rays: shadow rays to lights, and gathering from surfaces.

In: a traced scene, texels, known light on surfaces. Out: fields of (mean, variance, count) per texel, and where more rays help most.
Source: Reichert 1992 and Jensen 2001, 9.2 (final gathering); Heitz et al. 2018 (ratio estimator).
"""
