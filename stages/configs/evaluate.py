"""Options of `stylerf eval`."""

from dataclasses import dataclass

from stages.configs import option
from stages.configs.views import file_of

CONSISTENCY = ("correct", "laenerf-script", "stylerf-family", "all")
SMALLEST_SIDE = 64  # pixels: smaller images vanish in the deepest layers of the networks


@dataclass(frozen=True)
class EvaluateConfig:
    """What is measured, how, and how much of it is shown."""

    style: str = option(
        "",
        help="style image to compare a stylized field with (default: the one it was made with)",
        digest="style_digest",
    )
    style_digest: str = option("", help="sha256 of that image (filled in; detects a changed file)")
    features: str = option("", help="feature network of the style distances: a name or a file of VGG weights")
    style_side: int = option(256, help="longer side in pixels at which render and style image are compared")
    perceptual: str = option(
        "auto", choices=("auto", "none"), help="auto: perceptual distances whose weights are available"
    )
    networks: str = option("", help="names and digests of the networks found (filled in; detects a change)")
    consistency: str = option(
        "correct",
        choices=CONSISTENCY,
        help="protocol of multi-view consistency: correct (with a visibility test), laenerf-script (LAENeRF's released "
        "script, bugs included), stylerf-family (softmax splatting), or all",
    )
    flow: str = option(
        "",
        metavar="DIR",
        help="folder of optical flow, FROM_to_TO.flo or .npy by frame number (default: from depth and poses)",
        digest="flow_digest",
    )
    flow_digest: str = option("", help="sha256 of those files (filled in; detects a change)")
    reference: tuple[str, ...] = option(
        (),
        metavar="VIEW=FILE",
        help="stylized image of a view, for Ref-LPIPS against the nearest test views",
        digest="reference_digest",
    )
    reference_digest: str = option("", help="sha256 of those images (filled in; detects a change)")
    gap: int = option(7, help="frames between the two views of a long-range pair")
    pairs: int = option(24, help="maximum number of pairs per range, evenly spread (0: all)")
    perceptual_pairs: int = option(8, help="maximum number of pairs per range for the perceptual distance (0: all)")
    depth_tolerance: float = option(0.02, help="maximum relative depth difference of a visible pixel")
    masks: str = option(
        "",
        metavar="DIR",
        help="masks of a local edit: images named like the views, white where edited",
        digest="masks_digest",
    )
    masks_digest: str = option("", help="sha256 of those masks (filled in; detects a change)")
    margin: int = option(2, help="pixels around a region that are not counted as background")
    ring: int = option(8, help="width in pixels of the ring around a region where bleeding is measured")
    train_views: bool = option(False, help="also measure a local edit on the training views")
    sheet: int = option(6, help="number of views on the contact sheet: the worst, the best, others evenly spread")

    def __post_init__(self) -> None:
        for text in self.reference:
            file_of(text)
        for flag, value, minimum in (
            ("--gap", self.gap, 2), ("--pairs", self.pairs, 0), ("--sheet", self.sheet, 1),
            ("--perceptual-pairs", self.perceptual_pairs, 0), ("--style-side", self.style_side, SMALLEST_SIDE),
            ("--margin", self.margin, 0), ("--ring", self.ring, 1),
        ):  # fmt: skip
            if value < minimum:
                raise ValueError(f"{flag} {value}: expected at least {minimum}")
        if not 0 < self.depth_tolerance < 1:
            raise ValueError(f"--depth-tolerance {self.depth_tolerance:g}: expected a fraction between 0 and 1")
