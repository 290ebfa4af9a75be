"""Image files: EXR, HDR, PNG and PNG with encoded light, by OpenImageIO, which every Blender has. The only module that imports it."""

import contextlib
import importlib
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util import encodings
from ..util.arrays import Float32, FloatArray
from ..util.files import write_aside

HALF_MAX = 65504.0  # the greatest half float
_FLOAT_MAX = float(np.finfo(np.float32).max)
_INT_MAX = 2**31 - 1  # greatest integer attribute of an image file
# x, y of Rec.709's red, green, blue and white, for readers that do not know names of colour spaces.
_REC709_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
_PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
_EXR_BLOCK_ROWS = 16  # rows per block with the compression "zip"
_EXR_MOST_HEADER = 1 << 16  # bytes, far more than our headers have
_INCOMPLETE = "the file could not be completed"
KINDS = ("exr", "hdr", "png", *encodings.ENCODINGS)
_ENCODING, _RANGE = "leaflight:encoding", "leaflight:range"
_BAND_NUMBERS = 1 << 19
_EPOCH = "1970:01:01 00:00:00"  # instead of the time of writing, so that the same bake gives the same bytes


def suffix_of(kind: str) -> str:
    """Suffix of a file of this kind, such as .exr or .rgbm.png."""
    return f".{kind}.png" if kind in encodings.ENCODINGS else f".{kind}"


def range_of(pixels: FloatArray, kind: str, wanted: float) -> float:
    """The greatest value that a file of this kind can hold.

    wanted   range of RGBM and RGBD; 0 for the page's maximum
    """
    if kind in ("rgbm", "rgbd"):
        return wanted or encodings.find_range(np.minimum(pixels[..., :3].max(axis=(0, 1)), HALF_MAX))
    return {"png": 1.0, "logluv": encodings.LOGLUV_MAX}.get(kind, HALF_MAX)


def write_image(
    path: Path, pixels: FloatArray, metadata: Mapping[str, str | int | float], kind: str, wanted_range: float = 0.0, full: bool = False
) -> None:
    """Write linear Rec.709 pixels: half float in EXR, shared exponent in HDR, 8 bit sRGB in PNG, or encoded (see encodings).

    The file appears under its name only when it is complete. Values outside the format's range are clipped to it. HDR has neither alpha nor
    metadata; encoded files have no alpha, and their metadata contain encoding and range.

    pixels         (h, w, 3) or (h, w, 4) float, row 0 at the bottom
    kind           one of KINDS
    wanted_range   see range_of
    full           whether EXR has 32 bits per number
    Raises ValueError for another kind or shape and for NaN, OSError if the file cannot be written; both name the path.
    """
    fault = _find_fault(pixels, kind)
    if fault:
        raise ValueError(f"{path}: {fault}")
    greatest = range_of(pixels, kind, wanted_range)
    if kind in encodings.ENCODINGS:
        metadata = {**metadata, _ENCODING: kind, _RANGE: str(greatest)}
    try:
        with write_aside(path) as temporary:
            error = _write_file(temporary, pixels, metadata, kind, greatest, full)
            if error:
                raise OSError(error.replace(str(temporary), path.name))
    except OSError as reason:
        text = str(reason.strerror or reason).strip()
        raise OSError(f"{path}: cannot be written ({text}); choose a folder that exists, can be written to and has room") from reason


def read_image(path: Path) -> tuple[Float32, dict[str, Any]]:
    """Linear pixels and metadata of an EXR, HDR or PNG file; encoded files of write_image are decoded.

    out   (h, w, c) float32, row 0 at the bottom; name -> value
    Raises OSError with the path if it cannot be read.
    """
    source = _open_source(str(path))
    if source is None:
        raise OSError(f"{path}: cannot be read ({_open_image_io().geterror().strip()}); choose an image file")
    pixels = source.read_image("float")
    metadata = {attribute.name: attribute.value for attribute in source.spec().extra_attribs}
    kind, error = source.format_name(), source.geterror()
    source.close()
    if pixels is None:
        raise OSError(f"{path}: cannot be read ({error.strip()}); write it again")
    linear = np.array(pixels[::-1], np.float32)
    if _ENCODING in metadata:
        stored = np.rint(linear * 255.0).astype(np.uint8)
        return encodings.decode(stored, metadata[_ENCODING], float(metadata[_RANGE])), metadata
    if kind == "png":
        linear[..., :3] = srgb_to_linear(linear[..., :3])
    return linear, metadata


