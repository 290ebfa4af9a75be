"""What material nodes say: colours, images, attributes and formulas, without rendering.

In: node trees of materials. Out: colours as constants, images and functions of the mesh.
"""
