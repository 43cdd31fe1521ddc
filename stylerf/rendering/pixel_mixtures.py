"""Pixels as mixtures of palette colors, recolored at once: the mean mixture of each pixel instead of every sample's.

While an exact picture is rendered, the compositing weights also average what the colors are mixed of. Another palette
changes a pixel by alpha u (c'(m) - c(m)): m its mean mixture, u the part of its light that is mixed, c and c' the
colors of a mixture before and after. Clamps and turned hues act on the mean here, on each sample in the exact picture.
"""

from typing import Any, Protocol, runtime_checkable

import numpy as np

from stylerf.fields.color_heads import Packed
from stylerf.fields.color_map import ColorMap
from stylerf.fields.marching import ScratchArena
from stylerf.kernels.cpu.ray_samples import ShadingPoints


@runtime_checkable
class Mixing(Protocol):
    """Colors that are mixed of a palette: PaletteColor, EditedColor."""

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
    """Colors of another part, whose mixtures it averages along each ray.

    Attributes:
        means: [rays, mixture_width] of the last batch.
        shares: [rays], part of each ray's light that is mixed, 0..1.
    """

    kind = "recorded"

    def __init__(self, color: Mixing) -> None:
        self._color, self.degree = color, color.degree
        self.means, self.shares = np.empty((0, color.mixture_width), np.float32), np.empty(0, np.float32)

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        """Return the other part's own colors."""
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
    """Return c(m) [n, 3] of mean mixtures [n, mixture_width], through a field's color map."""
    colors = color.remixed(means)
    if color_map is None:
        return colors
    import torch

    return color_map(torch.from_numpy(colors)).numpy()
