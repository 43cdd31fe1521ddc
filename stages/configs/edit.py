"""Options of `stylerf stylize --region`, palette changes apart."""

import re
from dataclasses import dataclass, fields

from stages.configs import option
from stages.configs.fit import budget_of

OF_A_PAINTING = (
    "crop", "match", "preserve_color", "style_steps", "style_weight", "style_side", "variation_weight", "edge_weight",
    "smooth_weight", "features", "taps",
)  # fmt: skip


@dataclass(frozen=True)
class EditConfig:
    """How the look of a region is learned."""

    recolor: bool = option(False, help="learn a palette to recolor with; shapes and shading stay")
    style: str = option("", help="the painting: an image file", digest="style_digest")
    style_digest: str = ""
    crop: tuple[int, ...] = option((), metavar="N", help="x y size: the square of the painting that is taken")
    match: bool = option(True, help="give the region the painting's colors before its strokes (LAENeRF does not)")
    preserve_color: bool = option(False, help="strokes of the painting in the colors of the region")
    colors: int = option(8, help="palette colors at the beginning")
    most_colors: int = option(5, help="palette colors at the end, at most")
    start: str = option(
        "clusters", choices=("clusters", "random"), help="where palette colors begin (LAENeRF: random)"
    )
    palette_steps: int = option(300, help="steps towards the photos alone")
    style_steps: int = option(100, help="steps towards the painting")
    pruned_steps: int = option(-1, help="steps after colors were removed (-1: 100, with a painting 40)")
    budget: str = option("90s", metavar="TIME", help="time of all steps, at most")
    style_weight: float = option(3.0, help="weight of the Gram distance to the painting")
    style_side: int = option(128, help="longer side of the picture that features are taken from")
    offset_weight: float = option(0.5, help="weight of what is added to palette colors")
    certainty_weight: float = option(5e-3, help="weight of the share that is not of a pixel's first color")
    variation_weight: float = option(10.0, help="weight of differences between neighbors, edges of geometry apart")
    edge_weight: float = option(50.0, help="weight of contrast at edges of geometry")
    smooth_weight: float = option(100.0, help="weight of the photo's colors where the edit fades")
    features: str = option(
        "", help="feature trunk: a name or a file of VGG weights (default: the first found)", digest="features_digest"
    )
    features_digest: str = ""
    taps: str = option("conv3", help="layers of the trunk whose Gram matrices are matched")
    preview_every: float = option(
        0.0, metavar="SECONDS", help="draw a view of the region into the run's folder (0: never)", incidental=True
    )
    checkpoint_every_seconds: float = option(20.0, help="time between checkpoints", incidental=True)

    def __post_init__(self) -> None:
        if self.recolor == bool(self.style):
            raise ValueError("a region is either recolored (--recolor) or given a painting (--style IMAGE)")
        given = [one.name for one in fields(EditConfig) if getattr(self, one.name) != one.default]
        if self.recolor and (idle := [name for name in OF_A_PAINTING if name in given]):
            raise ValueError(f"{', '.join(idle)}: of a painting, and means nothing with --recolor; leave it out")
        if min(self.palette_steps, self.style_steps) < 0 or self.pruned_steps < -1:
            raise ValueError("palette_steps and style_steps must be at least 0, pruned_steps at least 0, or -1")
        if self.crop and (len(self.crop) != 3 or min(self.crop) < 0 or self.crop[2] < 16):
            raise ValueError("crop takes x, y and a size of at least 16 pixels")
        if not 1 <= self.most_colors <= self.colors <= 16:
            raise ValueError("colors must be 1 to 16, most_colors 1 to colors")
        if budget_of(self.budget)[1]:
            raise ValueError(f"budget {self.budget!r} is a time here, such as 90s; steps have options of their own")


@dataclass(frozen=True)
class PaletteConfig:
    """What is changed of a learned palette; nothing is trained for it."""

    palette: tuple[str, ...] = option(
        (),
        metavar="I=#RRGGBB",
        help="give palette color I another color; all=#RRGGBB: all of them, lights and darks kept",
    )
    palette_weight: tuple[str, ...] = option((), metavar="I=S", help="multiply the weight of palette color I by S")
    palette_bias: tuple[str, ...] = option((), metavar="I=B", help="add B to the weight of palette color I")

    def __post_init__(self) -> None:
        given = [color_of(text)[0] for text in self.palette]
        if given.count(None) > 1:
            raise ValueError("palette all=#rrggbb can be given once")
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
