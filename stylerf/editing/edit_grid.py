"""A part of a scene as marked cells of the cube: the edit grid E, and the growing grid G around it (LAENeRF, 3.2).

LAENeRF keeps cascades of grids, one for each doubling of the scene; here the field's own warp draws all of space into
one cube, so that a neighbor is a neighbor everywhere and growth has no levels to cross.

s: cells a side. A set of cells is a bool array [s, s, s], in the order of the cube's axes.
"""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.radiance_field import RadianceField
from stylerf.kernels.cpu.march import OPTICAL_SCALE
from stylerf.kernels.cpu.ray_samples import Rays, Samples
from stylerf.rendering.region_alpha import alpha_inside

FEWEST_CELLS, MOST_CELLS = 64, 256
SOLID = 0.02  # opacity of a walk across one cell from which it can belong to something
FINE = 128  # cells a side from which one point tells a cell's density; of larger ones two a side are asked
POINTS_AT_ONCE = 1 << 20


@dataclass(frozen=True, eq=False)
class Region:
    """edit: E, what is edited. grow: G, what lies around it and takes part in the transition; they share no cell."""

    edit: np.ndarray
    grow: np.ndarray

    def __post_init__(self) -> None:
        s = self.edit.shape[0]
        if self.edit.shape != (s, s, s) or self.grow.shape != self.edit.shape or not 1 <= s <= 1024:
            raise InvalidValue(f"region: grids of {self.edit.shape} and {self.grow.shape} cells")
        if self.edit.dtype != bool or self.grow.dtype != bool or (self.edit & self.grow).any():
            raise InvalidValue("region: grids of bool that share no cell were expected")

    @property
    def cells(self) -> int:
        """s."""
        return self.edit.shape[0]

    def holds(self, x: np.ndarray) -> np.ndarray:
        """[n] bool: whether cube points [n, 3] lie in E."""
        return self.edit[tuple(cells_of_points(x, self.cells).T)]

    def alpha(self, samples: Samples, chunks: int) -> np.ndarray:
        """alpha_E [rays]: how much of each ray's opacity lies inside E."""
        return alpha_inside(self.edit, samples, chunks)


def cells_of_points(x: np.ndarray, cells: int) -> np.ndarray:
    """[n, 3] int64: the cells that cube points [n, 3] lie in; points outside count to the border."""
    return np.clip((np.asarray(x) * cells).astype(np.int64), 0, cells - 1)


def marked_at(x: np.ndarray, cells: int) -> np.ndarray:
    """[cells, cells, cells] bool: the cells of cube points [n, 3]."""
    out = np.zeros((cells,) * 3, bool)
    out[tuple(cells_of_points(x, cells).T)] = True
    return out


def solid_cells(field: RadianceField, cells: int, chunks: int, opacity: float = SOLID) -> np.ndarray:
    """[cells, cells, cells] bool: where a walk across one cell would be at least `opacity` opaque.

    LAENeRF asks for a raw density of 10 instead, which means nothing where densities are counted per cell or cube.
    The density of a cell is that of its center, or the largest of eight points where there are fewer than FINE cells a
    side; only cells that hold something of the field's occupied ones are asked.
    """
    least = -np.log1p(-opacity) / (float(OPTICAL_SCALE) / cells)
    corner = np.stack(np.unravel_index(np.arange(cells**3), (cells,) * 3), -1).astype(np.int32)
    asked = np.flatnonzero(_holding(field.occupancy.distances.reshape((field.occupancy.cells,) * 3) == 0, cells))
    highest = np.zeros(cells**3, np.float32)
    probes = 1 if cells >= FINE else 2
    for probe in np.ndindex((probes,) * 3):
        shift = (np.array(probe, np.float32) + 0.5) / probes
        for at in range(0, len(asked), POINTS_AT_ONCE):
            some = asked[at : at + POINTS_AT_ONCE]
            points = np.ascontiguousarray((corner[some] + shift) / np.float32(cells), np.float32)
            highest[some] = np.maximum(highest[some], field.density.sigma(points, chunks))
    return (highest >= least).reshape((cells,) * 3)


