"""Image files written and read back, their names and rows in the report, and what is left behind when writing fails."""

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from boxes import bake_folder, lamp_scene, list_files
from leaflight.core.output import pages
from leaflight.core.output.image_file import (
    HALF_MAX,
    KINDS,
    is_complete_exr,
    linear_to_srgb,
    load_ahead,
    range_of,
    read_image,
    srgb_to_linear,
    suffix_of,
    write_image,
)
from leaflight.core.util import encodings
from leaflight.core.util.job import RESULT_FILE, VIEWS_FOLDER, Job
from leaflight.core.util.messages import Done, Status, Warning_
from leaflight.core.util.settings import IMAGE_FORMATS, Settings
from scenes import make_scene, moved, quad_mesh

pytestmark = pytest.mark.usefixtures("open_image_io")


# Image files written and read back, and what is left behind when writing fails.
def ramp(channels: int = 4) -> np.ndarray:
    """3 rows and 5 columns, every value different, row 0 dark."""
    return (np.arange(3 * 5 * channels).reshape(3, 5, channels) / 64).astype(np.float32)


@pytest.mark.parametrize("channels", [3, 4])
def test_exr_keeps_halves_exactly(tmp_path: Path, channels: int) -> None:
    path = tmp_path / "Tür 3.lighting.exr"
    pixels = ramp(channels) * 8
    write_image(path, pixels, {"leaflight:pass": "lighting", "leaflight:photons": 10**12, "leaflight:error": 0.25}, "exr")
    found, metadata = read_image(path)
    np.testing.assert_array_equal(found, pixels)
    assert metadata["leaflight:pass"] == "lighting"
    assert metadata["leaflight:photons"] == str(10**12)
    assert metadata["leaflight:error"] == 0.25
    assert metadata["compression"] == "zip"
    assert "lin_rec709" in metadata["oiio:ColorSpace"]
    np.testing.assert_allclose(metadata["chromaticities"], [0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329], rtol=1e-6)


def test_exr_rounds_to_the_nearest_half_as_numpy_does(tmp_path: Path) -> None:
    """Also halfway between two, below the least normal one, and beyond the greatest."""
    rng = np.random.default_rng(1)
    halves = rng.integers(0, 0x7BFF, 3000).astype(np.uint16)
    middle = (halves.view(np.float16).astype(np.float64) + (halves + np.uint16(1)).view(np.float16)) / 2
    values = np.concatenate([middle, -middle, np.exp2(rng.uniform(-30, 17, 3000)), [np.inf, -np.inf, 0.0]]).astype(np.float32)
    write_image(tmp_path / "a.exr", values.reshape(1, -1, 3), {}, "exr")
    found, _ = read_image(tmp_path / "a.exr")
    np.testing.assert_array_equal(found.ravel(), np.clip(values, -HALF_MAX, HALF_MAX).astype(np.float16))


def test_hdr_keeps_colour_to_a_part_in_200(tmp_path: Path) -> None:
    write_image(tmp_path / "a.hdr", ramp() * 100, {}, "hdr")
    found, _ = read_image(tmp_path / "a.hdr")
    assert found.shape == (3, 5, 3)
    np.testing.assert_allclose(found, ramp()[..., :3] * 100, atol=ramp().max() * 100 / 200)


def test_png_is_srgb_and_keeps_colour_without_alpha(tmp_path: Path) -> None:
    pixels = np.zeros((3, 5, 4), np.float32)
    pixels[0, 1] = (0.5, 0.002, 2.0, 0.0)
    pixels[2, 4] = (0.18, 1.0, -1.0, 1.0)
    pixels[2, 0] = (0.5, 0.5, 0.5, 0.25)
    write_image(tmp_path / "a.png", pixels, {"Description": "lighting"}, "png")
    found, metadata = read_image(tmp_path / "a.png")
    step = np.array([0.5, 0.18, 0.002])  # a step of 1/255 at middle grey is 0.4 %; half of it either way
    np.testing.assert_allclose([found[0, 1, 0], found[2, 4, 0], found[0, 1, 1]], step, atol=0.004)
    np.testing.assert_array_equal(found[0, 1, 2:], [1.0, 0.0])
    np.testing.assert_array_equal(found[2, 4, 1:], [1.0, 0.0, 1.0])
    np.testing.assert_allclose(found[2, 0], [0.5, 0.5, 0.5, 0.25], atol=0.004)
    assert found[1].max() == 0.0
    assert "sRGB" in metadata["oiio:ColorSpace"] or "srgb" in metadata["oiio:ColorSpace"]


