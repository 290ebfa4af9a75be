"""Filtering of the light at texels, and estimates of its error.

In: samples of light with variances. Out: filtered light, residual variance, the stated error of a bake.
Source: Buades et al. 2005 (non-local means); Rousselle et al. 2012 (dual buffers).
"""
