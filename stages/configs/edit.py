"""Options of `stylerf stylize --region`, palette changes apart."""

import re
from dataclasses import dataclass, fields

from stages.configs import option
from stages.configs.fit import budget_of

STYLE_ONLY = (
    "crop", "match", "preserve_color", "style_steps", "style_weight", "style_side", "variation_weight", "edge_weight",
    "smooth_weight", "features", "layers",
)  # fmt: skip
LOSS, STEPS = "loss", "training"


@dataclass(frozen=True)
class EditConfig:
    """How the look of a region is learned."""

    recolor: bool = option(False, help="learn a palette to recolor with; shapes and shading stay")
    style: str = option("", help="the style image", digest="style_digest")
    style_digest: str = ""  # sha256 of the style image
    crop: tuple[int, ...] = option((), metavar="N", help="x y size: use this square of the style image")
    preserve_color: bool = option(False, help="the style image's strokes in the region's colors")
    colors: int = option(8, help="palette colors at the beginning")
    max_colors: int = option(5, help="most palette colors at the end")
    budget: str = option("90s", metavar="TIME", help="most time for all steps")
    style_weight: float = option(3.0, help="weight of the Gram distance to the style image")
    features: str = option(
        "",
        help="feature extractor: a name or a file of VGG weights (default: the first found)",
        digest="features_digest",
    )
    features_digest: str = ""  # sha256 of that file
    match: bool = option(
        True,
        help="give the region the style image's colors first (LAENeRF does not)",
        advanced=True,
        group=LOSS,
    )
    layers: str = option("conv3", help="feature layers whose Gram matrices are matched", advanced=True, group=LOSS)
    style_side: int = option(
        128, help="longer side of the image that features are taken from", advanced=True, group=LOSS
    )
    offset_weight: float = option(0.5, help="weight of offsets from palette colors", advanced=True, group=LOSS)
    certainty_weight: float = option(
        5e-3, help="weight of mixing: the share that is not of a pixel's first color", advanced=True, group=LOSS
    )
    variation_weight: float = option(
        10.0, help="weight of differences between neighbors, except at edges of geometry", advanced=True, group=LOSS
    )
    edge_weight: float = option(50.0, help="weight of contrast at edges of geometry", advanced=True, group=LOSS)
    smooth_weight: float = option(
        100.0, help="weight of the photo's colors where the edit fades", advanced=True, group=LOSS
    )
    start: str = option(
        "clusters",
        choices=("clusters", "random"),
        help="initial palette colors (LAENeRF: random)",
        advanced=True,
        group=STEPS,
    )
    palette_steps: int = option(300, help="steps on the photos alone", advanced=True, group=STEPS)
    style_steps: int = option(100, help="steps on the style image", advanced=True, group=STEPS)
    pruned_steps: int = option(
        -1, help="steps after colors are pruned (-1: 100; with a style image 40)", advanced=True, group=STEPS
    )
    preview_every: float = option(
        0.0,
        metavar="SECONDS",
        help="time between previews of the region (0: none)",
        incidental=True,
        advanced=True,
        group=STEPS,
    )
    checkpoint_every_seconds: float = option(
        20.0, help="time between checkpoints", incidental=True, advanced=True, group=STEPS
    )

    def __post_init__(self) -> None:
        if self.recolor == bool(self.style):
            raise ValueError("a region takes either --recolor or --style IMAGE")
        given = [one.name for one in fields(EditConfig) if getattr(self, one.name) != one.default]
        if self.recolor and (idle := [name for name in STYLE_ONLY if name in given]):
            raise ValueError(f"{', '.join(idle)}: no effect with --recolor, only with --style; leave it out")
        if min(self.palette_steps, self.style_steps) < 0 or self.pruned_steps < -1:
            raise ValueError("palette_steps and style_steps must be at least 0, pruned_steps at least 0, or -1")
        if self.crop and (len(self.crop) != 3 or min(self.crop) < 0 or self.crop[2] < 16):
            raise ValueError("crop takes x, y and a size of at least 16 pixels")
        if not 1 <= self.max_colors <= self.colors <= 16:
            raise ValueError("colors must be 1 to 16, max_colors 1 to colors")
        if budget_of(self.budget)[1]:
            raise ValueError(f"budget {self.budget!r} must be a time here, such as 90s; steps have their own options")


@dataclass(frozen=True)
class PaletteConfig:
    """Changes of a learned palette, which need no training."""

    palette: tuple[str, ...] = option(
        (),
        metavar="I=#RRGGBB",
        help="replace palette color I; all=#RRGGBB: replace the hue of all",
    )
    palette_weight: tuple[str, ...] = option((), metavar="I=S", help="multiply the weight of palette color I by S")
    palette_bias: tuple[str, ...] = option((), metavar="I=B", help="add B to the weight of palette color I")

    def __post_init__(self) -> None:
        given = [color_of(text)[0] for text in self.palette]
        if given.count(None) > 1:
            raise ValueError("palette all=#rrggbb can be given only once")
        for text in (*self.palette_weight, *self.palette_bias):
            number_of(text)

    def __bool__(self) -> bool:
        return bool(self.palette or self.palette_weight or self.palette_bias)


def color_of(text: str) -> tuple[int | None, tuple[float, float, float]]:
    """'2=#c03020' -> (2, sRGB in 0..1), 'all=#c03020' -> (None, ...); ValueError for anything else."""
    match = re.fullmatch(r"(\d+|all)=#([0-9a-fA-F]{6})", text)
    if not match:
        raise ValueError(f"{text!r} is not a palette color, written I=#rrggbb or all=#rrggbb")
    red, green, blue = (int(match[2][i : i + 2], 16) / 255 for i in (0, 2, 4))
    return None if match[1] == "all" else int(match[1]), (red, green, blue)


def number_of(text: str) -> tuple[int, float]:
    """'2=0.5' -> (2, 0.5); ValueError for anything else."""
    match = re.fullmatch(r"(\d+)=([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)", text)
    if not match:
        raise ValueError(f"{text!r} is not a palette index and a number, written I=S")
    return int(match[1]), float(match[2])
