"""A radiance field: a density part and a colour part over a warped space, with the occupancy that guides rays."""

from dataclasses import dataclass

import numpy as np
import torch

from stylerf.fields.hash import HashColour
from stylerf.fields.hash_density import HashDensity
from stylerf.fields.headed import HeadedColour
from stylerf.fields.occupancy import Occupancy
from stylerf.fields.palette import PaletteColour
from stylerf.fields.patch import PatchColour
from stylerf.fields.protocol import ColourPart, DensityPart
from stylerf.fields.samples import Rays, Samples
from stylerf.fields.vm import VmColour, VmDensity
from stylerf.fields.voxel import VoxelDensity
from stylerf.geometry.space import Space
from stylerf.style.colour import ColourMap

DENSITY_KINDS = {"vm": VmDensity, "hash": HashDensity, "voxel": VoxelDensity}
COLOUR_KINDS = {"vm": VmColour, "hash": HashColour, "headed": HeadedColour, "palette": PaletteColour}
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
        """From describe() and arrays()."""
        occupancy = Occupancy(data["cells"], arrays["occupancy.highest"])
        occupancy.distances = arrays["occupancy.distances"]
        return RadianceField(
            Space.restore(data["space"]),
            DENSITY_KINDS[data["density"]["kind"]].restore(data["density"], arrays["density"]),
            _colour(data["colour"], arrays, "colour"),
            occupancy,
            data["step"],
            arrays.get("displacement"),
            _colour_map(data.get("colour_map")),
            data.get("share", 1e-3),
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


def _colour(data: dict, arrays: dict[str, np.ndarray], name: str):
    """What _described and _colour_arrays tell."""
    if data["kind"] != PatchColour.kind:
        return COLOUR_KINDS[data["kind"]].restore(data, arrays[name])
    cells = data["cells"]
    marked = np.unpackbits(arrays[f"{name}.marked"], count=cells**3).astype(bool).reshape((cells,) * 3)
    own = HashColour.restore(data["own"], arrays[name])
    return PatchColour(_colour(data["base"], arrays, f"{name}.base"), own, marked)


def _colour_map(data: dict | None) -> ColourMap | None:
    return None if data is None else ColourMap(torch.tensor(data["matrix"]), torch.tensor(data["offset"]))
