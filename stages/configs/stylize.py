"""Options of `stylerf stylize` with a style image: one class per method."""

from collections.abc import Iterable
from dataclasses import dataclass, fields

from stages.configs import advanced, option
from stages.configs.edit import STROKES
from stages.configs.fit import budget_of
from stages.configs.view_syntax import file_of

COLOR_CELLS = (64, 1024)  # cells per side that the color field takes by default
MIN_SIDE = 64  # pixels of a view: deep layers see little in a smaller one
METHODS = ("arf", "desrf", "snerf", "refnpr", "palettenerf")
LOSS, COLORS, GRID, LIMITS = "style loss", "colors", "color field", "safeguards"
RAYS, SHAPES, IMAGES, REFERENCE = "rays", "deformation", "image optimization", "reference"


@dataclass(frozen=True)
class StylizeConfig:
    """What the methods with a style image share. A value of -1 depends on method and scene."""

    style: str = option("", help="the style image (required unless --reference gives views)", digest="style_digest")
    style_digest: str = ""  # sha256 of the style image
    method: str = option(
        "arf",
        choices=METHODS,
        help="arf: colors only; desrf: colors and shapes; snerf: images and field in turn; refnpr: from stylized "
        "views; palettenerf: an editable palette, no style image. `--method NAME --help` shows a method's options",
    )
    budget: str = option("2m", help="time (60s, 2m) or number of style steps")
    max_side: int = option(
        -1,
        help="limit the longer side of the views to learn from, pixels (0: no limit; -1: on a CPU by the time in "
        "--budget)",
    )
    features: str = option(
        "",
        help="feature extractor: a name or a file of VGG weights (default: first found of vgg16, hed-vgg16, st-vgg16)",
        digest="features_digest",
    )
    features_digest: str = ""  # sha256 of that file
    style_weight: float = option(1.0, help="weight of the style distance")
    content_weight: float = option(
        -1.0, help="weight of the content distance (-1: 0.005; nearest, gram, deformed objects: 0.02; refnpr: 0.1)"
    )
    color_weight: float = option(
        -1.0,
        help="weight of the squared color difference to the photos (-1: 1; nearest, gram: 10, or 1 where desrf "
        "deforms an object; refnpr: 5; with --keep-colors: 10)",
    )
    match_by: str = option(
        "transport",
        choices=("transport", "nearest"),
        help="match features by optimal transport, which uses more of the style image, or to the nearest one (NNFM)",
    )
    diversity: float = option(0.5, help="how evenly transport uses the style image's features, 0 to about 2")
    structure_weight: float = option(
        -1.0,
        help="weight of the loss of the photo's edges (-1: 8; nearest, gram: 0; desrf: 4, of objects 2)",
    )
    gram_weight: float = option(
        -1.0, help="weight of the Gram matrix loss within the style distance (-1: 2; nearest: 0)"
    )
    grain_weight: float = option(
        -1.0, help="weight of the loss of grain beyond the style image's (-1: 4; desrf: 1; nearest, gram: 0)"
    )
    stroke: float = option(1.0, help="stroke size relative to the default, 0.25 to 4")
    stroke_by_depth: bool = option(
        False, help="halve strokes at twice the depth; --stroke is the size at the scene's median depth"
    )
    rotations: bool = option(False, help="also match the style image rotated by 90, 180 and 270 degrees")
    keep_frame: bool = option(False, help="keep the frame or paper around the style image")
    match: str = option(
        "auto",
        choices=("auto", "both", "before", "after", "none"),
        help="color matching to the style image (auto: both; refnpr: before if it optimizes the reference, else none)",
    )
    keep_colors: bool = option(False, help="use the style image's strokes but the photos' colors")
    rate: float = option(4e-2, help="learning rate of the colors")
    style_scale: float = advanced(
        1.5, LOSS, help="size of the style image relative to the view; --stroke scales it from there"
    )
    layers: str = advanced(
        "",
        LOSS,
        help="feature layers to match: conv2, conv3_1 ... (default: conv2_1,conv3_1, with conv4_1 in coarse "
        "steps; nearest: conv3; Gram: conv2 to conv4; refnpr: conv3,conv4)",
    )
    variation_weight: float = advanced(
        -1.0, LOSS, help="weight of the image's total variation (-1: 0.1 for desrf, else 1)"
    )
    feature_scale: float = advanced(
        0.0,
        LOSS,
        help="image size for features, relative to the view (0: half, at least 512 pixels if it has them; nearest, "
        "gram, and matching with refnpr's references: 256)",
    )
    coarse: float = advanced(
        -1.0,
        LOSS,
        help="first fraction of the style steps (refnpr: of those on its reference), at half the feature scale (-1: "
        "0.5; with nearest, gram: 0; 0.6 where desrf deforms an object)",
    )
    style_rows: int = advanced(4096, LOSS, help="maximum number of style features to match")
    style_basis: int = advanced(96, LOSS, help="principal directions used to find nearest neighbors (0: all, exact)")
    refit_steps: int = advanced(400, COLORS, help="steps that fit the new color field to the photos before stylization")
    min_spread: float = advanced(
        0.0, COLORS, help="minimum standard deviation of luma to match to, 0 to 0.25; for blank style images"
    )
    max_gain: float = advanced(
        4.0,
        COLORS,
        help="maximum factor by which color matching stretches the scene's colors (0: no limit, as in ARF)",
    )
    levels: int = advanced(8, GRID, help="levels of the color field's hash grid")
    finest: int = advanced(
        0,
        GRID,
        help=f"cells per side of its finest level (0: a little finer than a pixel, {COLOR_CELLS[0]} to "
        f"{COLOR_CELLS[1]})",
    )
    table_bits: int = advanced(19, GRID, help="log2 of its table entries per level")
    rollbacks: int = advanced(0, LIMITS, help="rollbacks, each halving the rate, after a non-finite loss")
    gradient_clip: float = advanced(
        0.0, LIMITS, help="clip gradients at this multiple of their running norm (0: never)"
    )
    until: int = advanced(
        0,
        LIMITS,
        extent=True,
        help="end after this many style steps; also finishes an interrupted run (0: use the budget)",
    )
    checkpoint_every_seconds: float = advanced(20.0, LIMITS, help="time between checkpoints", incidental=True)

    @property
    def references(self) -> tuple[str, ...]:
        """VIEW=FILE of the given references; only refnpr takes any."""
        return ()

    def __post_init__(self) -> None:
        if CONFIGS.get(self.method) is not type(self):
            raise ValueError(f"--method {self.method} has options of its own; give it on the command line")
        budget_of(self.budget)
        if self.max_side != -1 and not (self.max_side == 0 or self.max_side >= MIN_SIDE):
            raise ValueError(f"max_side must be at least {MIN_SIDE} pixels, or 0 for no limit (-1: by the budget)")
        if self.until < 0:
            raise ValueError("until must be a number of style steps, or 0")
        if not self.style and not self.references:
            raise ValueError("--style is required: the style image")
        unmatched = self.match == "none" or (self.match == "auto" and bool(self.references))
        if unmatched and self.max_gain != StylizeConfig.max_gain:
            raise ValueError("--max-gain limits color matching, and no colors are matched; leave it out")
        if unmatched and self.references and self.min_spread != StylizeConfig.min_spread:
            raise ValueError("--min-spread limits color matching, and no colors are matched; leave it out")
        if not 0 <= self.feature_scale <= 1 or self.style_scale <= 0:
            raise ValueError("feature_scale must be in 0..1, style_scale > 0")
        if not STROKES[0] <= self.stroke <= STROKES[1]:
            raise ValueError(f"stroke must be in {STROKES[0]}..{STROKES[1]}")
        if self.references:
            self._refuse_style_image()
        if self.refit_steps < 0 or self.rate <= 0 or self.style_rows < 1 or self.style_basis < 0:
            raise ValueError("refit_steps and style_basis must not be negative, rate > 0, style_rows at least 1")
        if self.rollbacks < 0 or self.gradient_clip < 0 or not 0 <= self.min_spread <= 0.25:
            raise ValueError("rollbacks and gradient_clip must not be negative, min_spread in 0..0.25")
        if self.keep_colors and (self.match != "auto" or self.references):
            raise ValueError("--keep-colors matches the style image to the photos; leave --match and --reference out")
        if self.keep_colors and self.max_gain != StylizeConfig.max_gain:
            raise ValueError("--max-gain limits color matching, which --keep-colors leaves out; leave it out")
        if self.diversity < 0:
            raise ValueError("diversity must not be negative")
        if self.match_by == "nearest" and self.diversity != StylizeConfig.diversity:
            raise ValueError("--diversity has no effect with --match-by nearest; leave it out")
        if self.style_weight < 0:
            raise ValueError("style_weight must not be negative")
        if self.max_gain < 0:
            raise ValueError("max_gain must not be negative (0: no limit)")
        if not (0 <= self.coarse <= 1 or self.coarse == -1):
            raise ValueError("coarse must be in 0..1 (or -1: by method and scene)")
        self._check_weights(
            "variation_weight", "content_weight", "color_weight", "structure_weight", "gram_weight", "grain_weight"
        )
        finest = self.finest == 0 or 16 <= self.finest <= 4096
        if not (1 <= self.levels <= 16 and finest and 10 <= self.table_bits <= 24):
            raise ValueError("the color field takes 1 to 16 levels, 16 to 4096 cells (or 0), 10 to 24 table bits")

    def _refuse_matching(self, beside: str) -> None:
        if (self.match_by, self.diversity) != (StylizeConfig.match_by, StylizeConfig.diversity):
            raise ValueError(f"--match-by and --diversity have no effect with {beside}; leave them out")
        if self.rotations:
            raise ValueError(f"--rotations has no effect with {beside}; leave it out")

    def _refuse_style_image(self) -> None:
        if self.stroke != StylizeConfig.stroke:
            raise ValueError("--stroke has no effect with --reference; leave it out")
        if self.stroke_by_depth:
            raise ValueError("--stroke-by-depth has no effect with --reference; leave it out")
        if self.style_scale != StylizeConfig.style_scale:
            raise ValueError("--style-scale has no effect with --reference; leave it out")
        if self.keep_frame and not self.style:
            raise ValueError("--keep-frame has no effect with --reference; leave it out")

    def _check_weights(self, *names: str) -> None:
        for name in names:
            if getattr(self, name) < 0 and getattr(self, name) != -1:
                raise ValueError(f"{name} must be at least 0 (or -1: by method and scene)")


