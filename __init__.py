"""Leaflight: bakes diffuse global illumination to textures by hierarchical photon tracing."""


def register() -> None:
    """Called by Blender when the extension is enabled; imports here, so that pytest and the core never need bpy."""
    from . import addon

    addon.register()


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
    from . import addon

    addon.unregister()
