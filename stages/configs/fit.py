"""Options of `stylerf fit`."""

import re
from dataclasses import dataclass

from stages.configs import advanced, option

FIELD_KINDS = ("vm", "hash", "voxel")
# By layout: products of planes and lines cannot hold the many layers of a frustum (docs/decisions/0048).
FIELD = {"object": "vm", "forward": "hash+vm", "unbounded": "vm"}
# By layout, against haze (docs/decisions/0047).
DISTORTION = {"object": 0.0, "forward": 0.05, "unbounded": 0.01}
MIN_CELL_WEIGHT = {"object": 0.0, "forward": 0.01, "unbounded": 0.01}
# What multiplies each of these defaults in the first half of a fit (docs/decisions/0075).
OVERSHOOT = {"object": 1.0, "forward": 1.0, "unbounded": 2.0}
# Of planes and lines, and of grids, by layout, whenever density is trained (docs/decisions/0011, 0071, 0073).
VM_SMOOTHNESS = {"object": 3e-3, "forward": 1e-3, "unbounded": 3e-3}
GRID_SMOOTHNESS = {"object": 1e-4, "forward": 1e-3, "unbounded": 3e-3}
# Of a forward-facing capture; one of fewer is smoothed more, in proportion (docs/decisions/0062).
ENOUGH_PHOTOS = 50
NEAR_SCALING = {"object": 0.0, "forward": 0.0, "unbounded": 1.0}  # 1: the cameras' median distance from their focus


def smoothness_of(kind: str, layout: str) -> float:
    """Return the default weight of the total variation of a part of this kind (vm, hash, voxel)."""
    return (VM_SMOOTHNESS if kind == "vm" else GRID_SMOOTHNESS)[layout]


@dataclass(frozen=True)
class FitConfig:
    """How a radiance field is fitted to a scene."""

    budget: str = option("5m", help="training time (60s, 5m, 1h) or number of steps; longer gives better quality")
    field: str = option(
        "auto",
        metavar="auto|KIND|DENSITY+COLOR",
        help="representation: vm (planes and lines), hash (hash grid), voxel (sparse grid); or two kinds, as hash+vm "
        "(auto: by the scene's layout)",
    )
    capacity: str = option(
        "grow",
        metavar="grow|fixed:N[xD[xC]]",
        help="grow while held-out views improve, or fix N vertices per axis, with vm ranks D (density) and C (color)",
    )
    min_gain: float = option(0.1, help="PSNR gain on held-out views, dB, that justifies a larger field")
    space: str = option(
        "auto",
        choices=("auto", "box", "contraction", "frustum"),
        help="how space is mapped to the grid (auto: by the scene's layout)",
    )
    background: str = option(
        "auto",
        choices=("auto", "white", "black", "random"),
        help="background to train transparent pixels over (auto: white)",
    )
    samples: int = option(
        0, help="density samples per step (0: CPU, 1000 per second of the budget, 30000 to 90000; GPU, 262144)"
    )
    rate: float = option(0.0, help="learning rate (0: by the scene's layout)")
    exposure: str = option(
        "auto",
        choices=("auto", "on", "off"),
        help="compensate for exposure differences between photos (auto: in captures where they are clear)",
    )
    held_out: int = option(
        -1, metavar="N", help="training views held out for choosing the capacity (-1: a tenth, at most 4; 0: none)"
    )
    buffers: bool = option(True, help="also render every view to EXR after the fit", incidental=True)
    head: str = advanced(
        "linear",
        "representation",
        choices=("linear", "mlp"),
        help="how features become colors: spherical harmonics, or a small network",
    )
    degree: int = advanced(1, "representation", choices=(0, 1, 2), help="degree of the color's spherical harmonics")
    smoothness: float = advanced(
        -1.0,
        "regularization",
        help="weight of the total variation (-1: by --field, the scene's layout and number of photos)",
    )
    near_scaling_distance: float = advanced(
        -1.0,
        "regularization",
        help="scale gradients of samples nearer to a camera than this, scene units (0: never; -1: by the layout)",
    )
    opacity_weight: float = advanced(
        0.0,
        "regularization",
        help="weight of a prior that makes an object's rays fully transparent or opaque (against haze)",
    )
    visual_hull: float = advanced(
        0.05,
        "regularization",
        help="carve space that at least this fraction of cut-out photos shows as empty (0: carve nothing)",
    )
    coverage_weight: float = advanced(
        0.1, "regularization", help="weight of the alpha loss of an object, relative to the color loss"
    )
    distortion_weight: float = advanced(
        -1.0, "regularization", help="weight of the distortion loss of mip-NeRF 360 (-1: by the scene's layout)"
    )
    least_weight: float = advanced(
        -1.0,
        "regularization",
        help="clear cells where every training ray's weight stays below this (0: none; -1: by the scene's layout)",
    )
    gradient_clip: float = advanced(
        0.0, "safeguards", help="clip gradients at this multiple of their running norm (0: never)"
    )
    checkpoint_every_seconds: float = advanced(15.0, "safeguards", help="time between checkpoints", incidental=True)

    def __post_init__(self) -> None:
        budget_of(self.budget)
        capacity_of(self.capacity)
        if self.field != "auto":
            kinds_of(self.field)
        if min(self.opacity_weight, self.coverage_weight, self.gradient_clip) < 0:
            raise ValueError("opacity_weight, coverage_weight and gradient_clip must not be negative")
        by_layout = ("smoothness", "near_scaling_distance", "distortion_weight", "least_weight", "held_out")
        if wrong := [name for name in by_layout if getattr(self, name) < 0 and getattr(self, name) != -1]:
            raise ValueError(f"{', '.join(wrong)} must be at least 0, or -1")
        if self.distortion_weight > 1 or self.least_weight > 1:
            raise ValueError("distortion_weight and least_weight must be at most 1")
        if not 0 <= self.visual_hull <= 1:
            raise ValueError("visual_hull must be a fraction, 0 to 1")
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
        raise ValueError(
            f"field {text!r} is neither auto, one of {', '.join(FIELD_KINDS)}, nor two of them, as hash+vm"
        )
    return kinds[0], kinds[1]
