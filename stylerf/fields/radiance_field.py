"""A radiance field: a density part and a colour part over a warped space, with the occupancy that guides rays."""

from dataclasses import dataclass

import numpy as np
import torch

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.encoded_color import HeadedColour
from stylerf.fields.hash_color import HashColour
from stylerf.fields.hash_density import HashDensity
from stylerf.fields.occupancy_grid import MOST_CELLS, Occupancy
from stylerf.fields.palette_color import PaletteColour
from stylerf.fields.protocol import ColourPart, DensityPart
from stylerf.fields.ray_samples import Rays, Samples
from stylerf.fields.region_color import PatchColour
from stylerf.fields.vm import VmColour, VmDensity
from stylerf.fields.voxel import VoxelDensity
from stylerf.geometry.space_warp import Space
from stylerf.style.color_matching import ColourMap

DENSITY_KINDS = {"vm": VmDensity, "hash": HashDensity, "voxel": VoxelDensity}
COLOUR_KINDS = {"vm": VmColour, "hash": HashColour, "headed": HeadedColour, "palette": PaletteColour}
LEAST_STEP = 1e-5  # cube units: a ray takes no more than 10^5 steps
MOST_PATCHES = 100  # over one another
_NO_DISPLACEMENT = np.empty(0, np.float32)


@dataclass
class RadianceField:
    """density and colour may be of different kinds. step: marching step in cube units.

    displacement: [m, m, m, 3] float32 on vertices, cube units, added to every position before density and colour are
    asked (DeSRF's deformation, as a grid), or None. colour_map: affine map of the rendered colours (exact colour
    matching after a stylisation), or None. share: part of its ray's largest weight that a sample must have to be
    coloured; what lies below takes the ray's mean.
    """

    space: Space
    density: DensityPart
    colour: ColourPart
    occupancy: Occupancy
    step: float
    displacement: np.ndarray | None = None
    colour_map: ColourMap | None = None
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
        return len(self.density.values) + sum(len(part.values) for part in layers_of(self.colour))

    def describe(self) -> dict:
        """JSON form of everything that is not an array."""
        return {
            "space": self.space.describe(),
            "density": self.density.describe(),
            "colour": _described(self.colour),
            "step": self.step,
            "cells": self.occupancy.cells,
            "share": self.share,
            "colour_map": None
            if self.colour_map is None
            else {
                "matrix": self.colour_map.matrix.tolist(),
                "offset": self.colour_map.offset.tolist(),
            },
        }

    def arrays(self) -> dict[str, np.ndarray]:
        """Named arrays that restore() takes."""
        arrays = {
            "density": self.density.values,
            **_colour_arrays(self.colour, "colour"),
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
            Space.restore(validation.entry(data, "space")),
            kind.restore(density, _values(arrays, "density")),
            _colour(validation.entry(data, "colour"), arrays, "colour"),
            Occupancy.restore(validation.integer(data, "cells", 1, MOST_CELLS), arrays),
            validation.number(data, "step", LEAST_STEP, 1.0),
            _displacement(arrays),
            _colour_map(data.get("colour_map")),
            validation.number({"share": 1e-3} | data, "share", 0.0, 1.0),
        )


def layers_of(colour) -> list:
    """A colour part and what lies under it, where it is a patch over another."""
    return [colour, *layers_of(colour.base)] if isinstance(colour, PatchColour) else [colour]


def _described(colour) -> dict:
    if not isinstance(colour, PatchColour):
        return colour.describe()
    return {
        "kind": colour.kind,
        "cells": colour.cells,
        "own": colour.own.describe(),
        "base": _described(colour.base),
    }


def _colour_arrays(colour, name: str) -> dict[str, np.ndarray]:
    arrays = {name: colour.values}
    if isinstance(colour, PatchColour):
        arrays |= {f"{name}.marked": np.packbits(colour.marked.reshape(-1))}
        arrays |= _colour_arrays(colour.base, f"{name}.base")
    return arrays


def _values(arrays: dict[str, np.ndarray], name: str) -> np.ndarray:
    """What a part has learnt; how long it must be the part knows."""
    return validation.array(arrays, name, np.float32, (None,), validation.LEARNT)


def _colour(data: dict, arrays: dict[str, np.ndarray], name: str, patches: int = MOST_PATCHES):
    """What _described and _colour_arrays tell. patches: how many may lie over one another here."""
    kind = validation.one_of(data, "kind", [*COLOUR_KINDS, *([PatchColour.kind] if patches else [])])
    if kind != PatchColour.kind:
        return COLOUR_KINDS[kind].restore(data, _values(arrays, name))
    marked = validation.bits(arrays, f"{name}.marked", validation.integer(data, "cells", 1, MOST_CELLS))
    own = HashColour.restore(validation.entry(data, "own"), _values(arrays, name))
    return PatchColour(_colour(validation.entry(data, "base"), arrays, f"{name}.base", patches - 1), own, marked)


def _displacement(arrays: dict[str, np.ndarray]) -> np.ndarray | None:
    if "displacement" not in arrays:
        return None
    side = len(arrays["displacement"]) if arrays["displacement"].ndim else 0
    if side < 2:
        raise InvalidValue("the array displacement has no cells")
    return validation.array(arrays, "displacement", np.float32, (side, side, side, 3), most=1.0)  # the whole cube


def _colour_map(data: dict | None) -> ColourMap | None:
    if data is None:
        return None
    return ColourMap(torch.tensor(validation.rows(data, "matrix", 3, 3)), torch.tensor(validation.numbers(data, "offset", 3)))