@dataclass(frozen=True)
class ArfConfig(StylizeConfig):
    """ARF: the colors learn one view per step."""

    rays: str = option(
        "auto",
        choices=("auto", "full", "deferred", "dilated", "random", "patch"),
        help="which rays of a view get gradients (auto: dilated for desrf on views over 256 pixels, else deferred)",
    )
    detail_rate: float = advanced(
        -1.0,
        GRID,
        help="learning rate of its finest level, relative to levels at least five times coarser (-1: 0.1 for a smooth "
        "style image to 1 for rough paint); views under 512 pixels slow fewer levels, and less",
    )
    margin: float = advanced(
        0.3,
        RAYS,
        help="captures: also stylize views this much wider on each side than the photos, where "
        "camera paths may look (0: the photos' views alone)",
    )
    dilation: int = advanced(
        2, RAYS, help="with dilated, train every Nth ray in both axes; with random and patch, as many rays"
    )
    blur: int = advanced(
        0, RAYS, help="box filter on the image gradient before rays are picked, odd (DeSRF: 3; 0: none)"
    )
    remember: bool = advanced(True, RAYS, help="reuse the view's last render for rays without gradients")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0 < self.detail_rate <= 1 or self.detail_rate == -1):
            raise ValueError("detail_rate must be over 0 and at most 1 (or -1: by the style image)")
        if not 0 <= self.margin <= 1:
            raise ValueError("margin must be in 0..1")
        if self.dilation < 1:
            raise ValueError("dilation must be at least 1")
        if self.blur < 0 or (self.blur > 0 and self.blur % 2 == 0):
            raise ValueError("blur must be odd, or 0 for none: an even box would shift the image by half a pixel")
        every_ray = self.rays in ("full", "deferred") or (self.rays == "auto" and not isinstance(self, DesrfConfig))
        if every_ray and (self.dilation, self.blur, self.remember) != (ArfConfig.dilation, ArfConfig.blur, True):
            raise ValueError("--dilation, --blur and --no-remember need --rays dilated, random or patch")


