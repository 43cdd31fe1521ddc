"""Image files: read completely or rejected, with colors as stored or in sRGB; PNGs written atomically."""

import errno
import re
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from schemas.atomic_write import refusal_of_disk, replacing
from schemas.color_spaces import REC709, ColorSpace, matrix_between
from schemas.errors import BadInput
from schemas.native_output import native_output_silenced
from schemas.safe_names import check_utf8
from schemas.safe_reading import allowance, check_allowance, opened

# Uncompressed. A header that claims more is damaged or hostile.
LARGEST_IMAGE_MB = 2048
SLOW_IMAGE_MB = 192  # JPEG 2000 and JPEG XL: a file of 2 kB can take minutes to decode
BAND_BYTES = 4 << 20
LARGEST_ENTRY = 100.0  # largest entry of a matrix from other primaries; real ones stay below 10
_LIGHT = ("openexr", "hdr")
_ASSOCIATED = ("tiff",)  # code values may be premultiplied, according to the header
_SCALES = {"uint8": 255, "uint16": 65535, "half": 1, "float": 1, "double": 1}
_SEVERAL = 4  # decoded bytes for each stored byte, at most
_DECODED_BY_ROWS = (b"v/1\x01", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"#?", b"\x89PNG", b"\xff\xd8\xff")
_SLOW = (b"\0\0\0\x0c", b"\xff\x4f\xff\x51")
_opening = threading.Lock()  # the limit is per process: no other thread may change it before the file is open
_CLAIMED = re.compile(r"image size ([\d.]+) MB exceeds.*?claimed to be (\d+)x(\d+)", re.S)


