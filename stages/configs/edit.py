"""Options of a local edit: extract, learning a look (stylize --region), distill, finetune, and all of it (edit)."""

import re
from dataclasses import dataclass, fields

from stages.configs import advanced, option, part_of
from stages.configs.fit import budget_of
from stages.configs.select import SelectConfig


@dataclass(frozen=True)
class ExtractConfig:
    """What the training views show of a region, for its edit."""

    tolerance: float = option(
        0.5, help="leave out pixels with more opacity than this outside the region (LAENeRF: 0.5 to 0.85)"
    )
    transition: float = option(-1.0, help="width over which an edit fades out, scene units (-1: a 40th of the region)")
    exr: bool = option(True, help="also write OpenEXR images")

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1 or (self.transition < 0 and self.transition != -1):
            raise ValueError("tolerance must be between 0 and 1, transition at least 0 (or -1)")


STYLE_ONLY = (
    "crop", "keep_frame", "stroke", "match", "keep_colors", "style_steps", "style_weight", "style_side",
    "variation_weight", "edge_weight",
    "smooth_weight", "features", "layers",
)  # fmt: skip
LOSS, STEPS = "loss", "training"
STROKES = (0.25, 4.0)  # smallest and largest --stroke


@dataclass(frozen=True)
class EditConfig:
    """How the look of a region is learned."""

    recolor: bool = option(False, help="recolor the region through a palette; shapes and shading stay")
    style: str = option("", help="the style image", digest="style_digest")
    style_digest: str = ""  # sha256 of the style image
    crop: tuple[int, ...] = option((), metavar="N", help="x y size: use only this square of the style image")
    keep_frame: bool = option(False, help="keep the frame or paper around the style image")
    stroke: float = option(1.0, help="stroke size relative to the default, 0.25 to 4")
    keep_colors: bool = option(False, help="use the style image's strokes but the region's colors")
    colors: int = option(8, help="initial number of palette colors")
    max_colors: int = option(5, help="maximum number of palette colors that are kept")
    budget: str = option("90s", metavar="TIME", help="maximum time for all steps")
    style_weight: float = option(3.0, help="weight of the Gram distance to the style image")
    features: str = option(
        "",
        help="feature extractor: a name or a file of VGG weights (default: the first found)",
        digest="features_digest",
    )
    features_digest: str = ""  # sha256 of that file
    match: bool = advanced(True, LOSS, help="first match the region's colors to the style image's (LAENeRF does not)")
    layers: str = advanced("conv3", LOSS, help="feature layers whose Gram matrices are matched")
    style_side: int = advanced(128, LOSS, help="longer side of the image that features are taken from")
    offset_weight: float = advanced(0.5, LOSS, help="weight of the offsets from palette colors")
    certainty_weight: float = advanced(
        5e-3, LOSS, help="weight of mixing: the share of a pixel that its main palette color does not explain"
    )
    variation_weight: float = advanced(10.0, LOSS, help="weight of total variation, except at edges of the geometry")
    edge_weight: float = advanced(50.0, LOSS, help="weight of contrast at edges of the geometry")
    smooth_weight: float = advanced(100.0, LOSS, help="weight of the photo's colors where the edit fades out")
    start: str = advanced(
        "clusters", STEPS, choices=("clusters", "random"), help="initial palette colors (LAENeRF: random)"
    )
    palette_steps: int = advanced(300, STEPS, help="palette steps on the photos, before any style")
    style_steps: int = advanced(100, STEPS, help="steps on the style image")
    pruned_steps: int = advanced(-1, STEPS, help="steps after colors are pruned (-1: 100, or 40 with a style image)")
    preview_every: float = advanced(
        0.0, STEPS, metavar="SECONDS", help="time between previews of the region (0: none)", incidental=True
    )
    checkpoint_every_seconds: float = advanced(20.0, STEPS, help="time between checkpoints", incidental=True)

    def __post_init__(self) -> None:
        if self.recolor == bool(self.style):
            raise ValueError("a region takes either --recolor or --style IMAGE")
        changed = [one.name for one in fields(EditConfig) if getattr(self, one.name) != one.default]
        if self.recolor and (idle := [name for name in STYLE_ONLY if name in changed]):
            raise ValueError(f"{', '.join(idle)}: no effect with --recolor, only with --style; leave it out")
        if min(self.palette_steps, self.style_steps) < 0 or self.pruned_steps < -1:
            raise ValueError("palette_steps and style_steps must be at least 0, pruned_steps at least 0, or -1")
        if self.crop and (len(self.crop) != 3 or min(self.crop) < 0 or self.crop[2] < 16):
            raise ValueError("crop takes x, y and a size of at least 16 pixels")
        if self.crop and self.keep_frame:
            raise ValueError("--crop uses its square as it is; leave --keep-frame out")
        if not STROKES[0] <= self.stroke <= STROKES[1]:
            raise ValueError(f"stroke must be in {STROKES[0]}..{STROKES[1]}")
        if negative := [one.name for one in fields(EditConfig) if one.name.endswith("_weight")
                        and getattr(self, one.name) < 0]:  # fmt: skip
            raise ValueError(f"{', '.join(negative)} must not be negative")
        if self.style_side < 16 or self.preview_every < 0 or self.checkpoint_every_seconds <= 0:
            raise ValueError("style_side must be at least 16, preview_every at least 0, checkpoint_every_seconds > 0")
        if not 1 <= self.max_colors <= self.colors <= 16:
            raise ValueError("colors must be 1 to 16, max_colors 1 to colors")
        if budget_of(self.budget)[1]:
            raise ValueError(f"budget {self.budget!r} must be a time here, such as 90s; steps have their own options")


