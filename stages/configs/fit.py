"""Options of `stylerf fit`."""

import re
from dataclasses import dataclass

from stages.configs import option

FIELD_KINDS = ("vm", "hash", "voxel")
# By layout; of every training of a field's shapes (docs/decisions/0011).
SMOOTHNESS = {"object": 1e-4, "forward": 1e-3, "unbounded": 1e-3}
EVEN_FROM = {"object": 0.0, "forward": 0.0, "unbounded": 1.0}  # 1: the median distance of the cameras from their focus


@dataclass(frozen=True)
class FitConfig:
    """How a radiance field is fitted to a scene."""

    budget: str = option("5m", help="training time (60s, 5m, 1h) or a number of steps; the quality of longer is higher")
    field: str = option(
        "vm",
        metavar="KIND|DENSITY+COLOR",
        help="what density and color are kept in: vm (planes and lines), hash (a hash grid), voxel (a sparse grid); "
        "or two kinds, as vm+hash",
    )
    head: str = option(
        "linear", choices=("linear", "mlp"), help="from features to colors: spherical harmonics, or a small network"
    )
    capacity: str = option(
        "grow",
        metavar="grow|fixed:N[xD[xC]]",
        help="grow while held-out views gain, or N vertices an axis (hash: cells at most), of vm with density rank D "
        "and color rank C",
    )
    min_gain: float = option(0.1, help="dB that held-out views must gain for a larger field to be kept")
    space: str = option(
        "auto", choices=("auto", "box", "contraction", "frustum"), help="warp of space (auto: by the scene's layout)"
    )
    background: str = option(
        "auto",
        choices=("auto", "white", "black", "random"),
        help="what transparent pixels are trained on (auto: white)",
    )
    degree: int = option(1, choices=(0, 1, 2), help="degree of the spherical harmonics of the color")
    samples: int = option(
        0,
        help="density samples a step; the number of rays follows (0: on the CPU 500 for each second of the budget, "
        "30000 to 90000, and 90000 where it is in steps; on a GPU 262144)",
    )
    rate: float = option(0.0, help="learning rate (0: by the scene's layout)")
    smoothness: float = option(-1.0, help="weight of the planes' total variation (-1: by the scene's layout)")
    even_from: float = option(
        -1.0,
        help="distance, scene units, below which samples learn by the square of their distance, so that nothing builds "
        "up close to the cameras (0: all alike; -1: by the scene's layout)",
    )
    opacity_weight: float = option(
        0.0, help="weight of a prior that asks every ray of an object to be clear or opaque (remedy for haze; 0: none)"
    )
    hull: float = option(
        0.05,
        help="share of the views that must show a place as empty, by their transparency, for an object never to be "
        "looked for there (0: it is looked for everywhere)",
    )
    coverage_weight: float = option(
        0.1, help="weight of the error of an object's outline, its alpha, beside that of its colors (0: none)"
    )
    exposure: str = option(
        "auto",
        choices=("auto", "on", "off"),
        help="judge by how much photos differ in exposure, and bring them to one (auto: captures, where it is plain)",
    )
    clip: float = option(
        0.0, help="a gradient counts as no longer than so many times the usual (remedy for leaps; 0: as long as it is)"
    )
    held_out: int = option(
        -1, help="training views kept aside while there is anything to decide (-1: every tenth, at most 4; 0: none)"
    )
    checkpoint_every_seconds: float = option(15.0, help="time between checkpoints", incidental=True)
    buffers: bool = option(True, help="also render every view to EXR when the field stands", incidental=True)

    def __post_init__(self) -> None:
        budget_of(self.budget)
        capacity_of(self.capacity)
        kinds_of(self.field)
        if min(self.opacity_weight, self.coverage_weight, self.clip) < 0:
            raise ValueError("opacity_weight, coverage_weight and clip must not be negative")
        if not 0 <= self.hull <= 1:
            raise ValueError("hull must be a share, 0 to 1")
        if self.min_gain < 0 or self.rate < 0 or self.checkpoint_every_seconds <= 0:
            raise ValueError("min_gain and rate must not be negative, checkpoint_every_seconds positive")
        if self.samples and self.samples < 1000:
            raise ValueError("samples must be 1000 or more, or 0")


def budget_of(text: str) -> tuple[float, int]:
    """'60s', '5m', '1h' -> (seconds, 0); '3000' -> (0, steps); ValueError for anything else."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(s|m|h)?", text.strip())
    if not match or float(match[1]) <= 0 or (match[2] is None and "." in match[1]):
        raise ValueError(f"budget {text!r} is neither a time like 60s, 5m or 1h nor a number of steps")
    if match[2] is None:
        return 0.0, int(match[1])
    return float(match[1]) * {"s": 1, "m": 60, "h": 3600}[match[2]], 0


def capacity_of(text: str) -> tuple[int, int, int] | None:
    """'grow' -> None; 'fixed:128x16x24' -> (128, 16, 24), ranks 16 and 24 where left out."""
    if text == "grow":
        return None
    match = re.fullmatch(r"fixed:(\d+)(?:x(\d+))?(?:x(\d+))?", text)
    if not match:
        raise ValueError(f"capacity {text!r} is neither grow nor fixed:N, fixed:NxD or fixed:NxDxC")
    resolution, density, color = int(match[1]), int(match[2] or 16), int(match[3] or 24)
    if not (16 <= resolution <= 1024 and all(0 < rank <= 64 and rank % 8 == 0 for rank in (density, color))):
        raise ValueError(f"capacity {text!r}: 16 to 1024 vertices and ranks of 8, 16, ... 64 are possible")
    return resolution, density, color


def kinds_of(text: str) -> tuple[str, str]:
    """'hash' -> ('hash', 'hash'); 'vm+hash' -> ('vm', 'hash'), density first."""
    kinds = text.split("+") if "+" in text else [text, text]
    if len(kinds) != 2 or not set(kinds) <= set(FIELD_KINDS):
        raise ValueError(f"field {text!r} is neither one of {', '.join(FIELD_KINDS)} nor two of them, as vm+hash")
    return kinds[0], kinds[1]
