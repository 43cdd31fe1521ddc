"""What was changed of a palette on the page, as options of `stylerf stylize`."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from stages.configs import options_of
from stages.configs.edit import EditConfig, PaletteConfig, RegionConfig


@dataclass(frozen=True)
class Changes:
    """What was changed of a palette, by index: #rrggbb, factor and summand of the weight."""

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


def learned_with(made: Mapping[str, Any], changes: PaletteConfig) -> RegionConfig:
    """Return the options under which an edit was learned, with other changes of its palette.

    Args:
        made: the config in the edit's manifest.
    """
    given: dict[str, Any] = {item.name: made[item.name] for item in options_of(EditConfig) if item.name in made}
    given = {name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
    given |= {item.name: getattr(changes, item.name) for item in fields(PaletteConfig)}
    return RegionConfig(**given)
