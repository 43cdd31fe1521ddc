"""Options of `stylerf distill`."""

from dataclasses import dataclass

from stages.configs import option


@dataclass(frozen=True)
class DistillConfig:
    """How an edit is written into the photos."""

    fade: bool = option(True, help="fade palette changes towards the region's surroundings")
    min_opacity: float = option(0.5, help="opacity of the region from which a pixel is edited")

    def __post_init__(self) -> None:
        if not 0 < self.min_opacity < 1:
            raise ValueError("min_opacity must be between 0 and 1")
