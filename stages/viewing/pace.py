"""Measures how fast rays are rendered, and with how many threads: on a busy machine one is faster than several.

A picture while the camera moves takes a few hundredths of a second, in which five kernels each wait for their slowest
thread.
"""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from stylerf.kernels.cpu.compiling import set_threads

FIRST_RATE = 20_000.0  # rays per second, until measured
NEWEST = 0.3  # share of the newest measurement
FEWEST_RAYS, MOST_RAYS = 1024, 4096  # limits of a batch: below, kernel overhead dominates; above, memory use
TRY_EVERY = 16  # batches of exact pictures, one of which tries the other thread count


def use_threads(threads: int) -> int:
    """Set the threads of kernels, and of torch if colors need it; return their number."""
    if "torch" in sys.modules:
        import torch

        torch.set_num_threads(threads)
    return set_threads(threads)


class Pace:
    """Rays per second of exact pictures, by number of threads, and of those while the camera moves.

    Attributes:
        rate: Rays per second of exact pictures, by the better number of threads.
        moving: Rays per second while the camera moves.
    """

    def __init__(self, threads: int) -> None:
        self._rates = dict.fromkeys((threads, 1), FIRST_RATE)
        self._batches = 0
        self.moving = FIRST_RATE

    @property
    def rate(self) -> float:
        return max(self._rates.values())

    @property
    def best(self) -> int:
        """The number of threads that has been faster."""
        return max(self._rates, key=lambda threads: self._rates[threads])

    def rays_within(self, seconds: float) -> int:
        """Return how many rays of an exact picture can be rendered in about this time."""
        return int(min(max(self.rate * seconds, FEWEST_RAYS), MOST_RAYS))

    @contextmanager
    def exactly(self, rays: int) -> Iterator[int]:
        """Measure a batch of an exact picture; yields the threads to use, set for this Python thread."""
        self._batches += 1
        worse = min(self._rates, key=lambda threads: self._rates[threads])
        threads = worse if self._batches % TRY_EVERY == 2 else self.best
        began = time.perf_counter()
        yield use_threads(threads)
        self._rates[threads] = _mixed(self._rates[threads], rays, time.perf_counter() - began)

    @contextmanager
    def in_motion(self, rays: int) -> Iterator[int]:
        """Measure a picture while the camera moves; yields like exactly()."""
        began = time.perf_counter()
        yield use_threads(self.best)
        self.moving = _mixed(self.moving, rays, time.perf_counter() - began)


def _mixed(before: float, rays: int, seconds: float) -> float:
    return (1 - NEWEST) * before + NEWEST * rays / max(seconds, 1e-6)
