"""Options of `stylerf deform`."""

from dataclasses import dataclass

from stages.configs import advanced, option


@dataclass(frozen=True)
class DeformConfig:
    """How the deformation of a fitted field is initialized (DeSRF)."""

    steps: int = option(2000, help="maximum number of steps; stops earlier once the PSNR stops rising")
    rays: int = option(1024, help="random rays per step")
    rate: float = option(1e-3, help="learning rate of the deformation network")
    smoothness: float = option(1.0, help="weight of the displacement's total variation")
    patience_db: float = option(0.02, help="PSNR gain, dB, needed every 200 steps to continue (0: run all steps)")
    gate: float = option(
        0.0, help="drop the deformation unless held-out training views gain this many dB (0: no check)"
    )
    vertices: int = advanced(32, "network", help="vertices per side of the displacement grid")
    width: int = advanced(256, "network", help="width of the network's two hidden layers")
    frequencies: int = advanced(5, "network", help="octaves of the positional encoding")
    checkpoint_every_seconds: float = advanced(20.0, help="time between checkpoints", incidental=True)

    def __post_init__(self) -> None:
        if self.gate < 0:
            raise ValueError("gate must not be negative")
        if not (self.steps >= 0 and 16 <= self.rays <= 65536 and self.rate > 0 and self.smoothness >= 0):
            raise ValueError("steps and smoothness must not be negative, rays 16 to 65536, rate positive")
        if not (4 <= self.vertices <= 128 and 8 <= self.width <= 1024 and 0 <= self.frequencies <= 10):
            raise ValueError("vertices 4 to 128, width 8 to 1024, frequencies 0 to 10")