def read_bytes(path: str) -> NDArray[np.uint8] | None:
    """The bytes of an image file as stored, with straight alpha; None if it cannot be read or does not have 8 bit channels.

    out   (h, w, c) uint8 with 1, 3 or 4 channels, row 0 at the bottom
    """
    source = _open_source(path)
    if source is None:
        return None
    spec = source.spec()
    plain = str(spec.format) == "uint8" and spec.nchannels in ((1, 3) if path.lower().endswith((".jpg", ".jpeg")) else (1, 3, 4))
    stored = source.read_image("uint8") if plain else None
    source.close()
    return None if stored is None else np.asarray(stored, np.uint8).reshape(spec.height, spec.width, spec.nchannels)[::-1]


def _open_source(path: str) -> Any:
    """The reader of an image file, with straight alpha; None if it cannot be opened."""
    straight = _open_image_io().ImageSpec()
    straight.attribute("oiio:UnassociatedAlpha", 1)
    return _open_image_io().ImageInput.open(path, straight)


def load_ahead(folders: Sequence[str] = ()) -> None:
    """Load OpenImageIO before the first image. Python also searches the folders given here, last; the first image reports a failure."""
    before = list(sys.path)
    sys.path.extend(folders)
    try:
        with contextlib.suppress(ValueError):
            _open_image_io()
    finally:
        sys.path[:] = before


def can_open() -> bool:
    """Whether OpenImageIO is loaded, or can be."""
    try:
        return _open_image_io() is not None
    except ValueError:
        return False


def _open_image_io() -> Any:
    try:
        return importlib.import_module("OpenImageIO")
    except ImportError as reason:
        raise ValueError(
            f"OpenImageIO: cannot be imported ({reason}); run Leaflight on Blender's Python, or on one whose sys.path has the "
            "site-packages folder inside the bpy package"
        ) from reason


def _find_fault(pixels: FloatArray, kind: str) -> str:
    """Why pixels cannot be written, "" if they can."""
    if kind not in KINDS:
        return f"expected kind {', '.join(KINDS)}, got {kind!r}"
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or not pixels.size:
        return f"expected pixels (h, w, 3) or (h, w, 4), got {pixels.shape}"
    if np.isnan(pixels.min()):  # a single NaN makes the minimum NaN
        return f"expected numbers, got {sum(int(np.count_nonzero(np.isnan(pixels[band]))) for band in _bands(pixels))} NaN"
    return ""


