"""Light at texels to passes, pages and image files, and the report.

In: a light field and surfaces. Out: pages (h, w, 4), row 0 at the bottom, with margins and seams closed; files.
OpenImageIO is imported in image_file alone.
"""