@dataclass(frozen=True)
class DesrfConfig(ArfConfig):
    """DeSRF: ARF, and a deformation of the shapes."""

    method: str = option("desrf", choices=METHODS, help="desrf: colors and shapes")
    bend: float = option(1.0, help="how far shapes bend relative to the default, 0.25 to 4")
    deform_rate: float = advanced(-1.0, SHAPES, help="learning rate of the deformation (-1: 0.06, for objects 0.024)")
    displacement_weight: float = advanced(0.0, SHAPES, help="weight of the displacement's root mean square")
    displacement_vertices: int = advanced(32, SHAPES, help="vertices per side of the deformation's grid")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.25 <= self.bend <= 4:
            raise ValueError("bend must be 0.25 to 4")
        if not (self.deform_rate > 0 or self.deform_rate == -1) or not 4 <= self.displacement_vertices <= 128:
            raise ValueError("deform_rate must be > 0 (or -1: by scene), displacement_vertices 4 to 128")
        if self.displacement_weight < 0:
            raise ValueError("displacement_weight must be at least 0")


@dataclass(frozen=True)
class SnerfConfig(StylizeConfig):
    """SNeRF: images are optimized in 2D, then the field learns them, in rounds."""

    method: str = option("snerf", choices=METHODS, help="snerf: images and field in turn")
    rounds: int = option(
        3, help="rounds of image steps, then field steps, that share the budget (at least two steps each)"
    )
    image_by: str = option(
        "gram",
        choices=("gram", "features"),
        help="style loss of the images: Gram matrices, or features as in --match-by",
    )
    image_share: float = option(
        0.75, help="fraction of a round spent on images (with a step budget at most half, each view once)"
    )
    image_steps: int = advanced(5, IMAGES, help="steps per visit to an image")
    image_rate: float = advanced(0.03, IMAGES, help="learning rate of an image's pixels")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rounds < 1 or self.image_steps < 1:
            raise ValueError("rounds and image_steps must be at least 1")
        steps = budget_of(self.budget)[1]
        if 0 < steps < 2 * self.rounds:
            raise ValueError(
                f"--budget {steps} leaves no step for the field in some of {self.rounds} rounds; give at least "
                f"{2 * self.rounds} steps, or fewer --rounds"
            )
        if self.image_by == "gram":
            self._refuse_matching("--image-by gram")
            if self.gram_weight != -1:
                raise ValueError("--image-by gram compares Gram matrices alone; leave --gram-weight out")
        if not 0 < self.image_share < 1 or self.image_rate <= 0:
            raise ValueError("image_share must be between 0 and 1, image_rate > 0")


