"""The contents of a picture in the viewer: fields, planes and marked cells, seen by a camera."""

from dataclasses import dataclass, field

import numpy as np

from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.rendering.view import RenderedView, depth_picture, displacement_picture

PLANES = ("color", "depth", "alpha", "displacement", "mask")
WITH_DISTANCE = ("depth", "displacement")  # planes that show where rays end
TINT = np.array([1.0, 0.1, 0.8], np.float32)  # of marked cells, as in the previews of `stylerf select`
TINT_SHARE = 0.55


@dataclass(frozen=True, eq=False)
class Source:
    """A field to show. name: of its artifact. level: gray behind it, 0..1."""

    name: str
    field: RadianceField
    level: float


@dataclass(frozen=True, eq=False)
class Shown:
    """What is shown. Two are equal only if they are the same object, so a changed field or region is a new one.

    Attributes:
        left: The field, or with `right` the one to the left of the wipe.
        right: The field to the right of the wipe, None without one.
        wipe: Position of the wipe, as a fraction of the width.
        plane: One of PLANES.
        marked: [s, s, s] bool, cells to tint (with plane `mask`, all that is shown); None: none.
    """

    left: Source
    right: Source | None = None
    wipe: float = 0.5
    plane: str = "color"
    marked: np.ndarray | None = field(default=None, repr=False)

    def differs_by_colors(self, other: "Shown") -> bool:
        """Return whether the same density is shown in the same way."""
        return (
            self.left.field.density is other.left.field.density
            and self.left.level == other.left.level
            and self.right is other.right
            and (self.wipe, self.plane) == (other.wipe, other.plane)
            and self.marked is other.marked
        )

    def boundary(self, width: int) -> int:
        """Return the first column of the right field."""
        return width if self.right is None else round(np.clip(self.wipe, 0, 1) * width)


def picture_of(shown: Shown, camera: Camera, out: np.ndarray) -> np.ndarray:
    """Return the picture [h, w, 3] uint8 of rendered pixels.

    Args:
        out: [h, w, 6] as of interlaced.render_pixels.
    """
    boundary = shown.boundary(camera.width)
    picture = np.empty((camera.height, camera.width, 3), np.uint8)
    for source, columns in ((shown.left, slice(0, boundary)), (shown.right, slice(boundary, camera.width))):
        if source is not None and columns.start < columns.stop:
            picture[:, columns] = _plane(shown, source, camera, out)[:, columns]
    if shown.right is not None and 0 < boundary < camera.width:
        picture[:, boundary] = 255
    return picture


def _plane(shown: Shown, source: Source, camera: Camera, out: np.ndarray) -> np.ndarray:
    alpha = np.clip(out[..., 3], 0, 1)
    inside = np.clip(out[..., 5], 0, 1)
    if shown.plane == "depth":
        return depth_picture(out[..., 4] * camera.ray_cosines() * (alpha > 0), alpha)
    if shown.plane in ("alpha", "mask"):
        gray = alpha if shown.plane == "alpha" else inside
        return bytes_of(np.repeat(gray[..., None], 3, 2))
    if shown.plane == "displacement":
        if source.field.displacement is None:
            return np.zeros((*alpha.shape, 3), np.uint8)
        distance = np.where(alpha > 0, out[..., 4], 0)
        return displacement_picture(
            source.field, camera, RenderedView(out[..., :3], alpha, distance, distance * camera.ray_cosines())
        )
    rgb = out[..., :3] + (1 - alpha[..., None]) * np.float32(source.level)
    if shown.marked is not None:
        rgb = rgb * (1 - TINT_SHARE * inside[..., None]) + TINT_SHARE * inside[..., None] * TINT
    return bytes_of(rgb)


def bytes_of(values: np.ndarray) -> np.ndarray:
    """Return sRGB values 0..1 as uint8."""
    return (np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)
