"""A snapshot is consistent or is never made."""

import dataclasses

import numpy as np
import pytest
from leaflight.core.scene.scene import Material, SceneSnapshot, TextureImage
from scenes import box_scene, quad_scene

ARRAYS = [field.name for field in dataclasses.fields(SceneSnapshot) if field.name.startswith(("vertex_", "tri_"))]


def planted(scene, name, place, value):
    """The scene with one element of an array changed."""
    array = getattr(scene, name).copy()
    array[place] = value
    return dataclasses.replace(scene, **{name: array})


@pytest.mark.parametrize("name", ARRAYS)
def test_each_array_must_have_its_shape(name):
    scene = box_scene()
    array = getattr(scene, name)
    wrong = array[:, :-1] if array.ndim > 1 else array[:-1]
    with pytest.raises(ValueError, match=f"^{name}: expected shape ") as caught:
        dataclasses.replace(scene, **{name: wrong})
    assert str(caught.value).endswith(f"{array.shape}, got {wrong.shape}")


@pytest.mark.parametrize(("name", "count"), [("tri_vertex", 8), ("tri_object", 1), ("tri_material", 1)])
def test_indices_must_name_what_is_there(name, count):
    for value in (-1, count):
        with pytest.raises(ValueError, match=f"^{name}: expected indices 0 to {count - 1}, got "):
            planted(box_scene(), name, 3, value)
    assert getattr(planted(box_scene(), name, 3, count - 1), name).flat[0] >= 0


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_positions_must_be_finite(value):
    with pytest.raises(ValueError, match="vertex_position: expected finite"):
        planted(quad_scene(), "vertex_position", (2, 1), value)


@pytest.mark.parametrize("slot", ["albedo_image", "emission_image"])
def test_materials_must_name_images_that_are_there(slot):
    image = TextureImage("Wood", np.zeros((1, 1, 3), np.float32))
    first, second = Material("Oak", **{slot: 0}), Material("Oak", **{slot: 1})
    dataclasses.replace(quad_scene(), images=(image,), materials=(first,))
    with pytest.raises(ValueError, match=r"^Oak: names an image that is not in the snapshot"):
        dataclasses.replace(quad_scene(), images=(image,), materials=(second,))


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_density_factors_must_be_above_zero(factor):
    scene = quad_scene()
    named = dataclasses.replace(scene.objects[0], name="Oak", density_factor=factor)
    with pytest.raises(ValueError, match=r"^Oak: expected a density factor above 0"):
        dataclasses.replace(scene, objects=(named,))