@dataclass(frozen=True)
class RefNprConfig(ArfConfig):
    """Ref-NPR: from views that are given stylized, or made so here."""

    method: str = option("refnpr", choices=METHODS, help="refnpr: from stylized views")
    reference: tuple[str, ...] = option(
        (), metavar="VIEW=FILE", help="a training view and its stylized image; repeatable", digest="references_digest"
    )
    references_digest: str = ""  # sha256 of the references
    decoder_digest: str = ""  # of the weights that `--reference-by adain` decodes with
    reference_by: str = option(
        "",
        choices=("", "gram", "features", "adain"),
        metavar="gram|features|adain",
        help="how to make a reference if none is given: optimize its pixels by Gram matrices or as in --match-by, or "
        "run AdaIN (default: features)",
    )
    reference_view: str = option(
        "", help="view to make the reference from (default: the one that shares most with the others)"
    )
    detail_rate: float = advanced(
        1.0, GRID, help="learning rate of its finest level, relative to levels at least five times coarser"
    )
    margin: float = advanced(
        0.0, RAYS, help="captures: also stylize views this much wider on each side than the photos"
    )
    reference_steps: int = advanced(
        60, REFERENCE, help="optimization steps of a made reference, at most a third of the budget"
    )
    image_rate: float = advanced(0.03, REFERENCE, help="learning rate of a made reference's pixels")
    reference_weight: float = advanced(
        1.0, REFERENCE, help="weight of the squared color error on rays of the reference and rays registered to it"
    )

    @property
    def references(self) -> tuple[str, ...]:
        return self.reference

    @property
    def optimizes_reference(self) -> bool:
        """Whether a reference is made by optimizing its pixels; otherwise it is given, or decoded by AdaIN."""
        return not self.reference and self.reference_by != "adain"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.reference and self.style and self.match in ("auto", "none"):
            raise ValueError("with --reference, --style has no effect unless --match before takes its colors")
        if self.reference and (self.reference_by or self.reference_view):
            raise ValueError("--reference gives the stylized views; --reference-by and --reference-view make one")
        if self.reference or self.reference_by in ("gram", "adain"):
            self._refuse_matching("--reference" if self.reference else f"--reference-by {self.reference_by}")
        if not self.optimizes_reference:
            source = "--reference" if self.reference else "--reference-by adain"
            if self.reference_steps != RefNprConfig.reference_steps or self.image_rate != RefNprConfig.image_rate:
                raise ValueError(f"--reference-steps and --image-rate have no effect with {source}; leave them out")
            if self.coarse != -1:
                raise ValueError(f"--coarse has no effect with {source}; leave it out")
        views = [file_of(text)[0] for text in self.reference]
        if len(set(views)) < len(views):
            raise ValueError(f"a view has two references: {', '.join(views)}")
        if self.reference_steps < 1 or self.image_rate <= 0 or self.reference_weight < 0:
            raise ValueError("reference_steps must be at least 1, image_rate > 0, reference_weight at least 0")
        for name in ("structure_weight", "gram_weight", "grain_weight"):
            if getattr(self, name) != -1:
                raise ValueError(f"--{name.replace('_', '-')} has no effect with --method refnpr; leave it out")


CONFIGS: dict[str, type[StylizeConfig]] = {
    "arf": ArfConfig,
    "desrf": DesrfConfig,
    "snerf": SnerfConfig,
    "refnpr": RefNprConfig,
}


def refuse_foreign(method: str, names: Iterable[str]) -> None:
    """Refuse options that only other methods have. names: of the options, with underscores.

    Raises:
        ValueError: Naming the option and its methods.
    """
    own = {item.name for item in fields(CONFIGS[method])}
    for name in names:
        owners = [other for other, config in CONFIGS.items() if name in {item.name for item in fields(config)}]
        if name not in own and owners:
            flag = "--" + name.replace("_", "-")
            raise ValueError(f"{flag} is an option of --method {', '.join(owners)}; this is --method {method}")
