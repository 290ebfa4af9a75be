"""Light at texels without its noise, and how far it may be off.

In: samples of light with variances. Out: smoothed light, residual variance, the stated error of a bake.
Source: Buades et al. 2005 (non-local means); Rousselle et al. 2012 (dual buffers); Stein 1981.
"""
