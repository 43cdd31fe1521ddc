"""A radiance field: a density part and a color part in a warped space, and an occupancy grid to skip empty space."""

from dataclasses import dataclass

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.blended_color import MOST_BLENDS, MOST_LAYERS, BlendedColor, Layer
from stylerf.fields.color_map import ColorMap
from stylerf.fields.encoded_color import EncodedColor
from stylerf.fields.hash_grid import HashColor, HashDensity
from stylerf.fields.marching import MarchInputs, ScratchArena, displacement_arrays, occupancy_arrays, space_arrays
from stylerf.fields.occupancy_grid import MAX_CELLS, OccupancyGrid
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.protocol import ColorPart, DensityPart, RestorableColor
from stylerf.fields.region_color import MOST_REGIONS, RegionColor
from stylerf.fields.vm import VmColor, VmDensity
from stylerf.fields.voxel import VoxelDensity
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.ray_samples import MarchSettings, Rays, Samples

DENSITY_KINDS: dict[str, type[DensityPart]] = {"vm": VmDensity, "hash": HashDensity, "voxel": VoxelDensity}
COLOR_KINDS: dict[str, type[RestorableColor]] = {
    "vm": VmColor,
    "hash": HashColor,
    "headed": EncodedColor,
    "palette": PaletteColor,
}
MIN_STEP = 1e-5  # cube units; bounds a ray to about 10^5 steps


@dataclass
class RadianceField:
    """A density and a color of any kinds in one warped space.

    Attributes:
        space: warp of world space to the unit cube.
        density, color: see fields/protocol.py.
        occupancy: where samples are taken.
        step: marching step, cube units.
        displacement: [m, m, m, 3] float32 on vertices, cube units, added to every position before density and color are
            evaluated (DeSRF's deformation, baked to a grid); or None.
        color_map: affine map of rendered colors, sRGB (exact color matching after a stylization); or None.
        weight_threshold: fraction of its ray's largest weight that a sample needs to be colored; samples below it get
            the ray's mean color.
    """

    space: SpaceWarp
    density: DensityPart
    color: ColorPart
    occupancy: OccupancyGrid
    step: float
    displacement: np.ndarray | None = None
    color_map: ColorMap | None = None
    weight_threshold: float = 1e-2

    @property
    def opaque_background(self) -> bool:
        """Whether rays end in an opaque background: true for real-world captures, false for isolated objects."""
        return self.space.kind != "box"

    def march(
        self,
        rays: Rays,
        samples_per_ray: int,
        min_transmittance: float,
        threads: int,
        arena: ScratchArena | None = None,
    ) -> Samples:
        """March rays to samples with density and weights.

        Args:
            rays: [rays].
            samples_per_ray: maximum number of samples per ray.
            min_transmittance: transmittance below which a ray terminates.
            threads: partitions of the rays; results are bit-identical for the same number.
            arena: allocates the samples; None: new memory.
        """
        settings = MarchSettings(
            np.float32(self.step), samples_per_ray, np.float32(min_transmittance), self.opaque_background
        )
        grids = occupancy_arrays(self.occupancy), displacement_arrays(self.displacement)
        return self.density.march(rays, MarchInputs(space_arrays(self.space), *grids, settings, threads, arena))

    @property
    def parameters(self) -> int:
        """Number of learnable parameters."""
        return len(self.density.values) + sum(len(part.values) for part in layers_of(self.color))

    def describe(self) -> dict:
        """Return everything that is not an array, as JSON."""
        return {
            "space": self.space.describe(),
            "density": self.density.describe(),
            "color": self.color.describe(),
            "step": self.step,
            "cells": self.occupancy.cells,
            "share": self.weight_threshold,
            "color_map": None if self.color_map is None else self.color_map.describe(),
        }

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the named arrays for restore()."""
        arrays = {
            "density": self.density.values,
            **_color_arrays(self.color, "color"),
            "occupancy.highest": self.occupancy.highest,
            "occupancy.distances": self.occupancy.distances,
        }
        return arrays if self.displacement is None else arrays | {"displacement": self.displacement}

    @staticmethod
    def restore(data: dict, arrays: dict[str, np.ndarray]) -> "RadianceField":
        """Rebuild a field from describe() and arrays(), which may come from an untrusted file.

        Raises:
            InvalidValue: the data do not describe a valid field.
        """
        density = validation.entry(data, "density")
        kind = DENSITY_KINDS[validation.one_of(density, "kind", DENSITY_KINDS)]
        return RadianceField(
            SpaceWarp.restore(validation.entry(data, "space")),
            kind.restore(density, _values(arrays, "density")),
            _any_color(validation.entry(data, "color"), arrays, "color"),
            OccupancyGrid.restore(validation.integer(data, "cells", 1, MAX_CELLS), arrays),
            validation.number(data, "step", MIN_STEP, 1.0),
            _displacement(arrays),
            ColorMap.restore(data.get("color_map")),
            validation.number({"share": 1e-3} | data, "share", 0.0, 1.0),
        )


def layers_of(color: ColorPart) -> list[ColorPart]:
    """Return a color part followed by the bases under it (region colors); for a blend, those of all its layers."""
    if isinstance(color, BlendedColor):
        return [part for layer in color.simple for part in layers_of(layer.color)]
    return [color, *layers_of(color.base)] if isinstance(color, RegionColor) else [color]


def _color_arrays(color: ColorPart, name: str) -> dict[str, np.ndarray]:
    arrays = {name: color.values}
    if isinstance(color, RegionColor):
        arrays |= {f"{name}.marked": np.packbits(color.marked.reshape(-1))}
        arrays |= _color_arrays(color.base, f"{name}.base")
    if isinstance(color, BlendedColor):
        for number, layer in enumerate(color.layers):
            arrays |= _color_arrays(layer.color, f"{name}.{number}")
            if layer.within is not None:
                arrays[f"{name}.{number}.within"] = np.packbits(layer.within.reshape(-1))
    return arrays


def _values(arrays: dict[str, np.ndarray], name: str) -> np.ndarray:
    """Return a part's learned values; the part itself checks their count."""
    return validation.array(arrays, name, np.float32, (None,), validation.LEARNED)


