"""A radiance field: a density part and a colour part over a warped space, with the occupancy that guides rays."""

from dataclasses import dataclass

import numpy as np

from stylerf.fields.occupancy import Occupancy
from stylerf.fields.samples import Rays, Samples
from stylerf.fields.vm import VmColour, VmDensity
from stylerf.geometry.space import Space

DENSITY_KINDS = {"vm": VmDensity}
COLOUR_KINDS = {"vm": VmColour}
_NO_DISPLACEMENT = np.empty(0, np.float32)


@dataclass
class RadianceField:
    """density and colour may be of different kinds. step: marching step in cube units.

    displacement: [m, m, m, 3] float32 on vertices, cube units, added to every position before density and colour are
    asked (DeSRF's deformation, as a grid), or None.
    """

    space: Space
    density: VmDensity
    colour: VmColour
    occupancy: Occupancy
    step: float
    displacement: np.ndarray | None = None

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
        return self.density.march(self.space, rays, self.occupancy, self.step, displacement, limit, opaque, self.closed, chunks)

    @property
    def parameters(self) -> int:
        """Learnable numbers."""
        return len(self.density.values) + len(self.colour.values)

    def describe(self) -> dict:
        """JSON form of everything that is not an array."""
        return {
            "space": self.space.describe(), "density": self.density.describe(), "colour": self.colour.describe(),
            "step": self.step, "cells": self.occupancy.cells,
        }

    def arrays(self) -> dict[str, np.ndarray]:
        """Named arrays that restore() takes."""
        return {
            "density": self.density.values, "colour": self.colour.values,
            "occupancy.highest": self.occupancy.highest, "occupancy.distances": self.occupancy.distances,
        }

    @staticmethod
    def restore(data: dict, arrays: dict[str, np.ndarray]) -> "RadianceField":
        """From describe() and arrays()."""
        occupancy = Occupancy(data["cells"], arrays["occupancy.highest"])
        occupancy.distances = arrays["occupancy.distances"]
        return RadianceField(
            Space.restore(data["space"]),
            DENSITY_KINDS[data["density"]["kind"]].restore(data["density"], arrays["density"]),
            COLOUR_KINDS[data["colour"]["kind"]].restore(data["colour"], arrays["colour"]),
            occupancy, data["step"],
        )
