"""Regions as marked cells of the cube: the edit grid E and the growing grid G around it (LAENeRF, section 3.2).

LAENeRF uses cascaded grids, one per doubling of the scene. Here the field's warp maps all of space to one cube, so
region growing never crosses levels.

s: cells per axis. A set of cells is a bool array [s, s, s], in the order of the cube's axes.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.march import OPTICAL_SCALE
from stylerf.kernels.cpu.ray_samples import Rays, Samples
from stylerf.rendering.rays import alpha_inside

FEWEST_CELLS, MOST_CELLS = 64, 256
SOLID = 0.02  # minimum opacity of a cell that can belong to an object
FINE = 128  # cells per axis from which a cell's density is sampled only at its center, not at 2^3 points
POINTS_AT_ONCE = 1 << 20


@dataclass(frozen=True, eq=False)
class Region:
    """edit: E, the edited cells. grow: G, the surrounding cells of the transition. The two are disjoint."""

    edit: np.ndarray
    grow: np.ndarray

    def __post_init__(self) -> None:
        s = self.edit.shape[0]
        if self.edit.shape != (s, s, s) or self.grow.shape != self.edit.shape or not 1 <= s <= 1024:
            raise InvalidValue(f"region: grids of {self.edit.shape} and {self.grow.shape} cells")
        if self.edit.dtype != bool or self.grow.dtype != bool or (self.edit & self.grow).any():
            raise InvalidValue("region: expected grids of bool that share no cell")

    @property
    def cells(self) -> int:
        """Cells per axis, s."""
        return self.edit.shape[0]

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Return whether cube points [n, 3] are in E, [n] bool."""
        return self.edit[tuple(cells_of_points(x, self.cells).T)]

    def alpha(self, samples: Samples, threads: int) -> np.ndarray:
        """Return alpha_E [rays], the part of each ray's opacity inside E."""
        return alpha_inside(self.edit, samples, threads)


def cells_of_points(x: np.ndarray, cells: int) -> np.ndarray:
    """Return the cell indices [n, 3] int64 of cube points [n, 3], clamped to the grid."""
    return np.clip((np.asarray(x) * cells).astype(np.int64), 0, cells - 1)


def marked_at(x: np.ndarray, cells: int) -> np.ndarray:
    """Mark the cells of cube points [n, 3]; [cells, cells, cells] bool."""
    out = np.zeros((cells,) * 3, bool)
    out[tuple(cells_of_points(x, cells).T)] = True
    return out


def solid_cells(field: RadianceField, cells: int, threads: int, opacity: float = SOLID) -> np.ndarray:
    """Mark cells that a ray crosses with an opacity of at least `opacity`; [cells, cells, cells] bool.

    LAENeRF uses a raw density of 10 instead, which depends on the unit of density. A cell's density is that at its
    center, or the maximum of eight points for fewer than FINE cells per axis. Only cells that overlap occupied ones are
    evaluated.
    """
    # 1 - exp(-OPTICAL_SCALE sigma / cells) = opacity, solved for sigma: a cell is 1/cells long (decision 0002).
    threshold = -np.log1p(-opacity) / (float(OPTICAL_SCALE) / cells)
    candidates = np.flatnonzero(_holding(field.occupancy.distances.reshape((field.occupancy.cells,) * 3) == 0, cells))
    highest = np.zeros(cells**3, np.float32)
    probes = 1 if cells >= FINE else 2
    for probe in np.ndindex((probes,) * 3):
        shift = (np.array(probe, np.float32) + 0.5) / probes
        for at in range(0, len(candidates), POINTS_AT_ONCE):
            some = candidates[at : at + POINTS_AT_ONCE]
            corners = np.stack(np.unravel_index(some, (cells,) * 3), -1).astype(np.int32)
            points = np.ascontiguousarray((corners + shift) / np.float32(cells), np.float32)
            highest[some] = np.maximum(highest[some], field.density.sigma(points, threads))
    return (highest >= threshold).reshape((cells,) * 3)


def _holding(occupied: np.ndarray, cells: int) -> np.ndarray:
    """Mark cells that overlap an occupied one of [s, s, s]; [cells, cells, cells] bool."""
    ends = np.arange(cells + 1) * occupied.shape[0]
    spans = np.stack([ends[:-1] // cells, -(-ends[1:] // cells)], 1).ravel()  # [first, one past the last)
    # A span may end at s, which reduceat does not accept as an index; the padding cell is empty.
    out = np.pad(occupied, (0, 1))
    for axis in range(3):
        # reduceat also reduces from each span's end to the next one's beginning, so every second result is dropped.
        out = np.logical_or.reduceat(out, spans, axis).take(np.arange(0, 2 * cells, 2), axis)
    return out


@dataclass(frozen=True)
class Growth:
    """Result of region growing. shells: number of cells added per distance. whole: no candidates were left."""

    grown: np.ndarray
    shells: list[int]
    whole: bool


def grow(start: np.ndarray, allowed: np.ndarray, most: int, neck: float = 0.0) -> Growth:
    """Grow a region over face neighbors, breadth-first.

    The order is that of LAENeRF's queue: complete shells of equal distance, the last one truncated by cell index, so
    the result does not depend on threads.

    Args:
        start: [s, s, s] bool; these cells stay marked even if not allowed.
        allowed: [s, s, s] bool.
        most: Maximum number of cells to visit.
        neck: Stop where the object is thin: at the smallest shell once sizes fall below `neck` times the largest so
            far (see narrowest()). 0: never.
    """
    s = start.shape[0]
    marked, open_to = start.reshape(-1).copy(), allowed.reshape(-1)
    shells: list[np.ndarray] = []
    frontier, seen, looked = np.flatnonzero(marked), marked.copy(), 0
    while len(frontier) and looked < most:
        around = neighbors(frontier, s)
        # Sorted by neighbors(), so the truncation is deterministic.
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
    """Return the number of shells before the first neck, or of all shells.

    A neck is the minimum of the shell sizes, averaged over three, between falling below `neck` times the largest so far
    and exceeding that again. Sizes that only shrink are not a neck.
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
    """Return the flat indices, sorted and unique, of the face neighbors of cells [n] in a grid of s^3."""
    x, y, z = np.unravel_index(cells, (s, s, s))
    found = []
    for axis, stride in ((x, s * s), (y, s), (z, 1)):
        found += [cells[axis > 0] - stride, cells[axis < s - 1] + stride]
    return np.unique(np.concatenate(found)) if len(cells) else np.empty(0, np.int64)


def march_view(
    field: RadianceField, camera: Camera, threads: int, rays_at_once: int = 8192
) -> Iterator[tuple[slice, Samples]]:
    """Yield (slice of pixels, Samples) for the rays through all pixel centers of a view, in batches."""
    origins, directions = camera.rays()
    for at in range(0, len(origins), rays_at_once):
        part = slice(at, min(at + rays_at_once, len(origins)))
        yield (
            part,
            field.march(Rays.of(origins[part], directions[part], field.space.near), SAMPLES_PER_RAY, 1e-3, threads),
        )
