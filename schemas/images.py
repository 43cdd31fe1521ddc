"""Photos and pictures: read whole or refused, colours as stored or in sRGB; PNG written as one step."""

import errno
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from schemas.atomic import refusal_of_disk, replacing
from schemas.errors import BadInput
from schemas.silence import native_output_silenced

# A header may claim any size: above this (uncompressed) the file is taken for damaged or hostile.
LARGEST_IMAGE_MB = 2048
_LIGHT = ("openexr", "hdr")


@dataclass(frozen=True, eq=False)
class Image:
    """One image. pixels: [height, width, 1, 3 or 4] float32, 0..1 for integer files, as stored for float ones.

    bits: of a stored channel value (8, 16 or 32). light: colours are linear light multiplied by alpha, as in EXR; else
    they are code values and alpha is straight, as in PNG.
    """

    pixels: np.ndarray
    bits: int
    light: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @property
    def channels(self) -> int:
        """1 grey, 3 RGB, 4 RGB and alpha."""
        return self.pixels.shape[2]


def _open(path: Path) -> "oiio.ImageInput":
    if not path.is_file():
        raise BadInput(f"{path}: no such image file")
    if (name := os.fsencode(path).decode("utf-8", "backslashreplace")) != str(path):  # which codecs cannot be given
        raise BadInput(f"{name}: its name is not UTF-8; rename it")
    oiio.attribute("limits:imagesize_MB", LARGEST_IMAGE_MB)
    settings = oiio.ImageSpec()
    settings.attribute("oiio:UnassociatedAlpha", 1)  # else colours come multiplied by alpha, rounded to 8 bit
    oiio.geterror()  # clears what an earlier file left
    source = oiio.ImageInput.open(str(path), settings)
    if source is None:
        raise BadInput(f"{path} is no readable image ({_first_line(oiio.geterror(), path)}); replace or remove it")
    return source


def _first_line(message: str, path: Path) -> str:
    message = message.replace(f' ("{path}")', "").replace(f'"{path}"', "it")
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    return lines[0].rstrip(".") if lines else "damaged or cut short"  # some codecs fail without a word


def read_image(path: Path | str, upright: bool = True) -> Image:
    """The image at `path`, turned by its EXIF orientation if `upright`, else with its rows as they are stored.

    8 and 16 bit values are divided by 255 and 65535. Grey with alpha becomes RGBA; of many channels those named
    R, G, B, A are taken. An EXR is what its display window shows: zeros where it has no data. BadInput with the file
    and the reason when it is missing, of an unknown format, cut short, damaged, larger than LARGEST_IMAGE_MB, or holds
    NaN or infinity.
    """
    path = Path(path)
    with native_output_silenced():
        source = _open(path)
        spec, form = source.spec(), source.format_name()
        kind = spec.format
        stored = source.read_image(kind)
        # Truncated JPEGs come back with pixels and an error: the error decides.
        error = source.geterror() + oiio.geterror()
        source.close()
    if stored is None or error:
        raise BadInput(f"{path} cannot be read whole ({_first_line(error, path)}); replace or remove it")
    scale = {"uint8": 255, "uint16": 65535}.get(str(kind), 1)
    pixels = np.asarray(stored, dtype=np.float32).reshape(spec.height, spec.width, -1) / np.float32(scale)
    if not np.isfinite(pixels).all():
        raise BadInput(f"{path} holds NaN or infinite values; replace or remove it")
    pixels = _colour_channels(pixels, spec.channelnames, path)
    if form == "openexr":
        pixels = _displayed(pixels, spec, path)
    if upright:
        pixels = _upright(pixels, spec.get_int_attribute("Orientation", 1))
    return Image(np.ascontiguousarray(pixels), kind.size() * 8, form in _LIGHT)


def read_srgb(path: Path | str, upright: bool = True) -> Image:
    """As read_image, but where the file holds light, that as sRGB code values 0..1 with straight alpha.

    Light brighter than white is white.
    """
    image = read_image(path, upright)
    if not image.light:
        return image
    light, alpha = image.pixels[..., :3], image.pixels[..., 3:].clip(0, 1)
    if image.channels == 4:
        light = np.where(alpha > 0, light / np.maximum(alpha, np.float32(1e-6)), 0)
    coded = srgb_from_linear(light).clip(0, 1)
    return Image(np.concatenate([coded, alpha], axis=2), image.bits)


