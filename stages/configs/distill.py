"""Options of `stylerf distill`."""

from dataclasses import dataclass

from stages.configs import option


@dataclass(frozen=True)
class DistillConfig:
    """How an edit is written into the photos."""

    fade: bool = option(True, help="fade changes of the palette towards what surrounds the region")
    least: float = option(0.5, help="opacity of a pixel from which it is edited")

    def __post_init__(self) -> None:
        if not 0 < self.least < 1:
            raise ValueError("least must be over 0 and under 1")
