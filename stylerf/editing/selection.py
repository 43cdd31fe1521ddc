"""Selecting a region in 3D: seeds from pixels, boxes, masks and colors, and what they may grow through."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, distance_transform_edt
from skimage.color import rgb2lab

from stylerf.editing.edit_grid import march_view
from stylerf.fields.packed_surface import PackedSurface, surface_of
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.kernels.cpu.regions import add_to_cells, ends_inside, weights_inside

LIGHT = 0.5  # of a difference in lightness counts: one thing lies in light and in shadow
SEEN = 0.05  # summed weight from which a cell is known to be seen
INHERIT = 2.0  # cells that a color reaches beyond the cells that are seen, into what is solid
MOST_RAYS = 1 << 16  # of a view that is looked at; cells are wider than a pixel, and many views see each
SHARE = 0.02  # part of its ray's largest weight that a sample needs to be looked at
CLAIM_REACH = 2  # cells
EVERYWHERE = np.ones((3, 3, 3), bool)


@dataclass(frozen=True, eq=False)
class Look:
    """A view as a selection looks at it: what its rays end in, and the photo's sRGB colors there [rays, 3].

    stride: every stride-th pixel of every stride-th row has a ray.
    """

    surface: PackedSurface
    colors: np.ndarray
    stride: int

    @staticmethod
    def at(field: RadianceField, camera: Camera, photo: np.ndarray, chunks: int) -> "Look":
        """A view and its photo [h, w, 3], of which at most about MOST_RAYS pixels are looked at."""
        stride = math.ceil(math.sqrt(camera.height * camera.width / MOST_RAYS))
        surface = surface_of(field, camera, SHARE, chunks, stride=stride)
        colors = np.ascontiguousarray(photo[::stride, ::stride].reshape(-1, 3), np.float32)
        return Look(surface, colors, stride)

    def add(self, values: np.ndarray, cells: int, to: np.ndarray) -> None:
        """Add sum w (values, 1) of rays with values [rays, m] to the cells of their samples, to [cells^3, m + 1]."""
        add_to_cells(values, cells, self.surface.samples(np.arange(self.surface.alpha.size)), to)

    def share_inside(self, marked: np.ndarray, chunks: int) -> np.ndarray:
        """[rays, 1]: part of each ray's opacity that lies in marked cells [s, s, s]."""
        points = self.surface.samples(np.arange(self.surface.alpha.size))
        inside, flat = np.empty(len(points.starts), np.float32), np.ascontiguousarray(marked).reshape(-1)
        weights_inside(flat, marked.shape[0], points, chunks, inside)
        return (inside / np.maximum(self.surface.alpha.ravel(), 1e-6))[:, None]


