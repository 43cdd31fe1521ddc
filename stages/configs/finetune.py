"""Options of `stylerf finetune`."""

from dataclasses import dataclass

from stages.configs import option
from stages.configs.fit import budget_of


@dataclass(frozen=True)
class FinetuneConfig:
    """How a field learns edited photos."""

    budget: str = option("30s", help="time (45s, 2m) or number of steps")
    rays: int = option(6144, help="rays per step")
    inside: float = option(0.4, help="fraction of them through edited pixels")
    beside: float = option(0.3, help="fraction of them through pixels around those")
    rate: float = option(0.0, help="learning rate of the colors (0: 0.02 for a region's own, 0.005 for the field's)")
    density_factor: float = option(
        -1.0, help="learning rate of the density relative to it (-1: 0 with a region's own colors, else 0.3)"
    )
    colors: str = option(
        "region",
        choices=("region", "field"),
        help="colors that learn: the region's own, which tint nothing beyond it, or the whole field's",
    )
    freeze_density: bool = option(False, help="keep the shapes")
    depth_weight: float = option(1e-3, help="weight of the squared relative change of depth at edited pixels")
    checkpoint_every_seconds: float = option(20.0, help="time between checkpoints", incidental=True, advanced=True)

    @property
    def rates(self) -> tuple[float, float]:
        """(learning rate of the colors, that of the density relative to it), resolved."""
        rate, factor = (2e-2, 0.0) if self.colors == "region" else (5e-3, 0.3)
        factor = factor if self.density_factor < 0 else self.density_factor
        return self.rate or rate, 0.0 if self.freeze_density else factor

    def __post_init__(self) -> None:
        budget_of(self.budget)
        if self.rays < 64 or not 0 < self.inside <= 1 or self.rate < 0:
            raise ValueError("rays must be at least 64, inside in (0, 1], rate at least 0")
        if not 0 <= self.beside <= 1 - self.inside:
            raise ValueError("beside must be at least 0, inside and beside together at most 1")
        if self.colors == "region" and self.rates[1] == 0:
            for name in ("beside", "depth_weight"):
                if getattr(self, name) != getattr(type(self), name):
                    flag = "--" + name.replace("_", "-")
                    raise ValueError(f"{flag} has no effect while only a region's own colors learn")
        if (self.density_factor < 0 and self.density_factor != -1) or self.depth_weight < 0:
            raise ValueError("density_factor must be at least 0, or -1, and depth_weight at least 0")
