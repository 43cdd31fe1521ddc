"""Options of `stylerf stylize`."""

from dataclasses import dataclass

from stages.configs import option
from stages.configs.fit import budget_of

COLOUR_CELLS = (64, 1024)  # fewest and most cells a side that the colour field takes by itself


@dataclass(frozen=True)
class StylizeConfig:
    """How a fitted field is stylised with a painting."""

    style: str = option(help="the painting: an image file")
    style_digest: str = option("", help="sha256 of the painting (filled in; guards against a changed file)")
    method: str = option(
        "arf", choices=("arf", "desrf"), help="arf: colours alone, shapes held fast; desrf: colours and shapes"
    )
    budget: str = option("2m", help="time of the style steps (60s, 2m) or their number")
    rays: str = option(
        "auto",
        choices=("auto", "full", "deferred", "dilated", "random", "patch"),
        help="rays that carry gradient in a step (auto: dilated for desrf on views over 256 pixels, else deferred)",
    )
    dilation: int = option(2, help="Nc: every Nc-th ray in both axes (dilated), or as few rays (random, patch)")
    blur: int = option(0, help="side of a box filter on dL/dRGB before rays are picked, odd (DeSRF: 3; 0: none)")
    remember: bool = option(True, help="take rays that do not learn from the view's last render")
    features: str = option(
        "",
        help="feature trunk: a name or a file of VGG weights (default: the first found of vgg16, hed-vgg16, st-vgg16)",
    )
    taps: str = option("conv3", help="layers of the trunk that are matched: conv2, conv3, conv3_1 ...")
    style_weight: float = option(1.0, help="weight of the nearest-neighbour feature distance")
    content_weight: float = option(2e-2, help="weight of the content distance, in the painting's mean squared feature")
    colour_weight: float = option(
        -1.0,
        help="weight of the squared difference from the photo's matched colours, in cells a 32nd of the view wide "
        "(-1: 10, but 1 where desrf bends an object)",
    )
    variation_weight: float = option(
        -1.0, help="weight of the picture's total variation (-1: as in the papers, 1 for arf, 0.1 for desrf)"
    )
    deform_rate: float = option(1.2e-2, help="learning rate of the deformation (desrf)")
    displacement_weight: float = option(
        -1.0, help="weight of the root mean square of the displacement (desrf; -1: 0.003 in captures, 0 for an object)"
    )
    displacement_vertices: int = option(32, help="side of the grid that the deformation is baked to (desrf)")
    match: str = option("both", choices=("both", "before", "after", "none"), help="exact colour matching")
    refit_steps: int = option(300, help="steps that fit the new colours to the matched photos")
    rate: float = option(3e-2, help="learning rate of the colours")
    feature_scale: float = option(
        0.0,
        help="size, relative to the view, of the picture that features are taken from (0: half, as ARF, but no less "
        "than 256 pixels where the view has them)",
    )
    coarse: float = option(
        -1.0,
        help="share of the style steps, the first, that see features at half that size (-1: 0.6 where desrf bends an "
        "object, else 0)",
    )
    style_scale: float = option(1.5, help="size of the painting relative to the view: larger gives larger strokes")
    style_rows: int = option(4096, help="most features of the painting that are matched against")
    style_basis: int = option(96, help="directions of feature space in which the nearest are sought (0: all, exact)")
    levels: int = option(8, help="levels of the colour field's hash grid")
    finest: int = option(
        0,
        help="cells a side of its finest level (0: a little finer than a pixel of the photos, "
        f"{COLOUR_CELLS[0]} to {COLOUR_CELLS[1]} of them)",
    )
    table_bits: int = option(17, help="its table entries a level, as a power of two")
    checkpoint_every_seconds: float = option(20.0, help="time between checkpoints")

    def __post_init__(self) -> None:
        budget_of(self.budget)
        if self.blur < 0 or (self.blur > 0 and self.blur % 2 == 0):
            raise ValueError("blur must be odd, or 0 for none: an even box would shift the picture by half a pixel")
        if self.dilation < 1 or not 0 <= self.feature_scale <= 1 or self.style_scale <= 0:
            raise ValueError("dilation must be at least 1, feature_scale in 0..1, style_scale > 0")
        if not (0 <= self.coarse <= 1 or self.coarse == -1):
            raise ValueError("coarse must be in 0..1 (or -1: by method and scene)")
        for name in ("variation_weight", "colour_weight", "displacement_weight"):
            if getattr(self, name) < 0 and getattr(self, name) != -1:
                raise ValueError(f"{name} must be at least 0 (or -1: by method and scene)")
        finest = self.finest == 0 or 16 <= self.finest <= 4096
        if not (1 <= self.levels <= 16 and finest and 10 <= self.table_bits <= 24):
            raise ValueError("the colour field takes 1 to 16 levels, 16 to 4096 cells (or 0), 10 to 24 table bits")
