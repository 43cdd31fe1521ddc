"""Options of `stylerf stylize --region`: how a look is learned, and what is changed of its palette."""

from dataclasses import dataclass, fields

from stages.configs.edit import EditConfig, PaletteConfig


@dataclass(frozen=True)
class RegionConfig(PaletteConfig, EditConfig):
    """Both in one command; two stages, so that a changed palette needs no training."""

    def __post_init__(self) -> None:
        EditConfig.__post_init__(self)
        PaletteConfig.__post_init__(self)

    @property
    def learning(self) -> EditConfig:
        """How the look is learned."""
        return EditConfig(**{item.name: getattr(self, item.name) for item in fields(EditConfig)})

    @property
    def changes(self) -> PaletteConfig:
        """What is changed of the palette."""
        return PaletteConfig(**{item.name: getattr(self, item.name) for item in fields(PaletteConfig)})
