"""Selection of a 3D region: seeds from pixels, boxes, masks and colors, and the cells through which it may grow."""

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from skimage.color import rgb2lab

from stylerf.editing.edit_grid import march_view
from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.fields.packed_surface import PackedSurface, surface_of
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.kernels.cpu.regions import add_to_cells, ends_inside, weights_inside

LIGHTNESS = 0.5  # factor for lightness differences, since an object may be partly in shadow
SEEN = 0.05  # summed weight above which a cell counts as seen
INHERIT = 2.0  # distance, in cells, that colors extend from seen cells into others
MOST_RAYS = 1 << 16  # per view; cells are larger than pixels, and many views see each
WEIGHT_THRESHOLD = 0.02  # samples below this fraction of their ray's largest weight are ignored
CLAIM_REACH = 2  # cells


@dataclass(frozen=True, eq=False)
class Look:
    """A subsampled view for selection.

    Attributes:
        surface: Where its rays end.
        colors: The photo's sRGB colors [rays, 3].
        stride: Pixels between rays, in both directions.
    """

    surface: PackedSurface
    colors: np.ndarray
    stride: int

    @staticmethod
    def at(field: RadianceField, camera: Camera, photo: np.ndarray, threads: int) -> "Look":
        """March about MOST_RAYS rays of a view with its photo [h, w, 3]."""
        stride = math.ceil(math.sqrt(camera.height * camera.width / MOST_RAYS))
        surface = surface_of(field, camera, WEIGHT_THRESHOLD, threads, stride=stride)
        colors = np.ascontiguousarray(photo[::stride, ::stride].reshape(-1, 3), np.float32)
        return Look(surface, colors, stride)

    def add(self, values: np.ndarray, cells: int, to: np.ndarray) -> None:
        """Add sum w (values, 1) for rays with values [rays, m] to the cells of their samples: to [cells^3, m + 1]."""
        add_to_cells(values, cells, self.surface.samples(np.arange(self.surface.alpha.size)), to)

    def share_inside(self, marked: np.ndarray, threads: int) -> np.ndarray:
        """Return the fraction of each ray's opacity in marked cells [s, s, s], [rays, 1]."""
        points = self.surface.samples(np.arange(self.surface.alpha.size))
        inside, flat = np.empty(len(points.starts), np.float32), np.ascontiguousarray(marked).reshape(-1)
        weights_inside(flat, marked.shape[0], points, threads, inside)
        return (inside / np.maximum(self.surface.alpha.ravel(), 1e-6))[:, None]


class SeenCells:
    """Visibility and mean color of the cells of a cube.

    Attributes:
        weight: [s, s, s], summed weights of the samples in each cell.
        lab: [s, s, s, 3], CIELAB of the photos' mean color, with halved lightness; unseen cells use the nearest seen
            cell within INHERIT cells, else NaN.
        known: [s, s, s] bool, cells with a color.
    """

    def __init__(self, looks: Iterable[Look], cells: int) -> None:
        sums = np.zeros((cells**3, 4), np.float32)
        for look in looks:
            look.add(look.colors, cells, sums)
        shape = (cells,) * 3
        self.weight = sums[:, 3].reshape(shape)
        seen = self.weight > SEEN
        mean = sums[:, :3].reshape(*shape, 3) / np.maximum(self.weight, 1e-12)[..., None]
        lab = np.full((*shape, 3), np.nan, np.float32)
        lab[seen] = halved_lightness(mean[seen])
        # Cells behind the visible surface are solid but have no observed color.
        near, nearest = nearest_within(seen, INHERIT)
        lab.reshape(-1, 3)[near] = lab.reshape(-1, 3)[nearest]
        known = seen.copy()
        known.reshape(-1)[near] = True
        self.lab, self.seen, self.known = lab, seen, known

    def like(self, colors: np.ndarray, tolerance: float) -> np.ndarray:
        """Mark cells whose color is within `tolerance` of any of the Lab colors [n, 3]; [s, s, s] bool."""
        out = np.zeros(self.known.shape, bool)
        out[self.known] = self._apart(colors) <= tolerance
        return out

    def nearer(self, these: np.ndarray, those: np.ndarray) -> np.ndarray:
        """Mark cells whose color is closer to one of `these` Lab colors [n, 3] than to `those`; [s, s, s] bool."""
        out = np.zeros(self.known.shape, bool)
        out[self.known] = self._apart(these) < self._apart(those)
        return out

    def _apart(self, colors: np.ndarray) -> np.ndarray:
        """Return the distance of known cells to the nearest of colors [n, 3]; infinite without colors."""
        own = self.lab[self.known]
        squares = np.full(len(own), np.inf, np.float32)
        for color in colors.astype(np.float32):
            off = own - color
            squares = np.minimum(squares, np.einsum("ij,ij->i", off, off))
        return np.asarray(np.sqrt(squares))


