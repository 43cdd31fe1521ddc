"""NamedTuples of arrays, which the CPU kernels take instead of long argument lists.

numba specializes a kernel on the types of a tuple's fields, as for separate arguments. Kernels unpack a tuple before
their parallel loop, so that only arrays in use enter it; nested tuples cannot enter one at all, so tuples whose length
is a compile-time constant (a rank, a number of levels) remain separate arguments.

These classes are defined here because the cache of compiled kernels is keyed by the sources in this folder: numba
compares tuple types by class name and field types, not by the order of fields.
"""

from typing import NamedTuple

import numpy as np


class Rays(NamedTuple):
    """Rays to march; all float32.

    Attributes:
        origins: [rays, 3], world.
        directions: [rays, 3], world, unit length.
        jitter: [rays], offset of the first sample, 0..1 of a step.
        near: [rays], distance where marching starts, scene units.
    """

    origins: np.ndarray
    directions: np.ndarray
    jitter: np.ndarray
    near: np.ndarray

    @staticmethod
    def of(origins: np.ndarray, directions: np.ndarray, near: float, jitter: np.ndarray | None = None) -> "Rays":
        """Create rays that start at distance `near`, in the middle of the first step unless `jitter` is given."""
        n = len(origins)
        middle = np.full(n, 0.5, np.float32) if jitter is None else jitter
        return Rays(origins, directions, middle, np.full(n, near, np.float32))


class ShadingPoints(NamedTuple):
    """Points along rays to color; those of ray r are starts[r]:ends[r], the rest is padding.

    Attributes:
        starts, ends: [rays] int64.
        x: [n, 3], in the unit cube.
        weights: [n], compositing weights; points with weight 0 get no color.
    """

    starts: np.ndarray
    ends: np.ndarray
    x: np.ndarray
    weights: np.ndarray


class Samples(NamedTuple):
    """Samples along rays; those of ray r are starts[r]:ends[r], the rest is padding that is never touched.

    Attributes:
        starts, ends: [rays] int64.
        t: [n], distance from the ray's origin, scene units.
        deltas: [n], interval length; sigma * delta is the optical depth. 0: the opaque background.
        x: [n, 3], position in the unit cube after displacement.
        sigma: [n], raw density.
        weights: [n], compositing weights T (1 - exp(-sigma delta)).
    """

    starts: np.ndarray
    ends: np.ndarray
    t: np.ndarray
    deltas: np.ndarray
    x: np.ndarray
    sigma: np.ndarray
    weights: np.ndarray

    @property
    def total(self) -> int:
        """Total number of samples on all rays."""
        return int((self.ends - self.starts).sum())

    def shading_points(self, weights: np.ndarray | None = None) -> ShadingPoints:
        """Return the samples as points to color, with their own weights or `weights` [n]."""
        return ShadingPoints(self.starts, self.ends, self.x, self.weights if weights is None else weights)


class Space(NamedTuple):
    """The warp of space to the unit cube (geometry/space_warp.py): its kind, packed parameters and far distance."""

    kind: int
    numbers: np.ndarray  # [7] float32, see march.warp_at
    far: np.float32


class Occupancy(NamedTuple):
    """Distance of each cell to the nearest occupied one, in cells (0: occupied), [cells^3] uint8; cells per axis."""

    distances: np.ndarray
    cells: int


class Displacement(NamedTuple):
    """A displacement grid on the cube's vertices, flat [vertices^3 * 3] float32, cube units; vertices 0: none."""

    grid: np.ndarray
    vertices: int


class MarchSettings(NamedTuple):
    """Settings of ray marching.

    Attributes:
        step: advance of the warped position per sample, cube units.
        samples_per_ray: maximum number of samples per ray.
        min_transmittance: transmittance below which a ray terminates.
        opaque_background: whether the far end absorbs the remaining light (real-world captures).
    """

    step: np.float32
    samples_per_ray: int
    min_transmittance: np.float32
    opaque_background: bool


class Density(NamedTuple):
    """A density's parameters: its table [n] float32, the table's layout, and the shift of the exponent."""

    table: np.ndarray
    layout: np.ndarray
    shift: np.float32


class LinearColor(NamedTuple):
    """A vm color's parameters: table [n], vertices per axis [3] int64, head flat [3, bands, 3 rank], bias [3]."""

    table: np.ndarray
    size: np.ndarray
    head: np.ndarray
    bias: np.ndarray