@dataclass(frozen=True, eq=False)
class Image:
    """One image.

    Attributes:
        pixels: [height, width, 1, 3 or 4] float32; 0..1 for integer formats, as stored for float formats.
        bits: Bits of each stored channel value: 8, 16 or 32.
        linear: True: linear light, premultiplied, as in EXR. False: code values with straight alpha, as in PNG.
        chromaticities: CIE x, y of red, green, blue and white, where an EXR names them; () means Rec.709.
    """

    pixels: np.ndarray
    bits: int
    linear: bool = False
    chromaticities: tuple[float, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @property
    def channels(self) -> int:
        """1 for gray, 3 for RGB, 4 for RGBA."""
        return int(self.pixels.shape[2])


@contextmanager
def _opened(path: Path) -> Iterator["oiio.ImageInput"]:
    with native_output_silenced():
        source = _open(path)
        try:
            yield source
        except UnicodeDecodeError as error:  # in the name of a channel or an attribute
            raise BadInput(f"{path} is damaged: it contains a name that is not text; replace or remove it") from error
        finally:
            source.close()


def _open(path: Path) -> "oiio.ImageInput":
    try:
        with opened(path) as stream:  # a codec would block on a named pipe and read a device forever
            head = stream.read(16)
    except FileNotFoundError:
        raise BadInput(f"{path}: image file not found") from None
    check_utf8(path)
    settings = oiio.ImageSpec()
    settings.attribute("oiio:UnassociatedAlpha", 1)  # else colors come premultiplied and rounded to 8 bits
    _error_of(oiio)  # clear the error of an earlier file
    with _opening:
        oiio.attribute("limits:imagesize_MB", _most_to_open(head) >> 20)
        source = oiio.ImageInput.open(str(path), settings)
    if source is None:
        error = _error_of(oiio)
        if claimed := _CLAIMED.search(error):
            size, width, height = float(claimed[1]), int(claimed[2]), int(claimed[3])
            if size < LARGEST_IMAGE_MB:
                check_allowance(path, width, height, _SEVERAL * int(size * 2**20))
        raise BadInput(f"{path} is not a readable image ({_first_line(error, path)}); replace or remove it")
    return source


def _error_of(source: Any) -> str:
    """Return the last error of OpenImageIO or of one of its files."""
    try:
        return str(source.geterror())
    except UnicodeDecodeError:  # it may quote bytes of the file
        return "damaged"


def _most_to_open(head: bytes) -> int:
    """Return the most bytes of pixels to accept from a file with this head; some codecs decode all on opening."""
    if head.startswith(_DECODED_BY_ROWS):
        return LARGEST_IMAGE_MB << 20
    most = min(LARGEST_IMAGE_MB << 20, allowance() // _SEVERAL)
    return min(most, SLOW_IMAGE_MB << 20) if head[:4] in _SLOW or head.startswith(b"\xff\x0a") else most


def _first_line(message: str, path: Path) -> str:
    message = message.replace(f' ("{path}")', "").replace(f'"{path}"', "it")
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    return lines[0].rstrip(".") if lines else "damaged or cut short"  # some codecs fail silently


def read_image(path: Path | str, upright: bool = True) -> Image:
    """Read an image.

    8 and 16 bit values are divided by 255 and 65535. Gray with alpha becomes RGBA; of more channels, those named
    R, G, B, A are read. Premultiplied colors of a TIFF (its alpha is "associated") are divided by alpha. An EXR is
    cropped or zero-padded to its display window.

    Args:
        path: The file, in any format that OpenImageIO reads.
        upright: Apply the EXIF orientation; else keep rows as stored.

    Raises:
        BadInput: The file is missing, of an unknown format, truncated, damaged, larger than LARGEST_IMAGE_MB, or holds
            NaN or infinity.
        OutOfResources: It would need more memory than allowed (see schemas.safe_reading).
    """
    path = Path(path)
    with _opened(path) as source:
        spec, form = source.spec(), source.format_name()
        pixels = _decoded(source, path)
        if form in _ASSOCIATED and spec.alpha_channel >= 0 and not spec.get_int_attribute("oiio:UnassociatedAlpha", 0):
            _divide_by_alpha(pixels)
    if form == "openexr":
        pixels = _displayed(pixels, spec, path)
    if upright:
        pixels = _upright(pixels, spec.get_int_attribute("Orientation", 1))
    named = spec.getattribute("chromaticities") if form == "openexr" else ()
    primaries = named if isinstance(named, tuple) and len(named) == len(REC709.chromaticities) else ()
    return Image(pixels, spec.format.size() * 8, form in _LIGHT, primaries)


def _decoded(source: "oiio.ImageInput", path: Path) -> np.ndarray:
    """Decode to [h, w, 1, 3 or 4] float32, band by band to save memory."""
    spec = source.spec()
    scale = _SCALES.get(str(spec.format))
    if scale is None:
        raise BadInput(f"{path} stores its pixels as {spec.format}; expected 8 or 16 bits, or floating point")
    chosen = _color_channels(source, path)
    check_allowance(path, spec.width, spec.height, 4 * spec.width * spec.height * len(chosen))
    pixels = np.empty((spec.height, spec.width, len(chosen)), np.float32)
    rows = _rows_of_a_band(spec)
    for top in range(0, spec.height, rows):
        end = min(top + rows, spec.height)
        band = _band(source, spec, top, end)
        # A truncated JPEG yields both pixels and an error.
        error = _error_of(source) + _error_of(oiio)
        if band is None or error:
            raise BadInput(f"{path} cannot be read completely ({_first_line(error, path)}); replace or remove it")
        band = band.reshape(end - top, spec.width, -1)
        if scale == 1 and not np.isfinite(band).all():
            raise BadInput(f"{path} contains NaN or infinite values; replace or remove it")
        with np.errstate(over="ignore"):
            for place, channel in enumerate(chosen):
                np.divide(band[..., channel], np.float32(scale), out=pixels[top:end, :, place], casting="same_kind")
        if str(spec.format) == "double" and not np.isfinite(pixels[top:end]).all():
            raise BadInput(f"{path} contains values that overflow 32-bit floats; replace or remove it")
    return pixels


def _divide_by_alpha(pixels: np.ndarray) -> None:
    """Make premultiplied code values [h, w, 4] straight, 0..1, in place; 0 where alpha is 0."""
    for row in pixels:
        color, alpha = row[:, :3], row[:, 3:]
        np.divide(color, alpha, out=color, where=alpha > 0)
        color *= alpha > 0
        np.clip(color, 0, 1, out=color)


def _rows_of_a_band(spec: "oiio.ImageSpec") -> int:
    if spec.get_string_attribute("planarconfig") == "separate":  # each band would decode all strips again
        return spec.height
    unit = spec.tile_height or max(1, spec.get_int_attribute("tiff:RowsPerStrip", 1))
    row = max(1, spec.width * spec.nchannels * spec.format.size())
    return min(spec.height, unit * max(1, BAND_BYTES // (row * unit)))


def _band(source: "oiio.ImageInput", spec: "oiio.ImageSpec", top: int, end: int) -> np.ndarray | None:
    top, end, many = spec.y + top, spec.y + end, spec.nchannels
    if spec.tile_width:
        return source.read_tiles(spec.x, spec.x + spec.width, top, end, spec.z, spec.z + 1, 0, many, spec.format)
    return source.read_scanlines(top, end, spec.z, 0, many, spec.format)


def read_srgb(path: Path | str, upright: bool = True) -> Image:
    """Read an image as read_image does, with linear light converted to sRGB code values 0..1 and straight alpha.

    Light of other primaries than Rec.709's is converted to them. Light above 1 and colors beyond them are clipped.
    """
    image = read_image(path, upright)
    if not image.linear:
        return image
    linear, alpha = image.pixels[..., :3], image.pixels[..., 3:].clip(0, 1)
    if image.channels == 4:
        linear = np.where(alpha > 0, linear / np.maximum(alpha, np.float32(1e-6)), 0)
    if image.chromaticities and image.channels >= 3:
        linear = _in_rec709(linear, image.chromaticities, path)
    coded = srgb_from_linear(linear).clip(0, 1)
    return Image(np.concatenate([coded, alpha], axis=2), image.bits)


def _in_rec709(linear: np.ndarray, chromaticities: tuple[float, ...], path: Path | str) -> np.ndarray:
    """Convert light [h, w, 3] of these primaries; BadInput if they are invalid."""
    if np.allclose(chromaticities, REC709.chromaticities, atol=1e-4):
        return linear
    with np.errstate(all="ignore"):
        try:
            matrix = matrix_between(ColorSpace("", chromaticities), REC709)
        except (np.linalg.LinAlgError, ValueError, ZeroDivisionError):
            matrix = np.full((3, 3), np.nan)
    if not np.abs(matrix).max() < LARGEST_ENTRY:
        raise BadInput(f"{path} has invalid chromaticities; save it again")
    converted: np.ndarray = (linear @ matrix.T).astype(np.float32)
    return converted


def coverage(pixels: np.ndarray) -> np.ndarray:
    """Convert the pixels of a mask image [h, w, 1, 3 or 4] to coverage [h, w], 0..1.

    Uses alpha if any pixel is transparent, else the brightest channel; divided by its maximum, because 8-bit masks of
    0 and 1 are common.
    """
    cut = pixels.shape[2] == 4 and pixels[..., 3].min() < 1
    kept = pixels[..., 3] if cut else pixels[..., :3].max(axis=2)
    return (kept / max(float(kept.max()), 1e-12)).clip(0, 1)


def _color_channels(source: "oiio.ImageInput", path: Path) -> list[int]:
    """Return the stored channels that make up gray, RGB or RGBA, in order; BadInput if there are none."""
    spec, exr = source.spec(), source.format_name() == "openexr"
    names, count = spec.channelnames, spec.nchannels
    if source.format_name() == "null":
        raise BadInput(f"{path} is not an image")
    if exr and (why := _unusual(source, spec)):
        raise BadInput(f"{path} is {why}; save it as one flat part with channels R, G, B and optionally A")
    if {"R", "G", "B"} <= set(names):
        return [names.index(name) for name in "RGBA" if name in names]
    # Three channels of an EXR may be a position, or luma with subsampled chroma; a single one may be depth.
    if count == 1 and not (exr and names[0].upper().rpartition(".")[2] == "Z"):
        return [0]
    if not exr and count in (2, 3):
        return [0, 0, 0, 1] if count == 2 else [0, 1, 2]
    if exr and set(names) == {"Y", "A"}:
        return [names.index(name) for name in "YYYA"]
    raise BadInput(f"{path} has channels {', '.join(names[:12])}; expected gray, RGB or RGBA")


def _unusual(source: "oiio.ImageInput", spec: "oiio.ImageSpec") -> str:
    """Return why an EXR does not contain a single picture; "" if it does."""
    if spec.deep:
        return "a deep EXR, with a list of samples for each pixel"
    if (parts := spec.get_int_attribute("oiio:subimages", 1)) > 1:
        return f"an EXR of {parts} parts"
    if source.spec(0, 1).width:
        return "an EXR with mip levels"
    return ""


def _displayed(pixels: np.ndarray, spec: "oiio.ImageSpec", path: Path) -> np.ndarray:
    """Crop or zero-pad the data window to the display window."""
    width, height = spec.full_width, spec.full_height
    x, y = spec.x - spec.full_x, spec.y - spec.full_y
    if (x, y, spec.width, spec.height) == (0, 0, width, height):
        return pixels
    takes = width * height * pixels.shape[2] * pixels.itemsize
    if takes > LARGEST_IMAGE_MB << 20:
        raise BadInput(f"{path} has a display window of {width}x{height}, above the limit; replace or remove it")
    check_allowance(path, width, height, takes)
    shown = np.zeros((height, width, pixels.shape[2]), pixels.dtype)
    left, right, top, bottom = max(x, 0), min(x + spec.width, width), max(y, 0), min(y + spec.height, height)
    if left < right and top < bottom:
        shown[top:bottom, left:right] = pixels[top - y : bottom - y, left - x : right - x]
    return shown


# By EXIF orientation: whether to swap rows and columns, and how to flip them afterwards.
_TURNS: dict[int, tuple[bool, Any]] = {
    2: (False, np.s_[:, ::-1]), 3: (False, np.s_[::-1, ::-1]), 4: (False, np.s_[::-1]),
    5: (True, np.s_[:]), 6: (True, np.s_[:, ::-1]), 7: (True, np.s_[::-1, ::-1]), 8: (True, np.s_[::-1]),
}  # fmt: skip


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    if orientation not in _TURNS:
        return pixels
    swapped, flipped = _TURNS[orientation]
    return np.ascontiguousarray((pixels.swapaxes(0, 1) if swapped else pixels)[flipped])


def image_channels(path: Path | str) -> int:
    """Return the number of channels that read_image would return, reading the header only; BadInput likewise."""
    path = Path(path)
    with _opened(path) as source:
        return len(_color_channels(source, path))


def image_size(path: Path | str, upright: bool = True) -> tuple[int, int]:
    """Return (width, height) of what read_image would return, reading the header only; BadInput likewise."""
    path = Path(path)
    with _opened(path) as source:
        spec, form = source.spec(), source.format_name()
        _color_channels(source, path)
    size = (spec.full_width, spec.full_height) if form == "openexr" else (spec.width, spec.height)
    swapped = upright and _TURNS.get(spec.get_int_attribute("Orientation", 1), (False,))[0]
    return size[::-1] if swapped else size


def write_png(path: Path | str, array: np.ndarray) -> None:
    """Write a PNG atomically; equal pixels give equal bytes.

    Args:
        array: uint8 or uint16 [height, width] or [height, width, 1, 3 or 4], straight alpha.

    Raises:
        OutOfResources: The disk is full or read-only.
    """
    path = Path(path)
    pixels = np.ascontiguousarray(array if array.ndim == 3 else array[..., None])
    types = {np.dtype(np.uint8): oiio.UINT8, np.dtype(np.uint16): oiio.UINT16}
    if pixels.dtype not in types or pixels.shape[2] not in (1, 3, 4) or 0 in pixels.shape:
        raise ValueError(f"write_png takes uint8 or uint16 [h, w, 1|3|4], not {array.dtype} {array.shape}")
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], types[pixels.dtype])
    spec.attribute("oiio:UnassociatedAlpha", 1)
    with replacing(path) as temporary, native_output_silenced():
        target = oiio.ImageOutput.create(str(temporary))
        done = target is not None and target.open(str(temporary), spec) and target.write_image(pixels)
        done = target is not None and target.close() and done and not target.geterror()
        if not (done and png_is_whole(temporary)):
            raise refusal_of_disk(path, pixels.nbytes) or OSError(errno.EIO, "the PNG writer failed", str(path))


def png_is_whole(path: Path) -> bool:
    """Return whether all chunks of a PNG match their checksums; the codec ignores failed writes."""
    data, at, name = memoryview(path.read_bytes()), 8, b""
    while name != b"IEND" and at + 12 <= len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        name = bytes(data[at + 4 : at + 8])
        if zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            return False
        at = end
    return name == b"IEND"


def to_uint8(values: np.ndarray) -> np.ndarray:
    """Clip values to 0..1 and round to 0..255, in bands of rows to save memory."""
    values = np.asarray(values)
    if values.ndim < 2:
        return np.asarray(np.round(np.clip(values, 0.0, 1.0) * 255.0), np.uint8)
    found = np.empty(values.shape, np.uint8)
    rows = max(1, BAND_BYTES // max(1, values[:1].nbytes))
    for top in range(0, len(values), rows):
        found[top : top + rows] = np.round(np.clip(values[top : top + rows], 0.0, 1.0) * 255.0)
    return found


def linear_from_srgb(encoded: np.ndarray) -> np.ndarray:
    """Decode sRGB code values 0..1 to linear Rec.709 light (IEC 61966-2-1); negative values extend the linear part."""
    powered = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    linear: np.ndarray = np.where(encoded <= 0.04045, encoded / 12.92, powered).astype(encoded.dtype)
    return linear


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """Encode linear Rec.709 light as sRGB code values, the inverse of linear_from_srgb; not clipped."""
    powered = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    encoded: np.ndarray = np.where(linear <= 0.0031308, linear * 12.92, powered).astype(linear.dtype)
    return encoded
