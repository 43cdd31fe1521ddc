"""Options of `stylerf import`."""

from dataclasses import dataclass

from stages.configs import advanced, option

# Of poses that are read, in the order in which they are taken where several are there.
FORMATS = ("transforms", "colmap", "llff", "metashape", "opensfm", "polycam", "record3d")
FRAMES = 120


@dataclass(frozen=True)
class ImportOptions:
    """How posed photos become a scene."""

    format: str = option(
        "auto",
        choices=("auto", *FORMATS, "photos", "video", "splats"),
        help="format of the "
        "poses (auto: by the files that are there; photos, video: none, find them by structure from motion; "
        "splats: of 3D Gaussian splatting, seen from its cameras)",
    )
    images: str = option(
        "",
        metavar="FOLDER",
        help="use the photos of this folder, such as images_8, instead of the source's; they may be smaller, "
        "in the same subfolders or none",
        digest="source_digest",
    )
    frames: int = option(FRAMES, help="frames to pick from a video: sharp ones, evenly spaced in motion")
    cameras: str = option(
        "",
        metavar="PATH",
        help="cameras of the splats, if not the cameras.json beside them: another cameras.json, a COLMAP model or a "
        "transforms.json",
        digest="source_digest",
    )
    downscale: float = option(1.0, help="downscale the photos by this factor")
    max_side: int = option(0, help="limit the photos' longer side to this many pixels (0: no limit)")
    layout: str = option(
        "auto",
        choices=("auto", "object", "forward", "unbounded"),
        help="kind of capture (auto: from cameras and transparency)",
    )
    background: str = option(
        "auto",
        choices=("auto", "alpha", "white", "black", "none"),
        help="background of an object (auto: alpha if the photos have it, else from their borders)",
    )
    test_every: int = option(8, help="hold out every Nth photo as a test view if the source has no split (0: none)")
    matching: str = advanced(
        "auto",
        "structure from motion",
        choices=("auto", "exhaustive", "sequential"),
        help="photo pairs to match: all, or neighbors in a sequence (auto: all up to 80 photos)",
    )
    sfm_side: int = advanced(
        1600,
        "structure from motion",
        help="longer side, in pixels, that photos are downscaled to for feature detection",
    )
    sfm_features: int = advanced(2048, "structure from motion", help="maximum number of features per photo")
    one_camera: bool = advanced(
        True, "structure from motion", help="photos of the same size, lens and zoom share intrinsics"
    )

    def __post_init__(self) -> None:
        if self.frames < 3:
            raise ValueError(f"--frames {self.frames}: structure from motion needs at least 3")
        if not self.downscale >= 1:
            raise ValueError(f"--downscale {self.downscale:g}: expected 1 or more")
        if self.max_side < 0 or self.test_every < 0:
            raise ValueError("--max-side and --test-every must not be negative")
        if self.test_every == 1:
            raise ValueError("--test-every 1 leaves no photo to train on; give 2 or more, or 0 to keep none for tests")
        if self.sfm_side < 64 or self.sfm_features < 64:
            raise ValueError("--sfm-side and --sfm-features must be at least 64")


@dataclass(frozen=True)
class ImportConfig(ImportOptions):
    """The options with what they are applied to. source_digest: of every file that counts, see stages/readers."""

    source: str = option("", help="folder of the photos", digest="source_digest")
    source_digest: str = ""