def _any_color(data: dict, arrays: dict[str, np.ndarray], name: str, blends: int = MOST_BLENDS) -> ColorPart:
    """Rebuild a color from describe() and _color_arrays(). blends: how many may still be nested."""
    if not (blends and isinstance(data, dict) and data.get("kind") == BlendedColor.kind):
        return _color(data, arrays, name)
    layers = validation.entry(data, "layers", list)
    if len(layers) > MOST_LAYERS:
        raise InvalidValue(f"a blend has {len(layers)} layers; at most {MOST_LAYERS} are supported")
    return BlendedColor([_layer(one, arrays, f"{name}.{number}", blends - 1) for number, one in enumerate(layers)])


def _layer(data: dict, arrays: dict[str, np.ndarray], name: str, blends: int) -> Layer:
    cells = validation.integer(data, "cells", 0, MAX_CELLS)
    return Layer(
        _any_color(validation.entry(data, "color"), arrays, name, blends),
        ColorMap.restore(validation.entry(data, "color_map")),
        validation.number(data, "share", 0.0, 1.0),
        validation.number(data, "weight", 0.0, 1.0),
        validation.bits(arrays, f"{name}.within", cells) if cells else None,
    )


def _color(data: dict, arrays: dict[str, np.ndarray], name: str, regions: int = MOST_REGIONS) -> ColorPart:
    """Rebuild a color that is not a blend. regions: how many may still be nested."""
    kind = validation.one_of(data, "kind", [*COLOR_KINDS, *([RegionColor.kind] if regions else [])])
    if kind != RegionColor.kind:
        return COLOR_KINDS[kind].restore(data, _values(arrays, name))
    marked = validation.bits(arrays, f"{name}.marked", validation.integer(data, "cells", 1, MAX_CELLS))
    own = HashColor.restore(validation.entry(data, "own"), _values(arrays, name))
    return RegionColor(_color(validation.entry(data, "base"), arrays, f"{name}.base", regions - 1), own, marked)


def _displacement(arrays: dict[str, np.ndarray]) -> np.ndarray | None:
    if "displacement" not in arrays:
        return None
    side = len(arrays["displacement"]) if arrays["displacement"].ndim else 0
    if side < 2:
        raise InvalidValue("the array displacement has no cells")
    return validation.array(arrays, "displacement", np.float32, (side, side, side, 3), most=1.0)  # up to the whole cube