def _bands(pixels: FloatArray) -> list[slice]:
    """Bands of rows, so that temporary arrays are small compared with the page."""
    step = max(1, _BAND_NUMBERS // (pixels.shape[1] * pixels.shape[2]))
    return [slice(start, start + step) for start in range(0, len(pixels), step)]


def _encode_rows(rows: FloatArray, kind: str, greatest: float, full: bool) -> NDArray[np.generic]:
    """Rows in the file's number format (float32 for EXR); `greatest` is from range_of."""
    if kind in encodings.ENCODINGS:
        return encodings.encode(rows[..., :3], kind, greatest)
    if kind == "exr":
        most = _FLOAT_MAX if full else HALF_MAX
        return np.asarray(np.clip(rows, -most, most), np.float32)
    if kind == "hdr":
        return np.asarray(np.clip(rows[..., :3], 0.0, HALF_MAX), np.float32)
    unit = np.clip(rows, 0.0, 1.0).astype(np.float32)
    unit[..., :3] = linear_to_srgb(unit[..., :3])
    return np.rint(unit * 255.0).astype(np.uint8)


def _write_file(path: Path, pixels: FloatArray, metadata: Mapping[str, str | int | float], kind: str, greatest: float, full: bool) -> str:
    """Write the file, rows from the top; returns the reason of a failure, or ""."""
    oiio = _open_image_io()
    height, width, _ = pixels.shape
    example = _encode_rows(pixels[:1], kind, greatest, full)
    numbers = "half" if kind == "exr" and not full else {"float32": "float"}.get(example.dtype.name, "uint8")
    spec = oiio.ImageSpec(width, height, example.shape[2], numbers)
    for name, value in metadata.items():
        fits = isinstance(value, float | str) or abs(value) <= _INT_MAX
        spec.attribute(name, value if fits else str(value))
    spec.attribute("oiio:UnassociatedAlpha", 1)  # PNG: a margin's colour is not divided by its alpha, which is 0
    spec.attribute("oiio:ColorSpace", {"exr": "lin_rec709", "hdr": "lin_rec709", "png": "sRGB"}.get(kind, "raw"))
    if kind == "exr":
        spec.attribute("compression", "zip")
        spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), _REC709_CHROMATICITIES)
        spec.attribute("DateTime", _EPOCH)
    output = oiio.ImageOutput.create(kind if kind in ("exr", "hdr") else "png")
    if output is None:
        return str(oiio.geterror())
    done = output.open(str(path), spec) and all(
        output.write_scanlines(band.start, min(band.stop, height), 0, _encode_rows(pixels[::-1][band], kind, greatest, full))
        for band in _bands(pixels)
    )
    closed = output.close()
    if not (done and closed):
        return str(output.geterror()) or _INCOMPLETE
    return "" if _is_complete(path, kind, height) else _INCOMPLETE


def _is_complete(path: Path, kind: str, height: int) -> bool:
    """Whether a new file of `height` rows is complete: OpenImageIO reports no error if the disk is full when it writes its last buffer."""
    if kind == "exr":
        return is_complete_exr(path, height)
    if kind != "hdr":
        with open(path, "rb") as file:
            file.seek(max(path.stat().st_size - len(_PNG_END), 0))
            return file.read() == _PNG_END
    source = _open_image_io().ImageInput.open(str(path))
    if source is None:
        return False
    spec = source.spec()
    complete = source.read_scanlines(spec.height - 1, spec.height, 0, 0, spec.nchannels, "half") is not None  # rows are in order
    source.close()
    return complete


def is_complete_exr(path: Path, height: int) -> bool:
    """Whether the last block of rows ends at the end of the file. OpenImageIO's reader would first set up all of its colour spaces.

    Source: "OpenEXR File Layout", openexr.com: after the header, whose attributes end with an empty name, come the offsets of all blocks,
    which are written last; a block begins with its first row and its size.
    """
    size, blocks = path.stat().st_size, -(-height // _EXR_BLOCK_ROWS)
    with open(path, "rb") as file:
        head = file.read(_EXR_MOST_HEADER + 8 * blocks)
        at = 8
        while head[at : at + 1] not in (b"", b"\0"):
            value = head.find(b"\0", head.find(b"\0", at) + 1) + 1  # after name and type, which end with a zero byte
            at = value + 4 + int.from_bytes(head[value : value + 4], "little")
        last = int.from_bytes(head[at + 1 + 8 * (blocks - 1) : at + 1 + 8 * blocks], "little")
        file.seek(last)
        begins = file.read(8)
    return at < last and last + 8 + int.from_bytes(begins[4:], "little") == size


def linear_to_srgb(value: Float32) -> Float32:
    """sRGB values of linear ones, both within [0, 1].

    Source: IEC 61966-2-1:1999."""
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** np.float32(1 / 2.4) - 0.055)


def srgb_to_linear(value: Float32) -> Float32:
    """Linear values of sRGB ones, both within [0, 1].

    Source: IEC 61966-2-1:1999."""
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** np.float32(2.4))
