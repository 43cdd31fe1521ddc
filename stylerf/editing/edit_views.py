"""The training data of a palette module: the pixels of a region in one view (LAENeRF, section 3.3)."""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue


@dataclass(frozen=True, eq=False)
class EditView:
    """The n pixels of one view that show the region; all arrays but `pixels` are float32.

    Attributes:
        view: Index of the scene's view.
        width, height: Of the view, pixels.
        pixels: [n] int64, row-major indices, ascending.
        x: [n, 3] ends of the rays, in the cube.
        along: [n, 3] change of x if the ray ends one jitter farther.
        directions: [n, 3] unit, from the camera.
        target: [n, 3] the photo, sRGB 0..1.
        weight: [n] alpha of the field.
        inside: [n] alpha_E, the part of alpha inside the region.
        depth: [n] mean distance along the ray within the region, scene units.
        through: [n] sum(w t) over the whole ray, without its opaque background.
        transition: [n] lambda, 1 at the region's border with its surroundings, 0 far from it.
        edges: [n, 2] geometry edges zeta >= 0 to the pixel below and to the pixel on the right.
    """

    view: int
    width: int
    height: int
    pixels: np.ndarray
    x: np.ndarray
    along: np.ndarray
    directions: np.ndarray
    target: np.ndarray
    weight: np.ndarray
    inside: np.ndarray
    depth: np.ndarray
    through: np.ndarray
    transition: np.ndarray
    edges: np.ndarray

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the pixels' bounding box, both ends included (LAENeRF's code drops the last)."""
        rows, columns = np.divmod(self.pixels, self.width)
        return slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)

    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return (upper, lower, left, right): indices into `pixels` of all vertical and horizontal neighbors."""
        place = np.full(self.width * (self.height + 1) + 1, -1, np.int64)
        place[self.pixels] = np.arange(len(self.pixels))
        below = place[self.pixels + self.width]
        beside = np.where(self.pixels % self.width < self.width - 1, place[self.pixels + 1], -1)
        upper, left = np.flatnonzero(below >= 0), np.flatnonzero(beside >= 0)
        return upper, below[upper], left, beside[left]


def check_pixels(pixels: np.ndarray, what: str, width: int, height: int) -> None:
    """Raise InvalidValue if row-major pixel indices [n] int64 lie outside an image of this size."""
    if len(pixels) and not (0 <= pixels.min() and pixels.max() < width * height):
        raise InvalidValue(f"the array {what} holds pixels outside {width}x{height}")
