"""Options of `stylerf edit`: those of select, of learning a region's look, and of its palette."""

from dataclasses import dataclass, fields

from stages.configs.region import RegionConfig
from stages.configs.select import SelectConfig


@dataclass(frozen=True)
class WholeEditConfig(RegionConfig, SelectConfig):
    """What is selected and what becomes of it. Later stages take their options from the --config file."""

    def __post_init__(self) -> None:
        SelectConfig.__post_init__(self)
        RegionConfig.__post_init__(self)

    @property
    def selection(self) -> SelectConfig:
        """What is selected."""
        return SelectConfig(**{item.name: getattr(self, item.name) for item in fields(SelectConfig)})

    @property
    def look(self) -> RegionConfig:
        """What becomes of it."""
        return RegionConfig(**{item.name: getattr(self, item.name) for item in fields(RegionConfig)})
