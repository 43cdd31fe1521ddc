"""Options of `stylerf extract`."""

from dataclasses import dataclass

from stages.configs import option


@dataclass(frozen=True)
class ExtractConfig:
    """What of a region the views give to its edit."""

    tolerance: float = option(0.5, help="opacity of a pixel that may lie outside the region (LAENeRF: 0.5 to 0.85)")
    transition: float = option(
        -1.0, help="width over which an edit fades towards what surrounds the region, scene units (-1: a 40th of it)"
    )
    exr: bool = option(True, help="also write what each view shows as OpenEXR")

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1 or (self.transition < 0 and self.transition != -1):
            raise ValueError("tolerance must be over 0 and under 1, transition at least 0 (or -1)")
