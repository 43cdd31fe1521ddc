"""Instant recoloring of rendered pixels as mixtures of palette colors, using a mean mixture per pixel.

While an exact image is rendered, the compositing weights also average the samples' mixtures. A new palette changes a
pixel by alpha u (c'(m) - c(m)), with m its mean mixture, u the part of its light that is mixed, and c, c' the colors
of a mixture before and after. Clamps and hue rotations act on the mean here, but on each sample in the exact image.
"""

from typing import Any, Protocol, runtime_checkable

import numpy as np

from stylerf.fields.color_heads import Packed
from stylerf.fields.color_map import ColorMap
from stylerf.fields.marching import ScratchArena
from stylerf.kernels.cpu.ray_samples import ShadingPoints


@runtime_checkable
class Mixing(Protocol):
    """Colors mixed from a palette: PaletteColor, EditedColor."""

    @property
    def degree(self) -> int: ...

    @property
    def mixture_width(self) -> int: ...

    def observed(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, seen: Any, arena: ScratchArena | None = None
    ) -> np.ndarray: ...

    def mixes_as(self, other: object) -> bool: ...

    def remixed(self, mixtures: np.ndarray) -> np.ndarray: ...


class MixtureRecorder:
    """Wraps a color part and averages its mixtures along each ray.

    Attributes:
        means: [rays, mixture_width], mean mixtures of the last batch.
        shares: [rays], part of each ray's light that is mixed, 0..1.
    """

    kind = "recorded"

    def __init__(self, color: Mixing) -> None:
        self._color, self.degree = color, color.degree
        self.means, self.shares = np.empty((0, color.mixture_width), np.float32), np.empty(0, np.float32)

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        """Return the wrapped part's colors."""
        rays = len(points.ends)
        self.means, mixed = np.zeros((rays, self._color.mixture_width), np.float32), np.zeros(rays, np.float32)

        def seen(index: np.ndarray, ray: np.ndarray, mixture: Any) -> None:
            weights = points.weights[index]
            firsts = np.flatnonzero(np.diff(ray, prepend=-1))  # rays ascend
            self.means[ray[firsts]] += np.add.reduceat(mixture() * weights[:, None], firsts)
            mixed[ray[firsts]] += np.add.reduceat(weights, firsts)

        out = self._color.observed(points, basis, threads, seen, arena)
        packed = Packed.weighted(points, threads)
        colored = np.bincount(packed.ray, points.weights[packed.index], rays)
        self.shares = (mixed / np.maximum(colored, 1e-9)).astype(np.float32)
        self.means /= np.maximum(mixed, 1e-9)[:, None]
        return out


def colors_of(color: Mixing, means: np.ndarray, color_map: ColorMap | None) -> np.ndarray:
    """Return the colors c(m) [n, 3] of mean mixtures [n, mixture_width], with a field's color map applied."""
    colors = color.remixed(means)
    if color_map is None:
        return colors
    import torch

    return color_map(torch.from_numpy(colors)).numpy()