def halved_lightness(srgb: np.ndarray) -> np.ndarray:
    """Convert sRGB colors [n, 3], 0..1, to CIELAB (D65) with L scaled by LIGHTNESS, to weight it less in distances."""
    lab = rgb2lab(np.clip(srgb, 0, 1).reshape(-1, 1, 3)).reshape(-1, 3)
    lab[:, 0] *= LIGHTNESS
    return lab.astype(np.float32)


def modes(lab: np.ndarray, apart: float) -> np.ndarray:
    """Choose Lab colors [m, 3] greedily, in order, so that each of [n, 3] is within `apart` of one."""
    found: list[np.ndarray] = []
    left = lab[np.isfinite(lab).all(1)]
    while len(left) and len(found) < 64:
        # The middle one in the seeds' order: any would do, but the choice must be deterministic.
        found.append(left[len(left) // 2])
        left = left[np.linalg.norm(left - found[-1], axis=1) > apart]
    return np.array(found, np.float32).reshape(-1, 3)


def ends_of_rays(field: RadianceField, camera: Camera, pixels: np.ndarray, threads: int) -> tuple[np.ndarray, ...]:
    """Return the rays' ends for pixels [n], as weighted means of their samples: x [n, 3] in the cube, and alpha [n]."""
    origins, directions = camera.rays(pixels)
    s = field.march(Rays.of(origins, directions, field.space.view_start(camera.center)), SAMPLES_PER_RAY, 1e-3, threads)
    out = np.empty((len(pixels), 6), np.float32)
    ends_inside(np.ones(1, bool), 1, s.shading_points(), s.t, threads, out)  # one cell: the whole cube
    return out[:, 3:] / np.maximum(out[:, :1], 1e-8), out[:, 0]


def inside_box(space: SpaceWarp, cells: int, low: ArrayLike, high: ArrayLike) -> np.ndarray:
    """Mark cells whose center is in a box, scene units; [cells, cells, cells] bool."""
    centers = space.unwarp(centers_of(cells))
    inside = ((centers >= np.minimum(low, high)) & (centers <= np.maximum(low, high))).all(1)
    return inside.reshape((cells,) * 3)


def inside_sphere(space: SpaceWarp, cells: int, center: ArrayLike, radius: float) -> np.ndarray:
    """Mark cells whose center is in a sphere, scene units; [cells, cells, cells] bool."""
    away = np.linalg.norm(space.unwarp(centers_of(cells)) - np.asarray(center), axis=1)
    return np.asarray(away <= radius).reshape((cells,) * 3)


def centers_of(cells: int) -> np.ndarray:
    """Return the centers of all cells in the cube, [cells^3, 3]."""
    return np.asarray((np.stack(np.unravel_index(np.arange(cells**3), (cells,) * 3), -1) + 0.5) / cells)


def shown_by_masks(
    field: RadianceField, cameras: list[Camera], masks: list[np.ndarray], cells: int, threads: int
) -> np.ndarray:
    """Mark cells that are more than half inside the masks, by weight in the views; [cells, cells, cells] bool.

    masks: [h, w] in 0..1, one per camera.
    """
    sums = np.zeros((cells**3, 2), np.float32)
    for camera, mask in zip(cameras, masks, strict=True):
        values = np.ascontiguousarray(mask.reshape(-1, 1), np.float32)
        for part, samples in march_view(field, camera, threads):
            add_to_cells(values[part], cells, samples.shading_points(), sums)
    return ((sums[:, 1] > SEEN) & (sums[:, 0] > 0.5 * sums[:, 1])).reshape((cells,) * 3)


def claimed(looks: Iterable[Look], marked: np.ndarray, threads: int) -> np.ndarray:
    """Extend marked cells [s, s, s] by neighbors that the views see as part of the same surface.

    A soft surface extends in front of and behind the cells found by growing, where colors mix with the background. A
    cell within CLAIM_REACH is added if the rays that see it have, by weight, more than half of their opacity in marked
    cells.
    """
    cells = marked.shape[0]
    sums = np.zeros((cells**3, 2), np.float32)
    for look in looks:
        look.add(look.share_inside(marked, threads), cells, sums)
    known = (sums[:, 1] > SEEN) & (sums[:, 0] > 0.5 * sums[:, 1])
    return marked | (known.reshape(marked.shape) & widened(marked, CLAIM_REACH))


def widened(marked: np.ndarray, width: int) -> np.ndarray:
    """Mark all cells within `width` cells of marked ones, including diagonals; [s, s, s] bool.

    Separable: SciPy's dilation visits all 27 neighbors, which takes ten times as long.
    """
    out = marked.copy()
    for axis in range(3):
        for _ in range(width):
            before = np.moveaxis(out, axis, 0)
            out = out.copy()
            after = np.moveaxis(out, axis, 0)
            after[1:] |= before[:-1]
            after[:-1] |= before[1:]
    return out


def nearest_within(marked: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Find the nearest marked cell within `reach` cells of each unmarked one, in [s, s, s] bool.

    Ties go to the cell with the smallest last index, then the smallest middle and first one, as in SciPy's distance
    transform, which however processes all cells, no matter how far away.

    Returns:
        Flat indices [n] of the unmarked cells, and of the nearest marked ones.
    """
    wide = math.ceil(reach)
    around = (np.array(o) for o in itertools.product(range(-wide, wide + 1), repeat=3))
    steps = sorted((step for step in around if 0 < step @ step <= reach**2), key=lambda o: (o @ o, *o[::-1]))
    room = np.pad(marked, wide)
    strides = np.array([room.shape[1] * room.shape[2], room.shape[2], 1])
    left = np.flatnonzero(np.pad(widened(marked, wide) & ~marked, wide))
    found, ends = [left[:0]], [left[:0]]
    for step in steps:
        met = room.reshape(-1)[left + step @ strides]
        found.append(left[met])
        ends.append(left[met] + step @ strides)
        left = left[~met]

    def inner(flat: np.ndarray) -> np.ndarray:
        axes = np.unravel_index(flat, room.shape)
        return np.ravel_multi_index(tuple(axis - wide for axis in axes), marked.shape)

    return inner(np.concatenate(found)), inner(np.concatenate(ends))


def shell(marked: np.ndarray, width: int, among: np.ndarray) -> np.ndarray:
    """Mark unmarked cells of `among` within `width` cells of marked ones, including diagonals; [s, s, s] bool."""
    if width < 1:
        return np.zeros_like(marked)
    return widened(marked, width) & among & ~marked


def filled(marked: np.ndarray, reach: int, among: np.ndarray) -> np.ndarray:
    """Close gaps of up to 2 `reach` cells, such as highlights and print, with cells of `among`."""
    if reach < 1:
        return marked
    room = np.pad(marked, reach)  # so that the closing also works at the cube's border
    closed = ~widened(~widened(room, reach), reach)
    inner = (slice(reach, -reach),) * 3
    return marked | (closed[inner] & among)


def padded(marked: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Add all cells that touch marked ones, except `others`: a soft surface extends beyond its cells."""
    return widened(marked, 1) & ~others
