"""From baked pages to what objects wear: images, UV layers, materials, and the way back.

In: pages of a bake. Out: changed slots and layers, each marked as ours so that it can be taken off again.
"""