class SeenCells:
    """What views see in the cells of a cube: how much, and in which mean color.

    weight: [s, s, s] summed weights of the samples in a cell. lab: [s, s, s, 3] CIELAB of the photos' mean color
    there, its lightness halved; cells that are not seen have that of the nearest seen one up to INHERIT cells away,
    others nan. known: [s, s, s] which have one.
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
        lab[seen] = halved_light(mean[seen])
        away, nearest = distance_transform_edt(~seen, return_indices=True)
        near = (away > 0) & (away <= INHERIT)
        lab[near] = lab[tuple(axis[near] for axis in nearest)]
        self.lab, self.seen, self.known = lab, seen, seen | near

    def like(self, colors: np.ndarray, tolerance: float) -> np.ndarray:
        """[s, s, s] bool: cells whose color is within `tolerance` of any of the Lab colors [n, 3]."""
        out = np.zeros(self.known.shape, bool)
        out[self.known] = self._apart(colors) <= tolerance
        return out

    def nearer(self, these: np.ndarray, those: np.ndarray) -> np.ndarray:
        """[s, s, s] bool: cells whose color is nearer to one of `these` Lab colors [n, 3] than to any of `those`."""
        out = np.zeros(self.known.shape, bool)
        out[self.known] = self._apart(these) < self._apart(those)
        return out

    def _apart(self, colors: np.ndarray) -> np.ndarray:
        """Of known cells, the distance to the nearest of colors [n, 3]; infinite for none."""
        own = self.lab[self.known]
        squares = np.full(len(own), np.inf, np.float32)
        for color in colors.astype(np.float32):
            off = own - color
            squares = np.minimum(squares, np.einsum("ij,ij->i", off, off))
        return np.sqrt(squares)


def halved_light(srgb: np.ndarray) -> np.ndarray:
    """CIELAB (D65) of sRGB colors [n, 3] in 0..1, L times LIGHT: Euclidean distances count light the less."""
    lab = rgb2lab(np.clip(srgb, 0, 1).reshape(-1, 1, 3)).reshape(-1, 3)
    lab[:, 0] *= LIGHT
    return lab.astype(np.float32)


def modes(lab: np.ndarray, apart: float) -> np.ndarray:
    """Few Lab colors [m, 3] such that each of [n, 3] is within `apart` of one: taken greedily, in order."""
    found: list[np.ndarray] = []
    left = lab[np.isfinite(lab).all(1)]
    while len(left) and len(found) < 64:
        found.append(left[len(left) // 2])
        left = left[np.linalg.norm(left - found[-1], axis=1) > apart]
    return np.array(found, np.float32).reshape(-1, 3)


def ends_of_rays(field: RadianceField, camera: Camera, pixels: np.ndarray, chunks: int) -> tuple[np.ndarray, ...]:
    """(x [n, 3] in the cube, alpha [n]) where the rays of pixels end: the means of their samples, by weight."""
    origins, directions = camera.rays(pixels)
    s = field.march(Rays.of(origins, directions, field.space.near), 512, 1e-3, chunks)
    out = np.empty((len(pixels), 6), np.float32)
    ends_inside(np.ones(1, bool), 1, s.shading_points(), s.t, chunks, out)  # one cell: the whole cube
    return out[:, 3:] / np.maximum(out[:, :1], 1e-8), out[:, 0]


def inside_box(space: SpaceWarp, cells: int, low, high) -> np.ndarray:
    """[cells, cells, cells] bool: cells whose center lies in a box of scene units."""
    centers = space.unwarp(centers_of(cells))
    inside = ((centers >= np.minimum(low, high)) & (centers <= np.maximum(low, high))).all(1)
    return inside.reshape((cells,) * 3)


def inside_sphere(space: SpaceWarp, cells: int, center, radius: float) -> np.ndarray:
    """[cells, cells, cells] bool: cells whose center lies in a sphere of scene units."""
    away = np.linalg.norm(space.unwarp(centers_of(cells)) - np.asarray(center), axis=1)
    return (away <= radius).reshape((cells,) * 3)


def centers_of(cells: int) -> np.ndarray:
    """[cells^3, 3]: centers of all cells, in the cube."""
    return (np.stack(np.unravel_index(np.arange(cells**3), (cells,) * 3), -1) + 0.5) / cells


def shown_by_masks(
    field: RadianceField, cameras: list[Camera], masks: list[np.ndarray], cells: int, chunks: int
) -> np.ndarray:
    """[cells, cells, cells] bool: cells of which the views, where they see them, have more than half inside the masks.

    masks: [h, w] in 0..1, one a camera.
    """
    sums = np.zeros((cells**3, 2), np.float32)
    for camera, mask in zip(cameras, masks, strict=True):
        values = np.ascontiguousarray(mask.reshape(-1, 1), np.float32)
        for part, samples in march_view(field, camera, chunks):
            add_to_cells(values[part], cells, samples.shading_points(), sums)
    return ((sums[:, 1] > SEEN) & (sums[:, 0] > 0.5 * sums[:, 1])).reshape((cells,) * 3)


def claimed(looks: Iterable[Look], marked: np.ndarray, chunks: int) -> np.ndarray:
    """The marked cells [s, s, s], and those around them that the views see as the same thing.

    A surface that a fit left soft is spread over cells before and behind those that growing found, which look like
    whatever shines through. A cell within CLAIM_REACH is taken where the rays that see something in it have, by
    weight, more than half of their opacity in marked cells; rays that see it without the region outvote those.
    """
    cells = marked.shape[0]
    sums = np.zeros((cells**3, 2), np.float32)
    for look in looks:
        look.add(look.share_inside(marked, chunks), cells, sums)
    known = (sums[:, 1] > SEEN) & (sums[:, 0] > 0.5 * sums[:, 1])
    return marked | (known.reshape(marked.shape) & binary_dilation(marked, EVERYWHERE, iterations=CLAIM_REACH))


def shell(marked: np.ndarray, width: int, among: np.ndarray) -> np.ndarray:
    """[s, s, s] bool: cells of `among` within `width` cells of marked ones (corners count), but not marked."""
    if width < 1:
        return np.zeros_like(marked)
    return binary_dilation(marked, EVERYWHERE, iterations=width) & among & ~marked


def filled(marked: np.ndarray, reach: int, among: np.ndarray) -> np.ndarray:
    """The marked cells and those of `among` in gaps of up to twice `reach` cells between them: highlights, print."""
    if reach < 1:
        return marked
    room = np.pad(marked, reach)  # a closing must not be cut off at the cube's border
    closed = binary_erosion(binary_dilation(room, EVERYWHERE, iterations=reach), EVERYWHERE, iterations=reach)
    inner = (slice(reach, -reach),) * 3
    return marked | (closed[inner] & among)


def padded(marked: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The marked cells and those that touch them, but for `others`: a surface is soft, and ends beside its cells."""
    return binary_dilation(marked, EVERYWHERE) & ~others
