"""Rays going into a field, and the samples that come out of walking them."""

from dataclasses import dataclass

import numpy as np

from stylerf.fields.scratch_arena import room


@dataclass
class Rays:
    """origins, directions (unit) [n, 3]; jitter [n] in 0..1 of a step; near [n]: where marching starts. All float32."""

    origins: np.ndarray
    directions: np.ndarray
    jitter: np.ndarray
    near: np.ndarray

    @staticmethod
    def of(origins: np.ndarray, directions: np.ndarray, near: float, jitter: np.ndarray | None = None) -> "Rays":
        """Rays marched from distance `near`, from the middle of the first step unless `jitter` says otherwise."""
        n = len(origins)
        middle = np.full(n, 0.5, np.float32) if jitter is None else jitter
        return Rays(origins, directions, middle, np.full(n, near, np.float32))


@dataclass
class Samples:
    """Samples of ray r are starts[r]:ends[r] of the other arrays; what lies between chunks of rays is never touched.

    t: distance, scene units. optical: optical length of unit raw density. x: position in the cube, as the field is
    asked (displaced). sigma: raw density. weights: compositing weights.
    """

    starts: np.ndarray
    ends: np.ndarray
    t: np.ndarray
    optical: np.ndarray
    x: np.ndarray
    sigma: np.ndarray
    weights: np.ndarray

    @staticmethod
    def empty(rays: int, limit: int) -> "Samples":
        """Room for `limit` samples on each ray; memory is only taken where it is written."""
        n = rays * limit
        one = [room((n,)) for _ in range(4)]
        return Samples(np.empty(rays, np.int64), np.empty(rays, np.int64), one[0], one[1], room((n, 3)), one[2], one[3])

    @property
    def count(self) -> int:
        """Samples on all rays."""
        return int((self.ends - self.starts).sum())
