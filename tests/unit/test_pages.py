"""Pages to files: names, what the report says of each file, and what is left when one fails."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.output import pages
from leaflight.core.output.image_file import HALF_MAX, read_image
from leaflight.core.util import encodings
from leaflight.core.util.job import VIEWS_FOLDER, Job
from leaflight.core.util.settings import IMAGE_FORMATS, Settings
from scenes import make_scene, moved, quad_mesh

pytestmark = pytest.mark.usefixtures("open_image_io")

PAGE = np.zeros((4, 4, 4), np.float32)
PAGE[1:3, 1:3] = (0.5, 3.0, 0.25, 1.0)
PAGE[0, 1:3, :3] = (0.5, 3.0, 0.25)  # a margin


def draw(name, page, look):
    if look:
        return np.full((4, 4, 4), 0.5, np.float32)
    return PAGE * np.float32(1 + page) if name != "photons" else PAGE * np.float32(1e5)


def write(folder, settings, names=("Floor", "Wall"), draw=draw, taken=()):
    """Files of objects with a page each."""
    (folder / "out").mkdir(parents=True, exist_ok=True)
    scene = make_scene([moved(quad_mesh(), (0, 0, 2.0 * i), name=name) for i, name in enumerate(names)])
    atlas = SimpleNamespace(page_count=len(names), object_page=np.arange(len(names)))
    job = Job(settings, str(folder / "out"), "room", taken=taken)
    return pages.write_pages(job, folder, scene, atlas, {"leaflight:photons": 5}, draw)


def list_names(files):
    return [Path(file.path).name for file in files]


PER_OBJECT = Settings(atlas=False)


def test_every_pass_in_every_kind_is_a_row_with_encoding_and_range(tmp_path):
    files = write(tmp_path, replace(PER_OBJECT, formats=IMAGE_FORMATS), ["Floor"])
    assert list_names(files) == [f"Floor.combined.{end}" for end in ("exr", "hdr", "png", "rgbm.png", "rgbd.png", "logluv.png")]
    assert [(file.encoding, file.range) for file in files] == [
        ("linear, half float", HALF_MAX),
        ("linear, shared exponent", HALF_MAX),
        ("sRGB", 1.0),
        ("rgbm", 3.0),
        ("rgbd", 3.0),
        ("logluv", encodings.LOGLUV_MAX),
    ]
    assert {file.maximum for file in files} == {3.0}
    json.dumps([asdict(file) for file in files], allow_nan=False)


def test_a_range_that_is_wanted_is_taken_and_clips(tmp_path):
    files = write(tmp_path, replace(PER_OBJECT, formats=("rgbm",), value_range=2.0))
    assert [(file.range, file.maximum) for file in files] == [(2.0, 3.0), (2.0, 6.0)]
    assert read_image(Path(files[1].path))[0].max() == pytest.approx(2.0)


def test_the_maximum_of_a_dim_page_is_of_its_light(tmp_path):
    dim = PAGE.copy()
    dim[..., :3] *= np.float32(0.1)
    (file,) = write(tmp_path, PER_OBJECT, ["Floor"], lambda name, page, look: dim)
    assert file.maximum == dim[..., :3].max() < dim[..., 3].max()


def test_debug_passes_are_numbers_in_files_of_numbers_and_pictures_in_png(tmp_path):
    files = write(tmp_path, replace(PER_OBJECT, passes=("photons",), formats=("exr", "png"), view_transform="scene"), ["Floor"])
    exr, png = (read_image(Path(file.path))[0] for file in files)
    assert exr.max() == 300_000
    np.testing.assert_allclose(png[..., :3], 0.5, atol=0.004)
    assert [file.encoding for file in files] == ["linear, float", "a picture, sRGB"]
    assert {file.maximum for file in files} == {300_000}


def test_the_scenes_view_is_left_to_blender(tmp_path):
    (file,) = write(tmp_path, replace(PER_OBJECT, formats=("png",), view_transform="scene"), ["Floor"])
    assert not Path(file.path).exists()
    assert file.linear == str(tmp_path / VIEWS_FOLDER / "Floor.combined.exr")
    np.testing.assert_array_equal(read_image(Path(file.linear))[0], PAGE)


@pytest.mark.parametrize(
    ("pattern", "names", "expected"),
    [
        ("{name}.{pass}", ("Floor", "Wall"), ["Floor.albedo.exr", "Wall.albedo.exr"]),
        ("{pass}_{page}", ("Floor", "Wall"), ["albedo_0.exr", "albedo_1.exr"]),
        ("{name}", ("Floor", "floor"), ["Floor.exr", "floor_.exr"]),
        ("{name}{page}", ("a1", "a"), ["a10.exr", "a1.exr"]),
    ],
)
def test_names_follow_the_pattern(tmp_path, pattern, names, expected):
    assert list_names(write(tmp_path, replace(PER_OBJECT, passes=("albedo",), name_pattern=pattern), names)) == expected
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(expected)


def test_names_that_only_the_pattern_makes_equal_stay_apart(tmp_path):
    """Page 1 of "0_" and page 10 of "_" are both 10_."""
    files = write(tmp_path, replace(PER_OBJECT, name_pattern="{page}{name}"), ["x", "0_", *"abcdefgh", "_"])
    assert [list_names(files)[page] for page in (1, 10)] == ["10_.exr", "10__.exr"]


@pytest.mark.parametrize(
    ("taken", "settings", "expected"),
    [
        (["room_0.combined.exr"], Settings(), ["room_1.combined.exr", "room_2.combined.exr"]),
        (["room_1.combined.exr"], Settings(), ["room_2.combined.exr", "room_3.combined.exr"]),
        (["room_2.lighting.exr"], Settings(), ["room_0.combined.exr", "room_1.combined.exr"]),
        (["room_0.lighting.exr"], Settings(), ["room_1.combined.exr", "room_2.combined.exr"]),  # page 0 of another pass
        (["combined-0.exr"], Settings(name_pattern="{pass}-{page}"), ["combined-1.exr", "combined-2.exr"]),
        (["floor.combined.exr"], PER_OBJECT, ["Floor.combined_.exr", "Wall.combined.exr"]),
    ],
)
def test_images_that_are_taken_are_not_written_over(tmp_path, taken, settings, expected):
    assert list_names(write(tmp_path, settings, taken=tuple(taken))) == expected
