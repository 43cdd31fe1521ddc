"""Blend the colors of several stylizations of one field over its shared density, by weight and by region.

Layers without cells are mixed by their weights, which add up to 1. Each layer with cells is then composited over those
before it within its cells: it gets `weight`, they share the rest. Pixels are linear in the colors of samples, so
blending rendered layers equals blending samples. A field's color map and its clamp act on pixels (decision 0006), and
here they do so per layer: with constant weights, the image of a blend is the blend of the images.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.color_heads import Packed, uncolored
from stylerf.fields.color_map import ColorMap
from stylerf.fields.marching import ScratchArena, empty_array
from stylerf.fields.protocol import ColorPart
from stylerf.geometry.spherical_harmonics import BANDS
from stylerf.kernels.cpu import regions as kernels
from stylerf.kernels.cpu.ray_samples import ShadingPoints

MOST_LAYERS = 32  # including those of nested blends; each is evaluated for every image
ROUNDING = 1e-6  # of a sum of weights
MOST_BLENDS = 8  # nesting depth
EVERYWHERE = np.ones((1, 1, 1), np.bool_)


@dataclass(frozen=True, eq=False)
class Layer:
    """One field's contribution to a blend.

    Attributes:
        color, color_map, weight_threshold: as in RadianceField.
        weight: 0..1.
        within: [s, s, s] bool, cells of the unit cube that the layer is limited to; None: everywhere.
    """

    color: ColorPart
    color_map: ColorMap | None
    weight_threshold: float
    weight: float
    within: np.ndarray | None = None


class BlendedColor:
    """A weighted mix of layers, with further layers over it in regions. It has no learnable values.

    layers: bottom to top; those without cells come first.
    """

    kind = "blend"

    def __init__(self, layers: Sequence[Layer]) -> None:
        self.layers = tuple(layers)
        everywhere = [layer.weight for layer in layers if layer.within is None]
        if any(layer.within is not None for layer in layers[: len(everywhere)]):
            raise InvalidValue("blend: a layer limited to a region comes before one of the whole scene")
        if not all(0 <= layer.weight <= 1 for layer in layers) or abs(sum(everywhere) - 1) > ROUNDING:
            raise InvalidValue(f"blend: expected weights in 0..1 that add up to 1, found {everywhere}")
        if (count := len(self.simple)) > MOST_LAYERS:
            raise InvalidValue(f"blend: {count} layers; at most {MOST_LAYERS} are supported")
        if self.depth > MOST_BLENDS:
            raise InvalidValue(
                f"blend: {self.depth} nested blends; at most {MOST_BLENDS} are supported. Blend the fields that the "
                "inner ones mix"
            )
        self.values = np.empty(0, np.float32)

    @property
    def depth(self) -> int:
        """The nesting depth of blends, including this one."""
        return 1 + max((one.color.depth for one in self.layers if isinstance(one.color, BlendedColor)), default=0)

    @property
    def simple(self) -> list[Layer]:
        """All layers that are not blends themselves, including those of nested blends."""
        found = []
        for layer in self.layers:
            found += layer.color.simple if isinstance(layer.color, BlendedColor) else [layer]
        return found

    @property
    def degree(self) -> int:
        """The highest spherical-harmonic degree of all layers; each layer reads its own bands."""
        return max(layer.color.degree for layer in self.layers)

    def shares(
        self, points: ShadingPoints, threads: int, arena: ScratchArena | None = None, of: np.ndarray | None = None
    ) -> Iterator[tuple[Layer, np.ndarray]]:
        """Yield each layer that is not a blend with its share of every point, [n] in 0..1; all shares add up to `of`.

        Args:
            points: samples on rays; shares of all other entries are undefined.
            threads: partitions of the rays.
            arena: allocates the shares; None: new memory.
            of: [n], the share of this blend itself; None: 1.
        """
        for number, layer in enumerate(self.layers):
            own = empty_array((len(points.x),), arena)
            if of is None:
                kernels.fill(np.float32(1), points, threads, own)
            weight = np.float32(layer.weight)
            kernels.weigh_cells(
                own if of is None else of, *_cells(layer.within), weight, np.float32(0), points, threads, own
            )
            for over in self.layers[number + 1 :]:
                if over.within is not None:
                    rest = np.float32(1) - np.float32(over.weight)
                    kernels.weigh_cells(own, *_cells(over.within), rest, np.float32(1), points, threads, own)
            if isinstance(layer.color, BlendedColor):
                yield from layer.color.shares(points, threads, arena, own)
            else:
                yield layer, own

    def groups(self) -> list[tuple[int, int, float]]:
        return []

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        """Return colors as ColorPart.colors does, with each layer's color map and clamp applied per sample.

        Images are composited layer by layer instead (rendering/rays.py), so that clamps act on pixels.
        """
        import torch

        out, index = uncolored(points, threads, arena), Packed.weighted(points, threads).index
        mixed = np.zeros((len(index), 3), np.float32)
        for layer, share in self.shares(points, threads, arena):
            bands = BANDS[layer.color.degree]
            own = layer.color.colors(points, np.ascontiguousarray(basis[:, :bands]), threads, arena)[index]
            if layer.color_map is not None:
                own = np.clip(layer.color_map(torch.from_numpy(own)).numpy(), 0, 1)
            mixed += share[index, None] * own
        out[index] = mixed
        return out

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> NoReturn:
        raise InvalidValue("a blend's colors cannot be trained; train the fields that it mixes")

    def add_position_gradients(
        self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int
    ) -> NoReturn:
        raise InvalidValue("a blend's colors cannot be trained; train the fields that it mixes")

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Do nothing: there are no values to smooth."""

    def describe(self) -> dict:
        return {"kind": self.kind, "layers": [_described(layer) for layer in self.layers]}


def _described(layer: Layer) -> dict:
    return {
        "color": layer.color.describe(),
        "color_map": None if layer.color_map is None else layer.color_map.describe(),
        "share": layer.weight_threshold,
        "weight": layer.weight,
        "cells": 0 if layer.within is None else len(layer.within),
    }


def _cells(within: np.ndarray | None) -> tuple[np.ndarray, int]:
    """Return marked cells in the kernels' layout: (flat array, cells per side)."""
    marked = EVERYWHERE if within is None else within
    return np.ascontiguousarray(marked).reshape(-1), len(marked)
