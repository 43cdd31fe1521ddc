"""Options of `stylerf stylize --region`: how a look is learned, and changes to its palette."""

from dataclasses import dataclass, fields

from stages.configs.edit import EditConfig, PaletteConfig


@dataclass(frozen=True)
class RegionConfig(PaletteConfig, EditConfig):
    """Both in one command. They are two stages, so that changing a palette needs no training."""

    def __post_init__(self) -> None:
        EditConfig.__post_init__(self)
        PaletteConfig.__post_init__(self)

    @property
    def learning(self) -> EditConfig:
        """How the look is learned."""
        return EditConfig(**{item.name: getattr(self, item.name) for item in fields(EditConfig)})

    @property
    def changes(self) -> PaletteConfig:
        """Changes to the palette."""
        return PaletteConfig(**{item.name: getattr(self, item.name) for item in fields(PaletteConfig)})
