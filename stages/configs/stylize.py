"""Options of `stylerf stylize`."""

from dataclasses import dataclass, fields

from stages.configs import option
from stages.configs.fit import budget_of
from stages.configs.views import file_of

COLOR_CELLS = (64, 1024)  # fewest and most cells a side that the color field takes by itself
METHODS = ("arf", "desrf", "snerf", "refnpr", "palettenerf")
# Options that mean nothing with another method, by their beginning.
OWN = {"desrf": ("deform_", "displacement_"), "snerf": ("rounds", "image_"), "refnpr": ("reference",)}
OF_RAYS = ("rays", "dilation", "blur", "remember")  # which snerf, whose field learns whole pictures, does not choose


@dataclass(frozen=True)
class StylizeConfig:
    """How a fitted field is stylized with a painting."""

    style: str = option("", help="the painting: an image file (needed, but with --reference)", digest="style_digest")
    style_digest: str = ""
    method: str = option(
        "arf",
        choices=METHODS,
        help="arf: colors alone, shapes held fast; desrf: colors and shapes; snerf: pictures painted in 2D and the "
        "field taught them, by turns; refnpr: after views that are given, or made, stylized; palettenerf: no painting, "
        "a palette of the whole scene that can be changed (its options: --method palettenerf --help)",
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
        digest="features_digest",
    )
    features_digest: str = ""
    taps: str = option(
        "",
        help="layers of the trunk that are matched: conv2, conv3, conv3_1 ... (default: conv3; of Gram matrices conv2 "
        "to conv4; with a reference conv3,conv4)",
    )
    style_weight: float = option(1.0, help="weight of the nearest-neighbor feature distance")
    content_weight: float = option(
        -1.0,
        help="weight of the content distance, in the painting's mean squared feature (-1: 0.02, for refnpr 0.1)",
    )
    color_weight: float = option(
        -1.0,
        help="weight of the squared difference from the photo's matched colors, in cells a 32nd of the view wide "
        "(-1: 10, but 1 where desrf bends an object; refnpr: 5, from the colors of the reference's like cells)",
    )
    variation_weight: float = option(
        -1.0, help="weight of the picture's total variation (-1: as in the papers, 0.1 for desrf, else 1)"
    )
    deform_rate: float = option(1.2e-2, help="learning rate of the deformation (desrf)")
    displacement_weight: float = option(
        -1.0, help="weight of the root mean square of the displacement (desrf; -1: 0.003 in captures, 0 for an object)"
    )
    displacement_vertices: int = option(32, help="side of the grid that the deformation is baked to (desrf)")
    match: str = option(
        "auto",
        choices=("auto", "both", "before", "after", "none"),
        help="exact color matching (auto: both; refnpr: before, where it paints the reference, else none)",
    )
    refit_steps: int = option(300, help="steps that fit the new colors to the matched photos")
    rate: float = option(3e-2, help="learning rate of the colors")
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
    levels: int = option(8, help="levels of the color field's hash grid")
    finest: int = option(
        0,
        help="cells a side of its finest level (0: a little finer than a pixel of the photos, "
        f"{COLOR_CELLS[0]} to {COLOR_CELLS[1]} of them)",
    )
    table_bits: int = option(17, help="its table entries a level, as a power of two")
    rounds: int = option(3, help="rounds of pictures, then field, that share the budget (snerf)")
    image_share: float = option(
        0.75,
        help="share of a round in which pictures are painted (snerf; of a number of steps at most half, and each view "
        "once)",
    )
    image_steps: int = option(5, help="steps of a picture's pixels each time that it is painted (snerf)")
    image_rate: float = option(0.03, help="learning rate of a picture's pixels (snerf, refnpr)")
    image_by: str = option("gram", choices=("gram", "nnfm"), help="by what pictures are painted (snerf)")
    reference: tuple[str, ...] = option(
        (),
        metavar="VIEW=FILE",
        help="a training view, and that view stylized; repeatable (refnpr)",
        digest="references_digest",
    )
    reference_by: str = option(
        "",
        choices=("", "gram", "nnfm", "adain"),
        metavar="gram|nnfm|adain",
        help="how a reference is made where none is given: its pixels optimized, or decoded at once (refnpr; default: "
        "nnfm)",
    )
    reference_view: str = option(
        "", help="the view that is made a reference (refnpr; default: the one that sees most of what the others see)"
    )
    reference_steps: int = option(60, help="steps of its pixels, at most a third of the budget (refnpr)")
    reference_weight: float = option(
        1.0, help="weight of the squared error of colors on the reference's and on registered rays (refnpr)"
    )
    rollbacks: int = option(
        0, help="times that a loss which left the finite numbers leads back to the last good state, at half the rate"
    )
    clip: float = option(0.0, help="a gradient counts as no longer than so many times the usual (0: as long as it is)")
    least_spread: float = option(
        0.0,
        help="standard deviation of luma, 0 to 0.25, that color matching gives at least; a painting with less spread "
        "than that counts as less of a style (remedy for blank paintings)",
    )
    most_gain: float = option(
        4.0,
        help="how many times as far apart color matching sets the scene's colors at most, along any of their "
        "principal axes (0: as far as the painting's, as ARF does, which turns the noise of a gray scene into colors)",
    )
    references_digest: str = ""
    checkpoint_every_seconds: float = option(20.0, help="time between checkpoints", incidental=True)

    def __post_init__(self) -> None:
        budget_of(self.budget)
        self._check_method()
        if self.blur < 0 or (self.blur > 0 and self.blur % 2 == 0):
            raise ValueError("blur must be odd, or 0 for none: an even box would shift the picture by half a pixel")
        if self.dilation < 1 or not 0 <= self.feature_scale <= 1 or self.style_scale <= 0:
            raise ValueError("dilation must be at least 1, feature_scale in 0..1, style_scale > 0")
        if self.refit_steps < 0 or self.rate <= 0 or self.style_rows < 1 or self.style_basis < 0:
            raise ValueError("refit_steps and style_basis must not be negative, rate over 0, style_rows at least 1")
        if self.deform_rate <= 0 or not 4 <= self.displacement_vertices <= 128:
            raise ValueError("deform_rate must be over 0, displacement_vertices 4 to 128")
        if self.rollbacks < 0 or self.clip < 0 or not 0 <= self.least_spread <= 0.25:
            raise ValueError("rollbacks and clip must not be negative, least_spread in 0..0.25")
        if self.most_gain < 0:
            raise ValueError("most_gain must not be negative (0: no bound)")
        if not (0 <= self.coarse <= 1 or self.coarse == -1):
            raise ValueError("coarse must be in 0..1 (or -1: by method and scene)")
        for name in ("variation_weight", "content_weight", "color_weight", "displacement_weight"):
            if getattr(self, name) < 0 and getattr(self, name) != -1:
                raise ValueError(f"{name} must be at least 0 (or -1: by method and scene)")
        finest = self.finest == 0 or 16 <= self.finest <= 4096
        if not (1 <= self.levels <= 16 and finest and 10 <= self.table_bits <= 24):
            raise ValueError("the color field takes 1 to 16 levels, 16 to 4096 cells (or 0), 10 to 24 table bits")

    def _check_method(self) -> None:
        if self.method == "palettenerf":
            raise ValueError(
                "--method palettenerf has options of its own and is given on the command line, not in a file"
            )
        for item in fields(self):
            if getattr(self, item.name) == item.default or (item.name == "image_rate" and self.method == "refnpr"):
                continue
            flag = "--" + item.name.replace("_", "-")
            if item.name in OF_RAYS and self.method == "snerf":
                raise ValueError(f"{flag} is no option of --method snerf, whose field learns whole pictures")
            owner = next((m for m, names in OWN.items() if item.name.startswith(names)), self.method)
            if owner != self.method:
                raise ValueError(f"{flag} is an option of --method {owner}; this is --method {self.method}")
            unmatched = self.match == "none" or (self.match == "auto" and bool(self.reference))
            if unmatched and (item.name == "most_gain" or (item.name == "least_spread" and self.reference)):
                raise ValueError(f"{flag} bounds the matching of colors, and none are matched here; leave it out")
        if not self.style and not self.reference:
            raise ValueError("--style is required: the painting, an image file")
        if self.reference and self.style and self.match in ("auto", "none"):
            raise ValueError("with --reference the --style has no say, unless --match before asks for its colors")
        if self.reference and (self.reference_by or self.reference_view):
            raise ValueError("--reference gives the stylized views; --reference-by and --reference-view make one")
        views = [file_of(text)[0] for text in self.reference]
        if len(set(views)) < len(views):
            raise ValueError(f"a view is given two references: {', '.join(views)}")
        if self.rounds < 1 or self.image_steps < 1 or self.reference_steps < 1:
            raise ValueError("rounds, image_steps and reference_steps must be at least 1")
        if not 0 < self.image_share < 1 or self.image_rate <= 0 or self.reference_weight < 0:
            raise ValueError("image_share must be over 0 and under 1, image_rate over 0, reference_weight at least 0")
