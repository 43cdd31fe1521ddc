"""Options of `stylerf eval`."""

from dataclasses import dataclass

from stages.configs import option
from stages.configs.views import file_of

CONSISTENCY = ("correct", "laenerf-script", "stylerf-family", "all")
SMALLEST_SIDE = 64  # pixels: below it the deepest layers of the networks have nothing left to see


@dataclass(frozen=True)
class EvaluateConfig:
    """What is measured and how much of it is shown."""

    style: str = option(
        "",
        help="painting to measure a stylized field against (default: the one it was made with)",
        digest="style_digest",
    )
    style_digest: str = ""
    features: str = option(
        "", advanced=True, group="style", help="feature trunk of the style distances: a name or a file of VGG weights"
    )
    style_side: int = option(
        256, advanced=True, group="style", help="longer side, in pixels, at which render and painting are compared"
    )
    perceptual: str = option(
        "auto",
        advanced=True,
        group="perceptual metrics",
        choices=("auto", "none"),
        help="perceptual distances where their weights are here",
    )
    networks: str = ""
    consistency: str = option(
        "correct",
        choices=CONSISTENCY,
        help="protocol of consistency between views: correct (visibility tested), laenerf-script (as LAENeRF's "
        "released script, faults included), stylerf-family (softmax splatting), or all three",
    )
    flow: str = option(
        "",
        advanced=True,
        group="consistency",
        metavar="DIR",
        help="optical flow from files FROM_to_TO.flo or .npy, numbered as the frames (default: by depth and poses)",
        digest="flow_digest",
    )
    flow_digest: str = ""
    reference: tuple[str, ...] = option(
        (),
        metavar="VIEW=FILE",
        help="stylized picture of a view of the scene, for Ref-LPIPS against the test views nearest to it",
        digest="reference_digest",
    )
    reference_digest: str = ""
    gap: int = option(7, advanced=True, group="consistency", help="frames between the two views of a long-range pair")
    pairs: int = option(
        24, advanced=True, group="consistency", help="most pairs of views measured per range, evenly spread (0: all)"
    )
    perceptual_pairs: int = option(
        8,
        advanced=True,
        group="consistency",
        help="most pairs per range measured by the perceptual distance too (0: all)",
    )
    depth_tolerance: float = option(
        0.02,
        advanced=True,
        group="consistency",
        help="relative depth difference up to which a warped pixel counts as visible",
    )
    masks: str = option(
        "",
        advanced=True,
        group="local edit",
        metavar="DIR",
        help="masks of a local edit: pictures named like views, white: edited",
        digest="masks_digest",
    )
    masks_digest: str = ""
    margin: int = option(
        2,
        advanced=True,
        group="local edit",
        help="pixels around a region, as its cells tell it, that do not count as background",
    )
    ring: int = option(
        8,
        advanced=True,
        group="local edit",
        help="width in pixels of the ring around a region where bleeding is measured",
    )
    train_views: bool = option(
        False, advanced=True, group="local edit", help="measure a local edit on the training views too"
    )
    sheet: int = option(6, help="views on the contact sheet: the worst, the best, and others evenly spread")

    def __post_init__(self) -> None:
        for text in self.reference:
            file_of(text)
        for flag, value, least in (
            ("--gap", self.gap, 2), ("--pairs", self.pairs, 0), ("--sheet", self.sheet, 1),
            ("--perceptual-pairs", self.perceptual_pairs, 0), ("--style-side", self.style_side, SMALLEST_SIDE),
            ("--margin", self.margin, 0), ("--ring", self.ring, 1),
        ):  # fmt: skip
            if value < least:
                raise ValueError(f"{flag} {value}: expected at least {least}")
        if not 0 < self.depth_tolerance < 1:
            raise ValueError(f"--depth-tolerance {self.depth_tolerance:g}: expected a share between 0 and 1")
