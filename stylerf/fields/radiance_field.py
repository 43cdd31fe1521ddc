"""A radiance field: a density part and a color part over a warped space, with the occupancy that guides rays."""

from dataclasses import dataclass

import numpy as np
import torch

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.color_map import ColorMap
from stylerf.fields.encoded_color import EncodedColor
from stylerf.fields.hash_color import HashColor
from stylerf.fields.hash_density import HashDensity
from stylerf.fields.occupancy_grid import MOST_CELLS, OccupancyGrid
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.protocol import ColorPart, DensityPart
from stylerf.fields.ray_samples import Rays, Samples
from stylerf.fields.region_color import RegionColor
from stylerf.fields.vm import VmColor, VmDensity
from stylerf.fields.voxel import VoxelDensity
from stylerf.geometry.space_warp import SpaceWarp

DENSITY_KINDS = {"vm": VmDensity, "hash": HashDensity, "voxel": VoxelDensity}
COLOR_KINDS = {"vm": VmColor, "hash": HashColor, "headed": EncodedColor, "palette": PaletteColor}
LEAST_STEP = 1e-5  # cube units: a ray takes no more than 10^5 steps
MOST_PATCHES = 100  # over one another
_NO_DISPLACEMENT = np.empty(0, np.float32)


@dataclass
class RadianceField:
    """density and color may be of different kinds. step: marching step in cube units.

    displacement: [m, m, m, 3] float32 on vertices, cube units, added to every position before density and color are
    asked (DeSRF's deformation, as a grid), or None. color_map: affine map of the rendered colors (exact color
    matching after a stylization), or None. share: part of its ray's largest weight that a sample must have to be
    colored; what lies below takes the ray's mean.
    """

    space: SpaceWarp
    density: DensityPart
    color: ColorPart
    occupancy: OccupancyGrid
    step: float
    displacement: np.ndarray | None = None
    color_map: ColorMap | None = None
    share: float = 1e-2

    @property
    def closed(self) -> bool:
        """Whether rays end in an opaque backdrop: a capture of the real world, not an object alone."""
        return self.space.kind != "box"

    def march(self, rays: Rays, limit: int, opaque: float, chunks: int) -> Samples:
        """Samples of rays, with density and weights."""
        if self.displacement is None:
            displacement = (_NO_DISPLACEMENT, 0)
        else:
            displacement = (self.displacement.reshape(-1), self.displacement.shape[0])
        return self.density.march(
            self.space, rays, self.occupancy, self.step, displacement, limit, opaque, self.closed, chunks
        )

    @property
    def parameters(self) -> int:
        """Learnable numbers."""
        return len(self.density.values) + sum(len(part.values) for part in layers_of(self.color))

    def describe(self) -> dict:
        """JSON form of everything that is not an array."""
        return {
            "space": self.space.describe(),
            "density": self.density.describe(),
            "color": _described(self.color),
            "step": self.step,
            "cells": self.occupancy.cells,
            "share": self.share,
            "color_map": None
            if self.color_map is None
            else {
                "matrix": self.color_map.matrix.tolist(),
                "offset": self.color_map.offset.tolist(),
            },
        }

    def arrays(self) -> dict[str, np.ndarray]:
        """Named arrays that restore() takes."""
        arrays = {
            "density": self.density.values,
            **_color_arrays(self.color, "color"),
            "occupancy.highest": self.occupancy.highest,
            "occupancy.distances": self.occupancy.distances,
        }
        return arrays if self.displacement is None else arrays | {"displacement": self.displacement}

    @staticmethod
    def restore(data: dict, arrays: dict[str, np.ndarray]) -> "RadianceField":
        """From describe() and arrays(), which may be a stranger's; InvalidValue where they do not make a field."""
        density = validation.entry(data, "density")
        kind = DENSITY_KINDS[validation.one_of(density, "kind", DENSITY_KINDS)]
        return RadianceField(
            SpaceWarp.restore(validation.entry(data, "space")),
            kind.restore(density, _values(arrays, "density")),
            _color(validation.entry(data, "color"), arrays, "color"),
            OccupancyGrid.restore(validation.integer(data, "cells", 1, MOST_CELLS), arrays),
            validation.number(data, "step", LEAST_STEP, 1.0),
            _displacement(arrays),
            _color_map(data.get("color_map")),
            validation.number({"share": 1e-3} | data, "share", 0.0, 1.0),
        )


def layers_of(color) -> list:
    """A color part and what lies under it, where it is a patch over another."""
    return [color, *layers_of(color.base)] if isinstance(color, RegionColor) else [color]


def _described(color) -> dict:
    if not isinstance(color, RegionColor):
        return color.describe()
    return {
        "kind": color.kind,
        "cells": color.cells,
        "own": color.own.describe(),
        "base": _described(color.base),
    }


def _color_arrays(color, name: str) -> dict[str, np.ndarray]:
    arrays = {name: color.values}
    if isinstance(color, RegionColor):
        arrays |= {f"{name}.marked": np.packbits(color.marked.reshape(-1))}
        arrays |= _color_arrays(color.base, f"{name}.base")
    return arrays


def _values(arrays: dict[str, np.ndarray], name: str) -> np.ndarray:
    """What a part has learned; how long it must be the part knows."""
    return validation.array(arrays, name, np.float32, (None,), validation.LEARNED)


def _color(data: dict, arrays: dict[str, np.ndarray], name: str, patches: int = MOST_PATCHES):
    """What _described and _color_arrays tell. patches: how many may lie over one another here."""
    kind = validation.one_of(data, "kind", [*COLOR_KINDS, *([RegionColor.kind] if patches else [])])
    if kind != RegionColor.kind:
        return COLOR_KINDS[kind].restore(data, _values(arrays, name))
    marked = validation.bits(arrays, f"{name}.marked", validation.integer(data, "cells", 1, MOST_CELLS))
    own = HashColor.restore(validation.entry(data, "own"), _values(arrays, name))
    return RegionColor(_color(validation.entry(data, "base"), arrays, f"{name}.base", patches - 1), own, marked)


def _displacement(arrays: dict[str, np.ndarray]) -> np.ndarray | None:
    if "displacement" not in arrays:
        return None
    side = len(arrays["displacement"]) if arrays["displacement"].ndim else 0
    if side < 2:
        raise InvalidValue("the array displacement has no cells")
    return validation.array(arrays, "displacement", np.float32, (side, side, side, 3), most=1.0)  # the whole cube


def _color_map(data: dict | None) -> ColorMap | None:
    if data is None:
        return None
    return ColorMap(
        torch.tensor(validation.rows(data, "matrix", 3, 3)), torch.tensor(validation.numbers(data, "offset", 3))
    )
