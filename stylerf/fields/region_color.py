"""Separate colors for a region on top of a field's; outside the region, colors are unchanged, bit for bit.

Distant points share planes and lines (vm) and hash tables, so fine-tuning one part of a scene would tint others. Here,
only the region's samples are evaluated, and only its own values learn.
"""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.blended_color import BlendedColor
from stylerf.fields.hash_grid import HashColor
from stylerf.fields.marching import ScratchArena
from stylerf.fields.protocol import ColorPart
from stylerf.kernels.cpu import regions as kernels
from stylerf.kernels.cpu.ray_samples import ShadingPoints

MOST_REGIONS = 100  # stacked


class RegionColor:
    """Color sigmoid(logit(base) + f) in marked cells, and base elsewhere; f = 0 reproduces the base.

    Attributes:
        base: the color part underneath, fixed.
        own: f, a hash grid over the bounding cube of the marked cells. values: its values.
        marked: [s, s, s] bool, cells of the unit cube.
        depth: number of stacked region colors, including this one.

    Raises:
        InvalidValue: the cells are not a valid region, the base is a blend, or there are too many regions.
    """

    kind = "patch"

    def __init__(self, base: ColorPart, own: HashColor, marked: np.ndarray) -> None:
        s = marked.shape[0]
        if marked.shape != (s, s, s) or marked.dtype != bool or not marked.any():
            raise InvalidValue(f"region color: expected marked cells [s, s, s] bool, found {marked.shape}")
        if isinstance(base, BlendedColor):
            raise InvalidValue(
                "a region of a blend cannot have its own colors; change the fields that it mixes, then blend those"
            )
        self.depth: int = 1 + (base.depth if isinstance(base, RegionColor) else 0)
        if self.depth > MOST_REGIONS:
            raise InvalidValue(
                f"{self.depth} stacked regions with their own colors; at most {MOST_REGIONS} are supported. "
                "Fine-tune the whole field instead"
            )
        self.base, self.own, self.marked = base, own, np.ascontiguousarray(marked)
        self._flat, self.cells = self.marked.reshape(-1), s
        self.low, self.side = box_of(self.marked)

    @classmethod
    def create(
        cls, base: ColorPart, marked: np.ndarray, pixel_cells: float, table: int = 1 << 15, levels: int = 8
    ) -> "RegionColor":
        """Create a color equal to its base. pixel_cells: resolution of a grid over the cube with pixel-sized cells."""
        side = box_of(marked)[1]
        finest = int(np.clip(round(pixel_cells * side), 16, 1024)) if np.isfinite(pixel_cells) else 64
        own = HashColor.create(np.random.default_rng(0), levels, min(8, finest), finest, table)
        own.values[:] = 0
        return cls(base, own, marked)

    @property
    def values(self) -> np.ndarray:
        """The learnable values."""
        return self.own.values

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics that the base reads."""
        return self.base.degree

    def groups(self) -> list[tuple[int, int, float]]:
        return self.own.groups()

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        out = self.base.colors(points, basis, threads, arena)
        inside = points._replace(x=np.empty_like(points.x), weights=np.empty_like(points.weights))
        kernels.restrict(*self._cells_and_box, points, threads, inside.x, inside.weights)
        own = self.own.colors(inside, None, threads, arena)
        kernels.add_logits(own, points.starts, points.ends, threads, out)
        return out

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the per-thread buffers `to` [threads, len(values)].

        A sigmoid's derivative follows from its value alone, regardless of the logits added inside it.
        """
        inside, own_colors = self._colored_inside(points, colors, len(to))
        self.own.backward(inside, None, own_colors, color_gradients, to)

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        self.base.add_position_gradients(points, basis, colors, color_gradients, out, threads)
        inside, own_colors = self._colored_inside(points, colors, threads)
        found = np.zeros(points.x.shape, np.float32)
        self.own.add_position_gradients(inside, None, own_colors, color_gradients, found, threads)
        # Chain rule: the position in the region's cube is (x - low) / side.
        kernels.add_scaled(found, np.float32(1 / self.side), points.starts, points.ends, threads, out)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient that pulls the colors back to the base to buffer `to` [len(values)]."""
        self.own.smooth(strength, to)

    def describe(self) -> dict:
        return {"kind": self.kind, "cells": self.cells, "own": self.own.describe(), "base": self.base.describe()}

    @property
    def _cells_and_box(self) -> tuple:
        return self._flat, self.cells, self.low.astype(np.float32), np.float32(1 / self.side)

    def _colored_inside(self, points: ShadingPoints, colors, threads: int) -> tuple[ShadingPoints, np.ndarray]:
        """Return (points with x relative to the box, colors with -1 in the first channel outside or if uncolored)."""
        own_x, inside = np.empty_like(points.x), np.empty_like(colors)
        kernels.restrict_colored(*self._cells_and_box, points, colors, threads, own_x, inside)
        return points._replace(x=own_x), inside


def box_of(marked: np.ndarray) -> tuple[np.ndarray, float]:
    """Return (lower corner [3], side) of the bounding cube of marked cells [s, s, s], cube units."""
    where = np.argwhere(marked)
    low, high = where.min(0) / marked.shape[0], (where.max(0) + 1) / marked.shape[0]
    return low, float((high - low).max())
