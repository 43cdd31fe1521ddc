"""Fields between stylizations: one of given strength, or a mix of several made from the same field."""

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
        name: for messages.
        field: of the source's density.
        weight: 0..1.
        within: [s, s, s] bool, cells of the cube that it is limited to; None: everywhere.
    """

    name: str
    field: RadianceField
    weight: float
    within: np.ndarray | None = None


def blended(source: RadianceField, styles: Sequence[Style]) -> RadianceField:
    """Mix fields made from `source`: colors at every sample, displacements at every vertex.

    Styles without cells are mixed by their weights, and what these leave of 1 is the source's; each style with cells is
    laid over that in its region.

    Args:
        source: the field that all were made from.
        styles: in any order; of two regions that overlap, the later one is on top.

    Returns:
        A field whose color is a BlendedColor, marched in the longest of their steps (a deforming field's can be longer
        than its source's). It shares the arrays of the others.

    Raises:
        InvalidValue: a style has another density, or a displacement grid of another size; the weights add up to more
            than 1; there are too many layers.
    """
    for style in styles:
        if why := difference(source, style.field):
            raise InvalidValue(f"{style.name} cannot be blended: {why}")
    everywhere = [style for style in styles if style.within is None]
    if (total := sum(style.weight for style in everywhere)) > 1 + ROUNDING:
        raise InvalidValue(f"the weights add up to {total:g}, and 1 is the most")
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
    """Return the field between `source` (strength 0) and `stylized` (1), which themselves are the ends.

    Raises:
        InvalidValue: the two have different densities.
    """
    between = blended(source, [Style("the field", stylized, strength)])  # refuses other densities at the ends too
    return source if strength == 0 else stylized if strength == 1 else between


def difference(source: RadianceField, field: RadianceField) -> str:
    """Return why two fields do not hold the same things in the same places, empty if they do."""
    if field.space != source.space or field.density.describe() != source.density.describe():
        return "its density is of another kind or size"
    if not np.array_equal(field.density.values, source.density.values):
        return "its density was trained further"
    return ""


def _layer(style: Style) -> Layer:
    field = style.field
    return Layer(field.color, field.color_map, field.weight_threshold, style.weight, style.within)


def _displacement(stacked: Sequence[Style]) -> np.ndarray | None:
    """Return the mixed displacement [m, m, m, 3], None if nothing is displaced.

    A vertex counts to a region by its displaced position, as samples do.
    """
    grids = [style.field.displacement for style in stacked if style.field.displacement is not None]
    if not grids:
        return None
    if len({grid.shape for grid in grids}) > 1:
        sizes = " and ".join(sorted({str(len(grid)) for grid in grids}))
        raise InvalidValue(f"displacement grids of {sizes} vertices per side cannot be mixed; deform with the same")
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
    """Return [..., 1] bool: whether cube points [..., 3] lie in marked cells; outside the cube, its border counts."""
    cell = np.clip((x * np.float32(len(within))).astype(np.int64), 0, len(within) - 1)
    return within[cell[..., 0], cell[..., 1], cell[..., 2]][..., None]


def _occupancy(source: RadianceField, displacement: np.ndarray | None, step: float) -> OccupancyGrid:
    """Return the occupancy of the source's density under another displacement, for a marching step (cube units)."""
    rest, own = source.occupancy, source.displacement
    same = displacement is own or (displacement is not None and own is not None and np.array_equal(displacement, own))
    if same and step == source.step:
        return rest
    if own is not None or step != source.step:  # a displaced grid marks cells that displacement maps to something
        rest = OccupancyGrid(rest.cells, rest.highest)
        rest.decide(step)
    return rest if displacement is None else displaced_occupancy(rest, displacement)
