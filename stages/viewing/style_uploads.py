"""Style images uploaded from the page: checked, cropped, and saved as PNG in the viewer's own folder."""

import tempfile
from pathlib import Path

import numpy as np

from schemas.atomic_write import make_folder
from schemas.canonical_json import file_sha256
from schemas.errors import BadInput
from schemas.images import to_uint8, write_png
from stages.artifacts.style_images import SMALLEST_SIDE, read_shown

LARGEST_BYTES = 50_000_000
SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")


def read_upload(name: str, content: bytes) -> np.ndarray:
    """Return an uploaded image, [h, w, 3 or 4] float32 sRGB 0..1.

    Raises:
        BadInput: it is too large, or not an image.
    """
    suffix = Path(name).suffix.lower()
    if len(content) > LARGEST_BYTES:
        raise BadInput(
            f"the style image has {len(content) / 1e6:.0f} MB; at most {LARGEST_BYTES / 1e6:.0f} MB are supported"
        )
    if suffix not in SUFFIXES:
        raise BadInput(f"unsupported format; expected a style image in one of {', '.join(SUFFIXES)}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"style{suffix}"
        path.write_bytes(content)
        return read_shown(path)


def cropped(image: np.ndarray, across: float, down: float, size: float) -> np.ndarray:
    """Return the part of an image [h, w, c] around (across, down), as large as `size` of its sides; all in 0..1."""
    height, width = image.shape[:2]
    high, wide = (max(SMALLEST_SIDE, round(side * size)) for side in (height, width))
    if high > height or wide > width:
        raise BadInput(f"the style image is {width}x{height}; expected at least {SMALLEST_SIDE} pixels per side")
    top = min(max(round(down * height - high / 2), 0), height - high)
    left = min(max(round(across * width - wide / 2), 0), width - wide)
    return image[top : top + high, left : left + wide]


def kept(image: np.ndarray, folder: Path) -> Path:
    """Write an image as PNG, named after its content, so that the same painting is the same file; return the path."""
    make_folder(folder)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".upload.") as place:
        path = Path(place) / "style.png"
        write_png(path, to_uint8(image))
        target = folder / f"style-{file_sha256(path)[:12]}.png"
        path.replace(target)
    return target