def test_png_bytes_are_the_srgb_curve(tmp_path: Path) -> None:
    """Linear 0.2140 is byte 127.5 of 255; the file's own numbers are read past our decoding."""
    import OpenImageIO

    pixels = np.full((3, 5, 3), 0.21586, np.float32)
    write_image(tmp_path / "a.png", pixels, {}, "png")
    stored = OpenImageIO.ImageInput.open(str(tmp_path / "a.png")).read_image("uint8")
    assert np.unique(stored).tolist() == [128]


def test_the_srgb_curve_goes_through_known_points_and_back() -> None:
    linear = srgb_to_linear(np.float32([0.0, 0.04045, 0.5, 1.0]))
    assert linear == pytest.approx([0.0, 0.0031308, 0.21404, 1.0], abs=1e-5)
    every = np.arange(256, dtype=np.float32) / 255
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(every)), every, atol=1e-6)


def test_row_0_is_the_last_of_the_file(tmp_path: Path) -> None:
    import OpenImageIO

    write_image(tmp_path / "a.exr", ramp(), {}, "exr")
    stored = OpenImageIO.ImageInput.open(str(tmp_path / "a.exr")).read_image("float")
    np.testing.assert_array_equal(stored[2], ramp()[0])


@pytest.mark.parametrize("kind", encodings.ENCODINGS)
def test_encoded_files_hold_the_bytes_of_the_encoding(tmp_path: Path, kind: str) -> None:
    """As they are: no colour space, and no alpha that would scale them."""
    import OpenImageIO

    pixels = ramp() * 4
    pixels[0, 0] = 0.0  # RGBM's alpha is then the smallest
    write_image(tmp_path / "a", pixels, {}, kind, 20.0)
    straight = OpenImageIO.ImageSpec()
    straight.attribute("oiio:UnassociatedAlpha", 1)
    stored = OpenImageIO.ImageInput.open(str(tmp_path / "a"), straight).read_image("uint8")
    np.testing.assert_array_equal(stored[::-1], encodings.encode(pixels[..., :3], kind, 20.0))
    found, metadata = read_image(tmp_path / "a")
    np.testing.assert_array_equal(found, encodings.decode(stored[::-1], kind, 20.0))
    assert metadata["leaflight:encoding"] == kind
    assert metadata["leaflight:range"] == str(range_of(pixels, kind, 20.0))
    raw = (tmp_path / "a").read_bytes()
    assert not any(chunk in raw for chunk in (b"gAMA", b"sRGB", b"iCCP"))


def test_full_exr_keeps_counts(tmp_path: Path) -> None:
    counts = np.full((3, 5, 3), 1_000_001.0, np.float32)
    write_image(tmp_path / "a.exr", counts, {}, "exr", full=True)
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr")[0], counts)


def test_range_and_ending_of_each_kind() -> None:
    pixels = np.full((2, 2, 4), 7.0, np.float32)
    assert [range_of(pixels, kind, 0.0) for kind in KINDS] == [HALF_MAX, HALF_MAX, 1.0, 7.0, 7.0, encodings.LOGLUV_MAX]
    assert range_of(pixels, "rgbm", 5.0) == 5.0
    assert range_of(pixels * np.float32(np.inf), "rgbd", 0.0) == pytest.approx(HALF_MAX, rel=1e-3)
    assert [suffix_of(kind) for kind in KINDS] == [".exr", ".hdr", ".png", ".rgbm.png", ".rgbd.png", ".logluv.png"]


