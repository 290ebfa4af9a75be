"""Passes, pages and image files from the light at texels, and the report.

In: a light field and surfaces. Out: pages (h, w, 4), row 0 at the bottom, with margins and closed seams; files.
OpenImageIO is imported in image_file alone.
"""
