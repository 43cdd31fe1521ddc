"""What one view shows of a region, as the palette module learns from it (LAENeRF, section 3.3)."""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue


@dataclass(frozen=True, eq=False)
class EditView:
    """n pixels of one view that show the region; all arrays float32 but `pixels`.

    view: index of the scene's view. pixels: [n] int64 row-major numbers, ascending. x: [n, 3] where their rays end, in
    the cube. along: [n, 3] what x moves by when the ray ends one jitter further. directions: [n, 3] unit, from the
    camera. target: [n, 3] sRGB 0..1 of the photo. weight: [n] alpha of the field. inside: [n] alpha_E, the part of it
    that lies in the region. depth: [n] mean distance along the ray within the region, scene units. through: [n]
    sum(w t) over the whole ray but its backdrop. transition: [n] lambda, 1 where the region meets what surrounds it,
    0 far from it. edges: [n, 2] geometry edges zeta >= 0 between a pixel and the one below it, the one right of it.
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
        """Rows and columns of the bounding box of the pixels (both ends included: LAENeRF's code drops the last)."""
        rows, columns = np.divmod(self.pixels, self.width)
        return slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)

    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(upper, lower, left, right): places in `pixels` of all pairs of neighbors that both show the region."""
        place = np.full(self.width * (self.height + 1) + 1, -1, np.int64)
        place[self.pixels] = np.arange(len(self.pixels))
        below = place[self.pixels + self.width]
        beside = np.where(self.pixels % self.width < self.width - 1, place[self.pixels + 1], -1)
        upper, left = np.flatnonzero(below >= 0), np.flatnonzero(beside >= 0)
        return upper, below[upper], left, beside[left]


def check_pixels(pixels: np.ndarray, what: str, width: int, height: int) -> None:
    """InvalidValue where row-major numbers of pixels [n] int64 are not those of a picture of that size."""
    if len(pixels) and not (0 <= pixels.min() and pixels.max() < width * height):
        raise InvalidValue(f"the array {what} holds numbers of no pixel of {width}x{height}")