def _holding(occupied: np.ndarray, cells: int) -> np.ndarray:
    """[cells, cells, cells] bool: cells that share room with an occupied one [s, s, s]."""
    ends = np.arange(cells + 1) * occupied.shape[0]
    spans = np.stack([ends[:-1] // cells, -(-ends[1:] // cells)], 1).ravel()  # from the first to beyond the last
    out = np.pad(occupied, (0, 1))
    for axis in range(3):
        out = np.logical_or.reduceat(out, spans, axis).take(np.arange(0, 2 * cells, 2), axis)
    return out


@dataclass(frozen=True)
class Growth:
    """What growing came to. shells: cells newly marked at each distance; whole: nothing was left to look at."""

    grown: np.ndarray
    shells: list[int]
    whole: bool


def grow(start: np.ndarray, allowed: np.ndarray, most: int, neck: float = 0.0) -> Growth:
    """Region growing over faces, breadth first, from `start` through `allowed` cells, looking at up to `most` cells.

    start, allowed: [s, s, s] bool. Cells of `start` stay marked, allowed or not. The order is that of LAENeRF's queue:
    whole shells at equal distance, cut within the last by the cells' numbers, so that the result does not depend on
    how the work is shared out.

    neck: growing ends where the object is thin: at the narrowest shell that follows on one of less than `neck` times
    the widest so far (see `narrowest`). 0: never.
    """
    s = start.shape[0]
    marked, open_to = start.reshape(-1).copy(), allowed.reshape(-1)
    shells: list[np.ndarray] = []
    frontier, seen, looked = np.flatnonzero(marked), marked.copy(), 0
    while len(frontier) and looked < most:
        around = neighbors(frontier, s)
        around = around[~seen[around]][: most - looked]
        seen[around] = True
        looked += len(around)
        frontier = around[open_to[around]]
        shells.append(frontier)
    sizes = [len(shell) for shell in shells]
    kept = narrowest(sizes, neck)
    for shell in shells[:kept]:
        marked[shell] = True
    return Growth(marked.reshape(start.shape), sizes[:kept], kept == len(shells) and not len(frontier))


def narrowest(sizes: list[int], neck: float) -> int:
    """How many shells to keep: all, or those before the first neck.

    A neck is where the shells' sizes, the mean of three, have fallen under `neck` times the largest before; it ends
    where they are least before they rise to that again. What dwindles to nothing is no neck but the end.
    """
    if neck <= 0 or len(sizes) < 3:
        return len(sizes)
    smooth = np.convolve(np.pad(sizes, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")
    highest, thin = 0.0, None
    for i, size in enumerate(smooth):
        highest = max(highest, size)
        if size < neck * highest:
            thin = i if thin is None or size < smooth[thin] else thin
        elif thin is not None:
            return thin
    return len(sizes)


def neighbors(cells: np.ndarray, s: int) -> np.ndarray:
    """Flat numbers, ascending and each once, of the face neighbors of flat cell numbers [n] in a grid of s^3."""
    x, y, z = np.unravel_index(cells, (s, s, s))
    found = []
    for axis, stride in ((x, s * s), (y, s), (z, 1)):
        found += [cells[axis > 0] - stride, cells[axis < s - 1] + stride]
    return np.unique(np.concatenate(found)) if len(cells) else np.empty(0, np.int64)


def march_view(field: RadianceField, camera, chunks: int, rays_at_once: int = 8192):
    """(slice of pixels, Samples) of every pixel center of a view, part by part."""
    origins, directions = camera.rays()
    for at in range(0, len(origins), rays_at_once):
        part = slice(at, min(at + rays_at_once, len(origins)))
        yield part, field.march(Rays.of(origins[part], directions[part], field.space.near), 512, 1e-3, chunks)
