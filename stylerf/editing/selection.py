"""Selecting a region in 3D: seeds from pixels, boxes, masks and colours, and what they may grow through."""

from collections.abc import Iterable

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, distance_transform_edt
from skimage.color import rgb2lab

from stylerf.editing.regions import march_view
from stylerf.fields.field import RadianceField
from stylerf.fields.samples import Rays
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space import Space
from stylerf.kernels.cpu.regions import add_to_cells, ends_inside

LIGHT = 0.5  # of a difference in lightness counts: one thing lies in light and in shadow
SEEN = 0.05  # summed weight from which a cell is known to be seen
INHERIT = 2.0  # cells that a colour reaches beyond the cells that are seen, into what is solid
EVERYWHERE = np.ones((3, 3, 3), bool)


class SeenCells:
    """What views see in the cells of a cube: how much, and in which mean colour.

    weight: [s, s, s] summed weights of the samples in a cell. lab: [s, s, s, 3] CIELAB of the photos' mean colour
    there, its lightness halved; cells that are not seen have that of the nearest seen one up to INHERIT cells away,
    others nan.
    """

    def __init__(
        self, field: RadianceField, cameras: Iterable[Camera], photos: Iterable[np.ndarray], cells: int, chunks: int
    ) -> None:
        sums = np.zeros((cells**3, 4), np.float32)
        for camera, photo in zip(cameras, photos, strict=True):
            colours = np.ascontiguousarray(photo.reshape(-1, 3), np.float32)
            for part, samples in march_view(field, camera, chunks):
                add_to_cells(colours[part], cells, samples.x, samples.weights, samples.starts, samples.ends, sums)
        shape = (cells,) * 3
        self.weight = sums[:, 3].reshape(shape)
        seen = self.weight > SEEN
        mean = sums[:, :3].reshape(*shape, 3) / np.maximum(self.weight, 1e-12)[..., None]
        lab = np.full((*shape, 3), np.nan, np.float32)
        lab[seen] = halved_light(mean[seen])
        away, nearest = distance_transform_edt(~seen, return_indices=True)
        near = (away > 0) & (away <= INHERIT)
        lab[near] = lab[tuple(axis[near] for axis in nearest)]
        self.lab, self.seen = lab, seen

    def like(self, colours: np.ndarray, tolerance: float) -> np.ndarray:
        """[s, s, s] bool: cells whose colour is within `tolerance` of any of the Lab colours [n, 3]."""
        known = np.isfinite(self.lab[..., 0])
        out = np.zeros(known.shape, bool)
        apart = np.full(int(known.sum()), np.inf, np.float32)
        own = self.lab[known]
        for colour in colours:
            apart = np.minimum(apart, np.linalg.norm(own - colour, axis=1))
        out[known] = apart <= tolerance
        return out


def halved_light(srgb: np.ndarray) -> np.ndarray:
    """CIELAB (D65) of sRGB colours [n, 3] in 0..1, L times LIGHT: Euclidean distances count light the less."""
    lab = rgb2lab(np.clip(srgb, 0, 1).reshape(-1, 1, 3)).reshape(-1, 3)
    lab[:, 0] *= LIGHT
    return lab.astype(np.float32)


def modes(lab: np.ndarray, apart: float) -> np.ndarray:
    """Few Lab colours [m, 3] such that each of [n, 3] is within `apart` of one: taken greedily, in order."""
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
    ends_inside(np.ones(1, bool), 1, s.x, s.t, s.weights, s.starts, s.ends, chunks, out)  # one cell: the whole cube
    return out[:, 3:] / np.maximum(out[:, :1], 1e-8), out[:, 0]


def inside_box(space: Space, cells: int, low, high) -> np.ndarray:
    """[cells, cells, cells] bool: cells whose centre lies in a box of scene units."""
    centres = space.unwarp(centres_of(cells))
    inside = ((centres >= np.minimum(low, high)) & (centres <= np.maximum(low, high))).all(1)
    return inside.reshape((cells,) * 3)


def inside_sphere(space: Space, cells: int, centre, radius: float) -> np.ndarray:
    """[cells, cells, cells] bool: cells whose centre lies in a sphere of scene units."""
    away = np.linalg.norm(space.unwarp(centres_of(cells)) - np.asarray(centre), axis=1)
    return (away <= radius).reshape((cells,) * 3)


def centres_of(cells: int) -> np.ndarray:
    """[cells^3, 3]: centres of all cells, in the cube."""
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
            add_to_cells(values[part], cells, samples.x, samples.weights, samples.starts, samples.ends, sums)
    return ((sums[:, 1] > SEEN) & (sums[:, 0] > 0.5 * sums[:, 1])).reshape((cells,) * 3)


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
