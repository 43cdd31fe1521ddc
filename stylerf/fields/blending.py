"""Interpolate between a field and its stylization, or blend several stylizations of the same field."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.blended_color import ROUNDING, BlendedColor, Layer
from stylerf.fields.deformation import displaced_occupancy
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField


@dataclass(frozen=True, eq=False)
class Style:
    """A field to blend.

    Attributes:
        name: used in messages.
        field: shares the source's density.
        weight: 0..1.
        within: [s, s, s] bool, cells of the cube that the style is limited to; None: everywhere.
    """

    name: str
    field: RadianceField
    weight: float
    within: np.ndarray | None = None


def blended(source: RadianceField, styles: Sequence[Style]) -> RadianceField:
    """Blend fields made from `source`: colors per sample, displacements per vertex.

    Styles without cells are mixed by their weights, and the source gets the rest up to 1. Each style with cells is then
    composited over that in its region.

    Args:
        source: the field that all styles were made from.
        styles: in any order; where two regions overlap, the later style is on top.

    Returns:
        A field whose color is a BlendedColor, marched with the largest of their steps (a deforming field's can be
        larger than its source's). It shares their arrays.

    Raises:
        InvalidValue: a style has a different density or a displacement grid of a different size, the weights add up to
            more than 1, or there are too many layers.
    """
    for style in styles:
        if why := difference(source, style.field):
            raise InvalidValue(f"{style.name} cannot be blended: {why}")
    everywhere = [style for style in styles if style.within is None]
    if (total := sum(style.weight for style in everywhere)) > 1 + ROUNDING:
        raise InvalidValue(f"the weights add up to {total:g}; they may add up to at most 1")
    rest = [Style("", source, 1 - total)] if total < 1 - ROUNDING else []
    stacked = [*rest, *everywhere, *(style for style in styles if style.within is not None)]
    displacement = _displacement(stacked)
    step = max(source.step, *(style.field.step for style in styles))
    return replace(
        source,
        color=BlendedColor([_layer(style) for style in stacked]),
        occupancy=_occupancy(source, displacement, step),
        step=step,
        displacement=displacement,
        color_map=None,
    )


def at_strength(source: RadianceField, stylized: RadianceField, strength: float) -> RadianceField:
    """Interpolate from `source` (strength 0) to `stylized` (1); at either end that field itself is returned.

    Raises:
        InvalidValue: the fields have different densities.
    """
    between = blended(source, [Style("the field", stylized, strength)])  # also checks the densities at either end
    return source if strength == 0 else stylized if strength == 1 else between


def difference(source: RadianceField, field: RadianceField) -> str:
    """Return why two fields do not share the same density, or an empty string if they do."""
    if field.space != source.space or field.density.describe() != source.density.describe():
        return "its density is of another kind or size"
    if not np.array_equal(field.density.values, source.density.values):
        return "its density was trained further"
    return ""


def _layer(style: Style) -> Layer:
    field = style.field
    return Layer(field.color, field.color_map, field.weight_threshold, style.weight, style.within)


def _displacement(stacked: Sequence[Style]) -> np.ndarray | None:
    """Return the blended displacement [m, m, m, 3], or None if no field is displaced.

    A vertex belongs to a region if its displaced position does, as for samples.
    """
    grids = [style.field.displacement for style in stacked if style.field.displacement is not None]
    if not grids:
        return None
    if len({grid.shape for grid in grids}) > 1:
        sizes = " and ".join(sorted({str(len(grid)) for grid in grids}))
        raise InvalidValue(f"displacement grids of {sizes} vertices per side cannot be blended; use one grid size")
    if len(grids) == len(stacked) and all(np.array_equal(grid, grids[0]) for grid in grids):
        return grids[0]
    at = np.linspace(0, 1, len(grids[0]), dtype=np.float32)
    vertices = np.stack(np.meshgrid(at, at, at, indexing="ij"), -1)
    mixed = np.zeros_like(grids[0])
    for style in stacked:
        own = np.zeros_like(mixed) if style.field.displacement is None else style.field.displacement
        if style.within is None:
            mixed = mixed + np.float32(style.weight) * own
        else:
            share = np.float32(style.weight) * _inside(style.within, vertices + own)
            mixed = (1 - share) * mixed + share * own
    return mixed


def _inside(within: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return [..., 1] bool: whether cube points [..., 3], clamped to the cube, are in marked cells."""
    cell = np.clip((x * np.float32(len(within))).astype(np.int64), 0, len(within) - 1)
    return within[cell[..., 0], cell[..., 1], cell[..., 2]][..., None]


def _occupancy(source: RadianceField, displacement: np.ndarray | None, step: float) -> OccupancyGrid:
    """Return the occupancy of the source's density under a different displacement, for a marching step (cube units)."""
    rest, own = source.occupancy, source.displacement
    same = displacement is own or (displacement is not None and own is not None and np.array_equal(displacement, own))
    if same and step == source.step:
        return rest
    if own is not None or step != source.step:  # a displaced grid marks the cells that displacement maps to matter
        rest = OccupancyGrid(rest.cells, rest.highest)
        rest.decide(step)
    return rest if displacement is None else displaced_occupancy(rest, displacement)
