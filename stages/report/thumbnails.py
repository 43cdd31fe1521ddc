"""Thumbnails for a page: photos, renders, and color-mapped error and depth, as JPEG data URIs."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from skimage.transform import resize

from stylerf.environment.matplotlib_defaults import colormaps, imsave

MAX_ERROR = 0.25  # mean absolute difference over RGB at the bright end of the color map
ERROR_COLORS, DEPTH_COLORS = "inferno", "viridis_r"  # perceptually uniform; viridis_r makes near bright
NOT_FINITE = (1.0, 0.0, 1.0)  # magenta: unlikely in photos, color maps and style images
EMPTY = (0.5, 0.5, 0.5)
ENCODINGS = ((480, 85), (360, 80), (280, 70), (200, 60))  # width in pixels and JPEG quality, best first


@dataclass(frozen=True)
class Picture:
    """An image [h, w, 3] in 0..1 for the contact sheet, its caption and its text alternative."""

    image: np.ndarray
    caption: str
    alt: str

    def small(self) -> "Picture":
        """Downscale to the largest size a page shows, so that memory does not depend on the photos' size."""
        return Picture(downscaled(self.image, ENCODINGS[0][0]).astype(np.float32), self.caption, self.alt)


@dataclass(frozen=True)
class Encoded:
    """A picture as a data URI, with its size in pixels."""

    uri: str
    width: int
    height: int
    caption: str
    alt: str


def displayable(image: np.ndarray) -> np.ndarray:
    """Clip to 0..1; pixels with NaN or infinite values become magenta."""
    bad = ~np.isfinite(image).all(axis=-1)
    return np.where(bad[..., None], NOT_FINITE, np.clip(np.nan_to_num(image), 0, 1))


def error_picture(render: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """Mean absolute difference over RGB of two images [h, w, 3], color-mapped from 0 to MAX_ERROR."""
    error = np.abs(np.nan_to_num(render) - photo).mean(axis=-1)
    colored = colormaps[ERROR_COLORS](np.clip(error / MAX_ERROR, 0, 1))[..., :3]
    return np.where(np.isfinite(render).all(axis=-1)[..., None], colored, NOT_FINITE)


def depth_picture(z: np.ndarray, alpha: np.ndarray, near: float, far: float) -> np.ndarray:
    """Color-map planar depth [h, w] linearly in 1/z, near bright, far dark; gray where alpha <= 0.5."""
    opaque = alpha > 0.5
    finite = np.isfinite(z) & (z > 0)
    inverse = 1 / np.where(finite, z, near)
    place = (1 / near - inverse) / max(1 / near - 1 / far, 1e-12)
    colored = colormaps[DEPTH_COLORS](np.clip(place, 0, 1))[..., :3]
    colored = np.where(opaque[..., None], colored, EMPTY)
    return np.where((opaque & ~finite)[..., None], NOT_FINITE, colored)


def depth_range(depths: Sequence[np.ndarray], alphas: Sequence[np.ndarray]) -> tuple[float, float]:
    """2nd and 98th percentile of the depth of opaque pixels over all views; (1, 2) if there are none."""
    kept = [z[(alpha > 0.5) & np.isfinite(z) & (z > 0)] for z, alpha in zip(depths, alphas, strict=True)]
    joined = np.concatenate(kept) if kept else np.zeros(0)
    if joined.size == 0:
        return 1.0, 2.0
    near, far = np.percentile(joined, [2, 98])
    return float(near), float(max(far, near * 1.001))


def css_gradient(name: str, steps: int = 9) -> str:
    """A color map as a CSS gradient, low end left."""
    stops = colormaps[name](np.linspace(0, 1, steps))[:, :3]
    colors = ",".join("#" + "".join(f"{round(float(part) * 255):02x}" for part in stop) for stop in stops)
    return f"linear-gradient(to right,{colors})"


def encode(pictures: Sequence[Picture], budget_bytes: int) -> list[Encoded]:
    """Encode as JPEG data URIs, at the best of ENCODINGS whose total fits the budget, else at the last."""
    encoded: list[Encoded] = []
    for width, quality in ENCODINGS:
        encoded = [_encoded(picture, width, quality) for picture in pictures]
        if sum(len(item.uri) for item in encoded) <= budget_bytes:
            break
    return encoded


def downscaled(image: np.ndarray, width: int) -> np.ndarray:
    """Downscale an image [h, w, 3] to `width` pixels if it is wider."""
    if image.shape[1] <= width:
        return image
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    return resize(image, (height, width), anti_aliasing=True)


def _encoded(picture: Picture, width: int, quality: int) -> Encoded:
    image = downscaled(picture.image, width)
    pixels = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    buffer = io.BytesIO()
    imsave(buffer, pixels, format="jpeg", pil_kwargs={"quality": quality, "optimize": True})
    uri = "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
    return Encoded(uri, pixels.shape[1], pixels.shape[0], picture.caption, picture.alt)
