"""What was changed of a palette on the page, as options of `stylerf stylize`."""

from dataclasses import dataclass, field

from stages.configs.edit import PaletteConfig


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
