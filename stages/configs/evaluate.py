"""Options of `stylerf eval`."""

from dataclasses import dataclass

from stages.configs import advanced, option
from stages.configs.view_syntax import file_of

CONSISTENCY = ("correct", "laenerf-script", "stylerf-family", "all")
SMALLEST_SIDE = 64  # pixels: below it the deepest layers of the networks have nothing left to see


@dataclass(frozen=True)
class EvaluateConfig:
    """What is measured and how much of it is shown."""

    style: str = option(
        "",
        help="style image to compare a stylized field with (default: the one it was made with)",
        digest="style_digest",
    )
    style_digest: str = ""
    features: str = advanced(
        "",
        "style",
        help="network for the style distances: a name or a file of VGG weights",
        digest="networks",
    )
    style_side: int = advanced(256, "style", help="longer side in pixels at which render and style image are compared")
    perceptual: str = advanced(
        "auto",
        "perceptual metrics",
        choices=("auto", "none"),
        help="auto: all perceptual metrics whose weights are available",
    )
    networks: str = ""  # names and digests of the networks that are used
    consistency: str = option(
        "correct",
        choices=CONSISTENCY,
        help="protocol of multi-view consistency: correct (with a visibility test), laenerf-script (LAENeRF's "
        "released script, bugs included), stylerf-family (softmax splatting), or all",
    )
    flow: str = advanced(
        "",
        "consistency",
        metavar="DIR",
        help="folder of optical flow, FROM_to_TO.flo or .npy by frame number (default: from depth and poses)",
        digest="flow_digest",
    )
    flow_digest: str = ""
    reference: tuple[str, ...] = option(
        (),
        metavar="VIEW=FILE",
        help="stylized image of a view, for Ref-LPIPS with the nearest test views",
        digest="reference_digest",
    )
    reference_digest: str = ""
    gap: int = advanced(7, "consistency", help="distance between the two views of a long-range pair, in frames")
    pairs: int = advanced(24, "consistency", help="maximum number of pairs per range, evenly spread (0: all)")
    perceptual_pairs: int = advanced(
        8, "consistency", help="maximum number of pairs per range for the perceptual distance (0: all)"
    )
    depth_tolerance: float = advanced(0.02, "consistency", help="maximum relative depth difference of a visible pixel")
    masks: str = advanced(
        "",
        "local edit",
        metavar="DIR",
        help="masks of a local edit: images with the views' names, white where edited",
        digest="masks_digest",
    )
    masks_digest: str = ""
    margin: int = advanced(
        2, "local edit", help="width in pixels of the border around a region that counts as neither (with --masks: 0)"
    )
    ring: int = advanced(8, "local edit", help="width in pixels of the ring around a region where bleeding is measured")
    train_views: bool = advanced(False, "local edit", help="also measure a local edit on the training views")
    ceiling: int = advanced(
        0,
        "style",
        metavar="STEPS",
        help="also stylize the contact sheet's views in 2D with the field's style loss, as a ceiling (0: no; 60 steps "
        "take a minute per view)",
    )
    sheet: int = option(6, help="views on the contact sheet: the worst, the best, and others evenly spread")

    def __post_init__(self) -> None:
        for text in self.reference:
            file_of(text)
        for flag, value, smallest in (
            ("--gap", self.gap, 2), ("--pairs", self.pairs, 0), ("--sheet", self.sheet, 1),
            ("--perceptual-pairs", self.perceptual_pairs, 0), ("--style-side", self.style_side, SMALLEST_SIDE),
            ("--margin", self.margin, 0), ("--ring", self.ring, 1), ("--ceiling", self.ceiling, 0),
        ):  # fmt: skip
            if value < smallest:
                raise ValueError(f"{flag} {value}: expected at least {smallest}")
        if not 0 < self.depth_tolerance < 1:
            raise ValueError(f"--depth-tolerance {self.depth_tolerance:g}: expected a share between 0 and 1")
