"""The bake that runs, on the objects: made at its first light, kept up to date, and taken off when it comes to nothing.

Where the scene wears an earlier bake of the same layout, the new light takes the place of its images only; where the layout
is another one, the earlier bake stays to be seen until the new one is done.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..read.steps import Steps, run_steps
from ..read.tags import LIVE, STANDS_FOR, is_made, local_objects, remove_blocks
from ..show import images, materials_write, restore
from ..show.layout import Layout, worn_digest, worn_images, worn_warnings
from . import session


class LiveView:
    """The pages of one bake."""

    def __init__(self, work: session.Session) -> None:
        self._work = work
        self._pages: dict[int, NDArray[np.float16]] = {}
        self._layout: Layout | None = None
        self._was_hidden = False
        self._warnings: session.Warnings = []  # of putting the light on the objects

    def show(self, context: bpy.types.Context, paths: dict[int, str]) -> None:
        """`show_steps` at once."""
        run_steps(self.show_steps(context, paths))

    def show_steps(self, context: bpy.types.Context, paths: dict[int, str]) -> Steps[bool]:
        """Bring the objects of the scene that is baked up to date, True; `paths` are those of core.messages.Preview.

        The first light is put on in steps; closing the generator takes it off.
        """
        for page, path in paths.items():
            try:
                self._pages[page] = np.load(path)
            except FileNotFoundError:  # it is old, and a newer one is on its way
                continue
            if _find_image(page):
                images.set_pixels(_find_image(page), self._pages[page])
        scene = context.scene
        if is_live(scene):
            return True
        layout = self._layout = self._layout or session.get_layout(self._work)
        if len(self._pages) < layout.page_count:
            return True
        if not restore.has_bake(scene):
            uid = scene.session_uid
            try:
                self._warnings = yield from session.show_pages(scene, context.view_layer, self._work, layout, self._make_images())
            except GeneratorExit:
                for one in [one for one in bpy.data.scenes if one.session_uid == uid]:  # none if it was deleted
                    restore.remove_bake(one)
                _remove_images()
                raise
        elif worn_digest(scene) == layout.digest:
            self._warnings = worn_warnings(scene)
            self._was_hidden = not restore.is_preview_on(scene)
            _stand_in(scene, self._make_images())
            if self._was_hidden:
                restore.toggle_preview(scene, True)
        return True

    def finish(self, context: bpy.types.Context, result: dict[str, Any]) -> session.Warnings:
        """`finish_steps` at once."""
        return run_steps(self.finish_steps(context, result))

    def finish_steps(self, context: bpy.types.Context, result: dict[str, Any]) -> Steps[session.Warnings]:
        """Put the result in place of the light so far; gives what could not be done."""
        scene = context.scene
        if not (self._layout and is_live(scene) and self._is_whole(scene, self._layout)):
            yield from self.take_off_steps()
            return (yield from session.assign_steps(context, self._work, result))
        baked = session.compare_prints(scene, self._work, self._layout)
        found = session.load_pages(self._work.request, result)
        for page, image in worn_images(scene).items():
            image.user_remap(found[page])
        _remove_images()
        images.remove_unused_images()  # the earlier bake's
        session.mark_bake(scene, self._work, result, baked)
        return self._warnings

    def end_steps(self, context: bpy.types.Context, result: dict[str, Any] | None) -> Steps[session.Warnings]:
        """`finish_steps`, or `take_off_steps` where the bake has no result."""
        if result is not None:
            return (yield from self.finish_steps(context, result))
        yield from self.take_off_steps()
        return []

    def take_off(self) -> None:
        """`take_off_steps` at once."""
        run_steps(self.take_off_steps())

    def take_off_steps(self) -> Steps[None]:
        """Everything as it was before the first light."""
        shown = [scene for scene in bpy.data.scenes if is_live(scene)]
        yield from take_off_steps()
        for scene in shown:
            if self._was_hidden and restore.has_bake(scene):
                restore.toggle_preview(scene, False)

    def _make_images(self) -> dict[int, bpy.types.Image]:
        found = {}
        for page, pixels in self._pages.items():
            height, width = pixels.shape[:2]
            found[page] = _find_image(page) or images.preview_image(f"Leaflight live {page}", width, height)
            found[page][LIVE] = page
            images.set_pixels(found[page], pixels)
        return found

    def _is_whole(self, scene: bpy.types.Scene, layout: Layout) -> bool:
        """Whether every object wears the light that it should, so that only images must be changed."""
        exported = self._work.export.objects
        baked = [exported[i] for i, page in enumerate(layout.object_page) if page >= 0]
        wearing = {
            obj.name
            for obj in local_objects(scene.objects)
            if materials_write.is_shown(obj) and is_live_image(materials_write.find_image(obj))
        }
        if any(one.needs_copy for one in baked):  # a copy stands where its source stood
            return not _stands_in() and len(wearing) == len(baked)
        return all(obj is not None and obj.name in wearing for obj in session.find_carriers(baked))


def is_live(scene: bpy.types.Scene) -> bool:
    """Whether the scene shows the bake that runs."""
    shown = worn_images(scene)
    return bool(shown) and all(is_live_image(image) for image in shown.values())


def is_live_image(image: bpy.types.Image | None) -> bool:
    """Whether the image holds light of a bake that is not done."""
    return is_made(image) and LIVE in image


def take_off() -> None:
    """`take_off_steps` at once."""
    run_steps(take_off_steps())


def take_off_steps() -> Steps[None]:
    """Takes the light of unfinished bakes off all scenes: also what an undo step or an automatic save brought back."""
    for image in filter(is_live_image, bpy.data.images):
        if image.get(STANDS_FOR):
            image.user_remap(image[STANDS_FOR])
    for scene in list(bpy.data.scenes):
        if is_live(scene):
            yield from restore.remove_steps(scene)
    _remove_images()


def _stand_in(scene: bpy.types.Scene, page_image: dict[int, bpy.types.Image]) -> None:
    for page, earlier in worn_images(scene).items():
        earlier.user_remap(page_image[page])
        page_image[page][STANDS_FOR] = earlier


def _stands_in() -> bool:
    return any(is_live_image(image) and image.get(STANDS_FOR) for image in bpy.data.images)


def _find_image(page: int) -> bpy.types.Image | None:
    return next((image for image in bpy.data.images if is_live_image(image) and image[LIVE] == page), None)


def _remove_images() -> None:
    remove_blocks([image for image in bpy.data.images if is_live_image(image)])
