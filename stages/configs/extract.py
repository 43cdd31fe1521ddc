"""Options of `stylerf extract`."""

from dataclasses import dataclass

from stages.configs import option


@dataclass(frozen=True)
class ExtractConfig:
    """What the training views show of a region, for its edit."""

    tolerance: float = option(0.5, help="opacity that may lie outside the region (LAENeRF: 0.5 to 0.85)")
    transition: float = option(-1.0, help="width over which an edit fades out, scene units (-1: a 40th of the region)")
    exr: bool = option(True, help="also write OpenEXR images")

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1 or (self.transition < 0 and self.transition != -1):
            raise ValueError("tolerance must be between 0 and 1, transition at least 0 (or -1)")