@pytest.mark.parametrize("kind", ["exr", "hdr", "png"])
def test_values_out_of_range_are_clipped(tmp_path: Path, kind: str) -> None:
    pixels = np.zeros((3, 5, 3), np.float32)
    pixels[0, 0] = (np.inf, 1e30, 0.5)
    write_image(tmp_path / "a", pixels, {}, kind)
    found, _ = read_image(tmp_path / "a")
    assert np.isfinite(found).all()
    limit = 1.0 if kind == "png" else HALF_MAX
    np.testing.assert_allclose(found[0, 0, :2], limit, rtol=0.005)


@pytest.mark.parametrize("kind", KINDS)
def test_same_pixels_same_bytes(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    write_image(tmp_path / "a", ramp(), {"leaflight:pass": "x"}, kind)
    monkeypatch.setattr("time.time", lambda: 0.0)
    write_image(tmp_path / "b", ramp(), {"leaflight:pass": "x"}, kind)
    first = (tmp_path / "a").read_bytes()
    assert first == (tmp_path / "b").read_bytes()
    assert kind != "exr" or b"1970:01:01" in first


@pytest.mark.parametrize("kind", KINDS)
def test_a_large_image_is_as_good_as_small_ones(tmp_path: Path, kind: str) -> None:
    """It is written in bands of rows, which here end anywhere."""
    small = np.random.default_rng(2).random((7, 301, 4), np.float32)
    large = np.tile(small, (100, 1, 1))
    for name, pixels in (("small", small), ("large", large)):
        write_image(tmp_path / f"{name}{suffix_of(kind)}", pixels, {}, kind)
    found, expected = (read_image(tmp_path / f"{name}{suffix_of(kind)}")[0] for name in ("large", "small"))
    np.testing.assert_array_equal(found, np.tile(expected, (100, 1, 1)))
    large[2, 0, 0] = large[690, 1, 2] = np.nan
    with pytest.raises(ValueError, match="2 NaN"):
        write_image(tmp_path / "bands", large, {}, kind)


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    with pytest.raises(ValueError, match=r"a\.exr: expected numbers, got 60 NaN"):
        write_image(path, ramp() * np.nan, {}, "exr")
    with pytest.raises(ValueError, match=r"a\.exr: expected pixels .* got \(3, 5, 2\)"):
        write_image(path, ramp(2), {}, "exr")
    with pytest.raises(ValueError, match=r"a\.exr: expected kind exr, hdr, png, rgbm, rgbd, logluv, got 'tiff'"):
        write_image(path, ramp(), {}, "tiff")
    assert not list(tmp_path.iterdir())


def test_missing_folder_and_file(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"away/a\.exr: cannot be written \(.*No such file"):
        write_image(tmp_path / "away" / "a.exr", ramp(), {}, "exr")
    with pytest.raises(OSError, match=r"b\.exr: cannot be read"):
        read_image(tmp_path / "b.exr")


@pytest.fixture
def limit_files() -> Iterator[Callable[[int], None]]:
    """Sets the bytes beyond which no file of this process grows; writing more fails as on a full disk."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(("kind", "missing"), [("exr", 1), ("exr", 50_000), ("hdr", 100), ("png", 1), ("rgbm", 50_000)])
def test_full_disk_keeps_the_old_file(tmp_path: Path, kind: str, missing: int, limit_files: Callable[[int], None]) -> None:
    path = tmp_path / f"a.{kind}"
    noise = np.random.default_rng(1).random((200, 100, 3)).astype(np.float32)
    write_image(path, noise, {}, kind)
    size = path.stat().st_size
    path.write_text("old")
    limit_files(size - missing)
    with pytest.raises(OSError, match=rf"a\.{kind}: cannot be written"):
        write_image(path, noise, {}, kind)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "old"
    limit_files(size)
    write_image(path, noise, {}, kind)
    assert path.stat().st_size == size


@pytest.mark.parametrize(("height", "full"), [(1, False), (16, True), (33, False)])
def test_an_exr_cut_anywhere_is_not_complete(tmp_path: Path, height: int, full: bool) -> None:
    path = tmp_path / "a.exr"
    write_image(path, np.random.default_rng(1).random((height, 3, 4)), {"leaflight:pass": "x"}, "exr", full=full)
    contents = path.read_bytes()
    assert is_complete_exr(path, height)
    for size in range(len(contents)):
        path.write_bytes(contents[:size])
        assert not is_complete_exr(path, height)


def test_a_missing_library_is_told_when_there_is_an_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "OpenImageIO", None)
    load_ahead()
    with pytest.raises(ValueError, match=r"^OpenImageIO: cannot be imported"):
        write_image(tmp_path / "a.exr", ramp(), {}, "exr")


# Room for images before a bake, and where they go when the output folder fails at its end.
QUICK = Settings(size=32, padding=1, workers=1, error=0.3, max_photons=20_000)


@pytest.fixture
def spare_home(tmp_path, monkeypatch):
    """A home folder of the test's own."""
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")
    (tmp_path / "home").mkdir()
    return tmp_path / "home"


def test_what_cannot_be_written_at_the_end_is_kept_elsewhere(tmp_path, spare_home):
    """Minutes of work are not thrown away because a disk is full or a stick was pulled out."""
    images = tmp_path / "images"

    def tell(message):
        if message == Status("write", "Writing images"):
            shutil.rmtree(images)
            images.write_text("in the way")

    settings = replace(QUICK, passes=("combined", "albedo"))
    messages, result = bake_folder(tmp_path / "temporary" / "job", lamp_scene(), settings, tell=tell, output=str(images))
    spare = Path(result["spare"])
    assert spare.parent == tmp_path / "temporary"
    assert list_files(spare) == ["room_0.albedo.exr", "room_0.combined.exr"]
    assert {str(Path(file["path"]).parent) for file in result["files"]} == {str(spare)}
    assert read_image(Path(result["files"][0]["path"]))[0].max() > 0.01
    (told,) = [message.text for message in messages if isinstance(message, Warning_) and str(spare) in message.text]
    assert told.startswith(str(tmp_path / "images"))
    assert isinstance(messages[-1], Done)


def test_half_a_bake_is_not_left_behind(tmp_path, spare_home):
    blocked = tmp_path / "job" / "images" / "room_0.emission.exr"
    blocked.mkdir(parents=True)  # a folder where the second image should go
    settings = replace(QUICK, passes=("combined", "emission", "albedo"))
    _, result = bake_folder(tmp_path / "job", lamp_scene(), settings)
    assert list_files(tmp_path / "job" / "images") == [blocked.name]
    assert len(list_files(Path(result["spare"]))) == 3


def test_where_nothing_can_be_written_anywhere_the_first_reason_is_told(tmp_path, spare_home, monkeypatch):
    def fail(path, *_, **__):
        raise OSError(f"{path}: cannot be written (planted)")

    monkeypatch.setattr("leaflight.core.output.image_file.write_image", fail)
    with pytest.raises(OSError, match=r"job/images/room_0\.combined\.exr: cannot be written \(planted\)"):
        bake_folder(tmp_path / "job", lamp_scene(), QUICK)
    assert not (tmp_path / "job" / RESULT_FILE).exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["home", "job"]
    assert list_files(spare_home) == []


@pytest.mark.parametrize(("part", "refused"), [(0.05, True), (0.5, False), (2.0, None)])
def test_too_little_room_is_told_before_the_light_is_computed(tmp_path, monkeypatch, part, refused):
    wanted = 32 * 32 * (8 + 4) * 2
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage._replace(free=int(part * wanted)))
    settings = replace(QUICK, passes=("combined", "albedo"), formats=("exr", "png"))
    if refused:
        with pytest.raises(OSError, match=r"images: has room for 1 kB, and the images may take 25 kB; make room, choose another output"):
            bake_folder(tmp_path, lamp_scene(), settings)
        return
    messages, _ = bake_folder(tmp_path, lamp_scene(), settings)
    told = [number for number, message in enumerate(messages) if isinstance(message, Warning_) and "has room for" in message.text]
    lit = next(number for number, message in enumerate(messages) if isinstance(message, Status) and message.stage == "photons")
    assert len(told) == (refused is False)
    assert all(number < lit for number in told)


# Pages to files: names, what the report says of each file, and what is left when one fails.
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