def coverage(pixels: np.ndarray) -> np.ndarray:
    """What the picture of a mask, [h, w, 1, 3 or 4], keeps, [h, w] 0..1: its alpha where any pixel is transparent, else
    its brightest channel; divided by its largest value, for masks of 0 and 1 in eight bits are common."""
    cut = pixels.shape[2] == 4 and pixels[..., 3].min() < 1
    kept = pixels[..., 3] if cut else pixels[..., :3].max(axis=2)
    return (kept / max(float(kept.max()), 1e-12)).clip(0, 1)


def _colour_channels(pixels: np.ndarray, names: tuple[str, ...], path: Path) -> np.ndarray:
    count = pixels.shape[2]
    if count in (1, 3):
        return pixels
    if count == 2:
        return pixels[..., [0, 0, 0, 1]]
    if {"R", "G", "B"} <= set(names):
        return pixels[..., [names.index(name) for name in "RGBA" if name in names]]
    raise BadInput(f"{path} has channels {', '.join(names)}; expected grey, RGB or RGBA")


def _displayed(pixels: np.ndarray, spec: "oiio.ImageSpec", path: Path) -> np.ndarray:
    """The data window in the display window, cut off where it leaves it."""
    width, height = spec.full_width, spec.full_height
    x, y = spec.x - spec.full_x, spec.y - spec.full_y
    if (x, y, spec.width, spec.height) == (0, 0, width, height):
        return pixels
    if width * height * pixels.shape[2] * pixels.itemsize > LARGEST_IMAGE_MB << 20:
        raise BadInput(f"{path} has a display window of {width}x{height}, above the limit; replace or remove it")
    shown = np.zeros((height, width, pixels.shape[2]), pixels.dtype)
    left, right, top, bottom = max(x, 0), min(x + spec.width, width), max(y, 0), min(y + spec.height, height)
    if left < right and top < bottom:
        shown[top:bottom, left:right] = pixels[top - y : bottom - y, left - x : right - x]
    return shown


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    if orientation == 1 or not 1 <= orientation <= 8:
        return pixels
    buffer = oiio.ImageBuf(np.ascontiguousarray(pixels))
    buffer.orientation = orientation
    turned = oiio.ImageBufAlgo.reorient(buffer)
    return turned.get_pixels(oiio.FLOAT)


def image_channels(path: Path | str) -> int:
    """Channels that read_image gives (1, 3 or 4), from the header alone; BadInput as read_image."""
    path = Path(path)
    with native_output_silenced():
        source = _open(path)
        names = source.spec().channelnames
        source.close()
    return _colour_channels(np.empty((1, 1, len(names)), np.float32), names, path).shape[2]


def image_size(path: Path | str, upright: bool = True) -> tuple[int, int]:
    """(width, height) of what read_image gives, from its header alone; BadInput as read_image."""
    path = Path(path)
    with native_output_silenced():
        source = _open(path)
        spec, form = source.spec(), source.format_name()
        source.close()
    size = (spec.full_width, spec.full_height) if form == "openexr" else (spec.width, spec.height)
    turned = upright and 5 <= spec.get_int_attribute("Orientation", 1) <= 8  # the four that swap rows and columns
    return size[::-1] if turned else size


def write_png(path: Path | str, array: np.ndarray) -> None:
    """Writes uint8 or uint16 pixels [height, width] or [height, width, 1, 3 or 4] (straight alpha) as one step.

    Equal pixels give equal bytes. OutOfResources on a full disk or a folder without permission.
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
        done = target.open(str(temporary), spec) and target.write_image(pixels)
        done = target.close() and done and not target.geterror()
        if not done:
            raise refusal_of_disk(path, pixels.nbytes) or OSError(errno.EIO, "the PNG writer failed", str(path))


def to_uint8(values: np.ndarray) -> np.ndarray:
    """Values 0..1 (clipped) to the nearest of 0..255."""
    return np.round(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)


def linear_from_srgb(encoded: np.ndarray) -> np.ndarray:
    """Linear Rec.709 light from sRGB code values 0..1 (IEC 61966-2-1); values below 0 go along the linear part."""
    powered = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, powered).astype(encoded.dtype)


def srgb_from_linear(light: np.ndarray) -> np.ndarray:
    """sRGB code values from linear Rec.709 light, the inverse of linear_from_srgb; light above 1 goes above 1."""
    powered = 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, light * 12.92, powered).astype(light.dtype)
