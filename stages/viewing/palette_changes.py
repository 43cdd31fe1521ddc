"""Palette changes made on the page, as options of `stylerf stylize`."""

from dataclasses import dataclass, field, fields
from typing import Any, get_type_hints

from schemas.canonical_json import plain
from schemas.errors import ArtifactDamaged, UsageError
from schemas.work_folder import Artifact
from stages.configs import default_of, options_of
from stages.configs.edit import EditConfig, PaletteConfig, RegionConfig
from stages.configs.typed import typed


@dataclass(frozen=True)
class Changes:
    """Palette changes by index: #rrggbb, factor and offset of the weight."""

    colors: dict[int, str] = field(default_factory=dict)
    weights: dict[int, float] = field(default_factory=dict)
    biases: dict[int, float] = field(default_factory=dict)

    def config(self) -> PaletteConfig:
        """Return the options that make these changes."""
        return PaletteConfig(
            tuple(f"{index}={color}" for index, color in sorted(self.colors.items())),
            tuple(f"{index}={value:g}" for index, value in sorted(self.weights.items()) if value != 1),
            tuple(f"{index}={value:g}" for index, value in sorted(self.biases.items()) if value != 0),
        )


def learned_with(edit: Artifact, changes: PaletteConfig) -> RegionConfig:
    """Return the options with which an edit was learned, with other changes of its palette.

    Raises:
        ArtifactDamaged: its manifest contains unknown options.
    """
    made, kinds = edit.manifest.config, get_type_hints(EditConfig)
    given: dict[str, Any] = {item.name: getattr(changes, item.name) for item in fields(PaletteConfig)}
    try:
        for item in options_of(EditConfig):
            if item.name in made and made[item.name] != plain(default_of(item)):
                given[item.name] = typed(made[item.name], item, kinds[item.name], item.name)
        return RegionConfig(**given)
    except (UsageError, ValueError, OverflowError) as error:
        raise ArtifactDamaged(f"the manifest of {edit.path} has unknown options: {error}; rebuild it") from error