@dataclass(frozen=True)
class PaletteConfig:
    """Changes of a learned palette, which need no training."""

    palette: tuple[str, ...] = option(
        (), metavar="I=#RRGGBB", help="replace palette color I; all=#RRGGBB: change the hue of all"
    )
    palette_weight: tuple[str, ...] = option((), metavar="I=S", help="multiply the weight of palette color I by S")
    palette_bias: tuple[str, ...] = option((), metavar="I=B", help="add B to the weight of palette color I")

    def __post_init__(self) -> None:
        indices = [color_of(text)[0] for text in self.palette]
        if indices.count(None) > 1:
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


@dataclass(frozen=True)
class DistillConfig:
    """How an edit is written into the photos."""

    fade: bool = option(True, help="fade the edit out towards the region's surroundings")
    min_opacity: float = option(0.5, help="minimum opacity of the region in an edited pixel")

    def __post_init__(self) -> None:
        if not 0 < self.min_opacity < 1:
            raise ValueError("min_opacity must be between 0 and 1")


@dataclass(frozen=True)
class FinetuneConfig:
    """How a field learns edited photos."""

    budget: str = option("30s", help="time (45s, 2m) or number of steps")
    rays: int = option(6144, help="rays per step")
    inside: float = option(0.4, help="fraction of the rays through edited pixels")
    beside: float = option(0.3, help="fraction of the rays through pixels around the edited ones")
    rate: float = option(0.0, help="learning rate of the colors (0: 0.02 for region, 0.005 for field)")
    density_factor: float = option(
        -1.0, help="learning rate of the density, relative to the colors' (-1: 0 for region, 0.3 for field)"
    )
    colors: str = option(
        "region",
        choices=("region", "field"),
        help="colors to train: a layer for the region alone, or the whole field's",
    )
    freeze_density: bool = option(False, help="train colors only")
    depth_weight: float = option(1e-3, help="weight of the squared relative change of depth at edited pixels")
    checkpoint_every_seconds: float = advanced(20.0, help="time between checkpoints", incidental=True)

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
        if self.freeze_density and self.density_factor > 0:
            raise ValueError("--density-factor has no effect with --freeze-density; leave it out")
        if self.colors == "region" and self.rates[1] == 0:
            for name in ("beside", "depth_weight"):
                if getattr(self, name) != getattr(type(self), name):
                    flag = "--" + name.replace("_", "-")
                    raise ValueError(f"{flag} has no effect while only a region's own colors learn")
        elif self.beside < 0 or self.inside + self.beside > 1 + 1e-9:  # 0.8 + 0.2 is more than 1 by rounding
            raise ValueError("beside must be at least 0, inside and beside together at most 1")
        if (self.density_factor < 0 and self.density_factor != -1) or self.depth_weight < 0:
            raise ValueError("density_factor must be at least 0, or -1, and depth_weight at least 0")


@dataclass(frozen=True)
class RegionConfig(PaletteConfig, EditConfig):
    """Both in one command. They are two stages, so that changing a palette needs no training."""

    def __post_init__(self) -> None:
        EditConfig.__post_init__(self)
        PaletteConfig.__post_init__(self)

    @property
    def learning(self) -> EditConfig:
        """How the look is learned."""
        return part_of(self, EditConfig)

    @property
    def changes(self) -> PaletteConfig:
        """Changes to the palette."""
        return part_of(self, PaletteConfig)


@dataclass(frozen=True)
class WholeEditConfig(RegionConfig, SelectConfig):
    """What is selected and what becomes of it. Later stages take their options from the --config file."""

    def __post_init__(self) -> None:
        SelectConfig.__post_init__(self)
        RegionConfig.__post_init__(self)

    @property
    def selection(self) -> SelectConfig:
        """What is selected."""
        return part_of(self, SelectConfig)

    @property
    def look(self) -> RegionConfig:
        """What becomes of it."""
        return part_of(self, RegionConfig)
