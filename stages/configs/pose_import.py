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
        help="folder of photos to use in place of the source's own, such as images_8; its photos may be smaller, "
        "in the same subfolders or none",
        digest="source_digest",
    )
    frames: int = option(FRAMES, help="frames to choose from video, even in motion and sharp")
    cameras: str = option(
        "",
        metavar="PATH",
        help="cameras that see the splats, if not the cameras.json beside them: such a list, a COLMAP model or a "
        "transforms.json",
        digest="source_digest",
    )
    downscale: float = option(1.0, help="divide the photos' sides by this")
    max_side: int = option(0, help="limit the photos' longer side to this many pixels (0: no limit)")
    layout: str = option(
        "auto",
        choices=("auto", "object", "forward", "unbounded"),
        help="arrangement of the capture (auto: decided from cameras and transparency)",
    )
    background: str = option(
        "auto",
        choices=("auto", "alpha", "white", "black", "none"),
        help="background of the object (auto: alpha if there is any, else from the image borders)",
    )
    test_every: int = option(8, help="hold out every Nth photo for tests if the source has no split (0: none)")
    matching: str = advanced(
        "auto",
        "structure from motion",
        choices=("auto", "exhaustive", "sequential"),
        help="structure from motion compares "
        "all pairs of photos, or neighbors in a video (auto: all pairs up to 80 photos)",
    )
    sfm_side: int = advanced(
        1600,
        "structure from motion",
        help="structure from motion looks at copies whose longer side has at most so many pixels",
    )
    sfm_features: int = advanced(2048, "structure from motion", help="and at so many features in each")
    one_camera: bool = advanced(
        True, "structure from motion", help="photos of one size, lens and zoom share their intrinsics"
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
