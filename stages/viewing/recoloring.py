"""Immediate recoloring: the palettes of a work folder, and the field that shows changes of one."""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from schemas.work_folder import Artifact
from stages.artifacts.edit import Edit, by_column, changes_of, columns_and_shares, palette_entries
from stages.configs.edit import PaletteConfig
from stylerf.editing.edit_grid import Region
from stylerf.editing.edited_color import EditedColor
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.palette_edits import PaletteEdits, Recoloring
from stylerf.fields.protocol import ColorPart
from stylerf.fields.radiance_field import RadianceField


@dataclass(frozen=True)
class Swatch:
    """A palette color as the page shows it. now: #rrggbb. share: of the region or scene, 0..1."""

    index: int
    name: str
    now: str
    share: float


def swatches(artifact: Artifact) -> list[Swatch]:
    """Return the palette of a field or an edit, the largest share first."""
    return [Swatch(one["index"], one["name"], one["now"], float(one["share"])) for one in palette_entries(artifact)]


def field_changes(artifact: Artifact, color: ColorPart, config: PaletteConfig) -> PaletteEdits:
    """Return a config's changes of a decomposed field, by the field's color numbers."""
    assert isinstance(color, PaletteColor)
    columns, shares = columns_and_shares(artifact, color.bases)
    changes = changes_of(config, color.present_palette[columns], np.array(shares)[columns])
    changes.check(len(columns))
    return by_column(changes, columns)


def recolored_field(of: RadianceField, changes: PaletteEdits) -> RadianceField:
    """Return a decomposed field with changes of its palette; density and everything else are shared."""
    assert isinstance(of.color, PaletteColor)
    return replace(of, color=of.color.edited(Recoloring(changes))) if changes else of


def edit_changes(artifact: Artifact, edit: Edit, config: PaletteConfig) -> PaletteEdits:
    """Return a config's changes of a region's palette, by the module's color numbers."""
    palette = edit.module.palette
    columns, shares = columns_and_shares(artifact, len(palette))
    changes = changes_of(config, palette[columns], np.array(shares)[columns])
    changes.check(len(columns))
    return by_column(changes, columns)


def edited_field(of: RadianceField, edit: Edit, region: Region, changes: PaletteEdits) -> RadianceField:
    """Return the field as it looks with a region's edit, before any field is trained on that."""
    color = cast(ColorPart, EditedColor(of.color, edit.module, region.edit, changes))  # all that rendering needs of it
    return replace(of, color=color)
