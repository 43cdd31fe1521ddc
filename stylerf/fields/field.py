"""A radiance field: a density part and a colour part over a warped space, with the occupancy that guides rays."""

from dataclasses import dataclass, field

import numpy as np

from stylerf.fields.occupancy import Occupancy
from stylerf.fields.vm import VmColour, VmDensity
from stylerf.geometry.space import Space

DENSITY_KINDS = {"vm": VmDensity}
COLOUR_KINDS = {"vm": VmColour}


@dataclass
class RadianceField:
    """density and colour may be of different kinds. step: marching step in cube units. background: rgb or None."""

    space: Space
    density: VmDensity
    colour: VmColour
    occupancy: Occupancy
    step: float
    near: float = 0.0
    notes: dict = field(default_factory=dict)

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
