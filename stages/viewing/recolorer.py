"""Recoloring: the open palette, its changes, and the commands that save them."""

from dataclasses import replace
from typing import TYPE_CHECKING

from schemas.errors import BadInput, UsageError
from schemas.work_folder import Artifact, valid_name
from stages.configs.decompose import PaletteFieldConfig
from stages.viewing.commands import command
from stages.viewing.display import Display
from stages.viewing.palette_changes import Changes, learned_with
from stages.viewing.shown import Source
from stylerf.fields.blended_color import BlendedColor

if TYPE_CHECKING:  # imports torch, which must not delay the first picture
    from stages.artifacts.edit import Edit
    from stages.viewing.recoloring import Swatch
    from stylerf.editing.edit_grid import Region

EDIT_MARK = "edit "  # precedes the name of a region's palette in lists of what can be recolored


class Recolorer:
    """Changes a palette and shows the result.

    Attributes:
        palette: Name of what is recolored: a field, or EDIT_MARK and an edit; empty: nothing.
        changes: Of its colors.
    """

    def __init__(self, display: Display) -> None:
        self._display, self._library = display, display.library
        self.palette, self.changes = "", Changes()
        self._edits: dict[tuple[str, str], tuple[Edit, Region]] = {}  # the last one, by the digests
        display.recolored = self.recolored

    def palettes(self) -> list[str]:
        """Return what can be recolored: decomposed fields, and regions' palettes with EDIT_MARK before their names."""
        return [*self._library.palettes(), *(EDIT_MARK + name for name in self._library.edits())]

    def open(self, name: str) -> None:
        """Choose what is recolored (empty: nothing), without changes."""
        with self._display.lock:
            self.palette, self.changes = name, Changes()
            self._display.look(field=name if name and not name.startswith(EDIT_MARK) else None)

    def swatches(self) -> "list[Swatch]":
        """Return the colors of what is recolored as they are stored, the largest share first."""
        from stages.viewing.recoloring import swatches

        return swatches(self._artifact()) if self.palette else []

    def reset(self) -> None:
        """Undo all changes."""
        self.open(self.palette)

    def change(self, index: int, color: str = "", weight: float | None = None, bias: float | None = None) -> None:
        """Change a palette color: its color (#rrggbb), the factor and the offset of its weight."""
        with self._display.lock:
            new = self.changes
            if color:
                new = replace(new, colors={**new.colors, index: color})
            if weight is not None:
                new = replace(new, weights={**new.weights, index: weight})
            if bias is not None:
                new = replace(new, biases={**new.biases, index: bias})
            new.config()
            self.changes = new
            self._display.refresh()

    def recolored(self, source: Source) -> Source:
        """Return a source with the palette's changes, if they apply to it."""
        if not self.palette:
            return source
        from stages.viewing.recoloring import edit_changes, edited_field, field_changes, recolored_field

        artifact, config = self._artifact(), self.changes.config()
        if self.palette.startswith(EDIT_MARK):
            if isinstance(source.field.color, BlendedColor):
                raise BadInput(f"an edit cannot be previewed on field {source.name}, a blend; show another field")
            edit, region = self._loaded(artifact)
            changes = edit_changes(artifact, edit, config)
            return replace(source, field=edited_field(source.field, edit, region, changes))
        if artifact.name != source.name:
            return source
        field = recolored_field(source.field, field_changes(artifact, source.field.color, config))
        return replace(source, field=field)

    def _loaded(self, artifact: Artifact) -> "tuple[Edit, Region]":
        """Return an edit and its region; the last ones are cached, so that a slider does not reread them."""
        from stages.artifacts.edit import load_edit

        region = self._library.region_of_edit(artifact)
        if region is None:
            raise BadInput(f"the region of edit {artifact.name} no longer exists; select it again")
        key = artifact.digest, region.digest
        if key not in self._edits:
            self._edits = {key: (load_edit(artifact), self._library.region(region.name))}
        return self._edits[key]

    def command(self, name: str = "") -> list[str]:
        """Return the command that saves the changes.

        Raises:
            UsageError: nothing was changed.
        """
        config = self.changes.config()
        if not self.palette or not config:
            raise UsageError("no palette color was changed")
        root, named = self._library.work.root, name and valid_name(name)
        if self.palette.startswith(EDIT_MARK):
            artifact = self._artifact()
            region = self._library.region_of_edit(artifact)
            if region is None:
                raise UsageError(f"the region of edit {artifact.name} no longer exists; select it again")
            learned = learned_with(artifact, config)
            return command("stylize", root, learned, region=region.name, name=named)
        merged = PaletteFieldConfig(
            palette=config.palette, palette_weight=config.palette_weight, palette_bias=config.palette_bias
        )
        return command("stylize", root, merged, of=self.palette, name=named, method="palettenerf")

    def decompose_command(self) -> list[str]:
        """Return the command that learns a palette of the shown field."""
        return command("stylize", self._library.work.root, None, of=self._display.field, method="palettenerf")

    def _artifact(self) -> Artifact:
        edit = self.palette.startswith(EDIT_MARK)
        return self._library.work.get("edit" if edit else "field", self.palette.removeprefix(EDIT_MARK))
