import dataclasses
import itertools

import numpy as np
import pytest
from leaflight.core.scene.scene import TextureImage
from leaflight.core.scene.textures import Textures, clamp_colours, sample_texture

# 3 texels wide, 5 high: a swapped axis cannot pass
PIXELS = np.random.default_rng(1).random((5, 3, 3)).astype(np.float32)
TEXTURE = TextureImage("Checks", PIXELS)
CENTRES = np.stack(np.meshgrid((np.arange(3) + 0.5) / 3, (np.arange(5) + 0.5) / 5), axis=-1).reshape(-1, 2)
EXTENSIONS = ("REPEAT", "EXTEND", "CLIP", "MIRROR")


def test_an_image_without_texels_is_black():
    assert not sample_texture(TextureImage("Empty", np.zeros((0, 0, 3), np.float32)), CENTRES).any()


def test_uv_that_is_not_finite_gives_finite_colours():
    uv = np.array([[np.nan, 0.5], [np.inf, -np.inf], [1e30, -1e30]])
    for extension in EXTENSIONS:
        for closest in (False, True):
            image = dataclasses.replace(TEXTURE, extension=extension, closest=closest)
            assert np.isfinite(sample_texture(image, uv)).all()


@pytest.mark.parametrize("closest", [False, True])
@pytest.mark.parametrize("extension", EXTENSIONS)
def test_texel_centres_give_texels(extension, closest):
    image = dataclasses.replace(TEXTURE, extension=extension, closest=closest)
    np.testing.assert_allclose(sample_texture(image, CENTRES), PIXELS.reshape(-1, 3), atol=1e-6)


def test_between_centres_is_bilinear_and_closest_is_not():
    between = np.array([[1.0 / 3, 1.75 / 5]])  # half way from column 0 to 1, a quarter of the way from row 1 to 2
    blended = 0.75 * (PIXELS[1, 0] + PIXELS[1, 1]) / 2 + 0.25 * (PIXELS[2, 0] + PIXELS[2, 1]) / 2
    np.testing.assert_allclose(sample_texture(TEXTURE, between)[0], blended, atol=1e-6)
    closest = dataclasses.replace(TEXTURE, closest=True)
    np.testing.assert_array_equal(sample_texture(closest, np.add(between, (0.01, 0)))[0], PIXELS[1, 1])


OUTSIDE = {  # texel (column, row) found at column -2 of row 1, and at column 4 of row 6
    "REPEAT": ((1, 1), (1, 1)),
    "EXTEND": ((0, 1), (2, 4)),
    "CLIP": (None, None),
    "MIRROR": ((1, 1), (1, 3)),
}


@pytest.mark.parametrize("closest", [False, True])
@pytest.mark.parametrize("extension", OUTSIDE)
def test_outside_the_image(extension, closest):
    image = dataclasses.replace(TEXTURE, extension=extension, closest=closest)
    found = sample_texture(image, np.array([[-1.5 / 3, 1.5 / 5], [4.5 / 3, 6.5 / 5]]))
    expected = [np.zeros(3) if place is None else PIXELS[place[1], place[0]] for place in OUTSIDE[extension]]
    np.testing.assert_allclose(found, expected, atol=1e-6)


EDGE = {"REPEAT": PIXELS[0, 2], "EXTEND": PIXELS[0, 0], "CLIP": np.zeros(3), "MIRROR": PIXELS[0, 0]}


@pytest.mark.parametrize("extension", EDGE)
def test_the_edge_blends_with_what_lies_beyond(extension):
    image = dataclasses.replace(TEXTURE, extension=extension)
    found = sample_texture(image, np.array([[0.0, 0.5 / 5]]))[0]
    np.testing.assert_allclose(found, (PIXELS[0, 0] + EDGE[extension]) / 2, atol=1e-6)


def _kinds(count):
    """So many images of each extension and interpolation, of many sizes, one of them without texels."""
    rng = np.random.default_rng(3)
    kinds = [kind for kind in itertools.product(EXTENSIONS, (False, True)) for _ in range(count)]
    shapes = [(0, 0, 3), *((*rng.integers(1, 40, 2), 3) for _ in kinds[1:])]
    return [
        TextureImage(f"Picture {k}", rng.random(shape).astype(np.float32), *kind)
        for k, (shape, kind) in enumerate(zip(shapes, kinds, strict=True))
    ]


@pytest.mark.parametrize("lie_together", [False, True])
@pytest.mark.parametrize("count", [1, 7])
def test_many_images_are_looked_up_as_each_alone(count, lie_together):
    images = _kinds(count)
    if lie_together:
        parts = np.split(
            np.concatenate([image.pixels.ravel() for image in images]), np.cumsum([image.pixels.size for image in images])[:-1]
        )
        images = [dataclasses.replace(image, pixels=part.reshape(image.pixels.shape)) for image, part in zip(images, parts, strict=True)]
    rng = np.random.default_rng(4)
    image = rng.integers(0, len(images), 5000)
    uv = (rng.standard_normal((5000, 2)) * rng.choice([0.5, 3, 1e3, 1e9], (5000, 1))).astype(np.float32)
    uv[::97, 0] = np.nan
    found = Textures(images).at(image, uv)
    assert found.dtype == np.float32
    assert found.T.flags.c_contiguous
    for number, own in enumerate(images):
        np.testing.assert_array_equal(found[image == number], sample_texture(own, uv[image == number]))


@pytest.mark.parametrize("closest", [False, True])
@pytest.mark.parametrize("extension", EXTENSIONS)
def test_the_edge_of_an_image_never_shows_the_next_one(extension, closest):
    """Where rounding gives a place past the last texel, too."""
    images = [TextureImage(str(value), np.full((300, 300, 3), value, np.float32), extension, closest) for value in (0.25, 0.75)]
    ends = (0.0, np.nextafter(np.float32(1), np.float32(0)), 1.0, -1e-9)
    uv = np.float32(list(itertools.product(ends, ends)))
    for number, value in enumerate((0.25, 0.75)):
        found = Textures(images).at(np.full(len(uv), number), uv)
        shown = found if extension != "CLIP" else found.max(axis=0)  # beyond the image that shows nothing
        np.testing.assert_allclose(shown, value if extension != "CLIP" or closest else value / 4, rtol=1e-3)


def test_colours_are_clamped_and_odd_ones_are_black():
    values = np.float32([[-1.0, 0.5, 2.0], [np.nan, np.inf, -np.inf]])
    np.testing.assert_array_equal(clamp_colours(values, 0.75), np.float32([[0, 0.5, 0.75], [0, 0, 0]]))
    np.testing.assert_array_equal(clamp_colours(values[:1], np.inf), np.float32([[0, 0.5, 2.0]]))
    assert np.isnan(values[1, 0])  # what was asked is left as it is
