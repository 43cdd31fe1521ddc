"""Options of `stylerf render`."""

import re
from dataclasses import dataclass
from pathlib import Path

from stages.configs import advanced, option

OWN_VIEWS = ("train", "test", "views")  # paths of the scene's own views; "views": both others
COLORSPACES = ("lin_rec709", "acescg")  # the keys of schemas.color_spaces.COLOR_SPACES
DEEP_SAMPLES, MOST_DEEP_SAMPLES = 8, 256
MEASURABLE = {"colorspace": "lin_rec709", "plate": False}  # frames that `eval` can compare with the scene's pictures
SLOWEST_FPS = 1 / 1001  # video containers store the rate as a fraction with a denominator up to 1001


@dataclass(frozen=True)
class RenderConfig:
    """What is rendered, along which path, to which files."""

    path: str = option(
        "orbit",
        metavar="test|train|views|orbit|spiral|interpolate|FILE",
        help="the scene's views, a generated path, or a camera file: "
        "frames.json, camera_path.json, transforms.json, cameras.json, .chan, USD, or a COLMAP model's folder "
        "(docs/artifacts.md)",
        digest="path_digest",
    )
    path_digest: str = ""
    count: int = option(60, help="number of frames of an orbit, spiral or interpolation")
    frames: str = option("", metavar="A-B", help="render only frames A to B of the path, counted from 0: a shard")
    scale: float = option(1.0, help="image size relative to the scene's views, or with --plate to the photos")
    strength: float = option(1.0, metavar="S", help="stylization strength, from 0 (the unstylized field) to 1")
    exr: bool = option(True, help="write OpenEXR: R G B A, Z, rayDistance.Z")
    regions: bool = option(True, help="write regions as EXR channels mask.<name>")
    cryptomatte: bool = option(False, help="also write regions as Cryptomatte (EXR layers crypto_region00, ...)")
    colorspace: str = option("lin_rec709", choices=COLORSPACES, help="linear color space of EXR files")
    deep: bool = option(False, help="also write deep EXR, deep/NAME.exr, with the samples along each ray (CPU only)")
    deep_samples: int = advanced(DEEP_SAMPLES, help="maximum number of deep samples per pixel; closest ones are merged")
    plate: bool = option(
        False, help="render the scene's views with lens distortion at the photos' full size, to match the plates"
    )
    st_map: bool = option(False, help="also write ST maps, per lens, that undistort the photos and redistort renders")
    masks: bool = advanced(False, help="also write regions as PNG, masks/<name>/NNNN.png")
    depth: bool = advanced(False, help="also write color-mapped depth")
    displacement: bool = advanced(False, help="also write the color-mapped displacement of a deformed field")
    video: bool = option(False, help="also write a video: MP4 (extra `video`), else GIF")
    fps: float = advanced(24.0, help="frames per second of the video")

    def __post_init__(self) -> None:
        frames_of(self.frames, 1 << 30)
        if self.count < 1 or not 0 < self.scale <= 8 or not SLOWEST_FPS <= self.fps <= 240:
            raise ValueError("count must be at least 1, scale in (0, 8] and fps in [1/1001, 240]")
        if not 0 <= self.strength <= 1:
            raise ValueError(f"strength must be 0 to 1, not {self.strength:g}")
        if self.masks and not self.regions:
            raise ValueError("--masks writes the regions, which --no-regions leaves out")
        if self.cryptomatte and not (self.exr and self.regions):
            raise ValueError("--cryptomatte writes the regions to EXR, which --no-exr or --no-regions leaves out")
        if self.colorspace not in COLORSPACES:
            raise ValueError(f"colorspace must be one of {', '.join(COLORSPACES)}")
        if self.colorspace != COLORSPACES[0] and not (self.exr or self.deep):
            raise ValueError("--colorspace is that of EXR files, which --no-exr leaves out; PNG is always sRGB")
        if not 1 <= self.deep_samples <= MOST_DEEP_SAMPLES:
            raise ValueError(f"--deep-samples must be 1 to {MOST_DEEP_SAMPLES}")
        if self.deep_samples != DEEP_SAMPLES and not self.deep:
            raise ValueError("--deep-samples has no effect without --deep")
        if self.deep and self.strength < 1:
            raise ValueError("--deep needs --strength 1: below it, the finished pixels of two fields are mixed")
        if (self.plate or self.st_map) and self.path not in OWN_VIEWS:
            wanted = "--plate" if self.plate else "--st-map"
            raise ValueError(f"{wanted} needs views that have photos: --path must be one of {', '.join(OWN_VIEWS)}")

    @property
    def shows_regions(self) -> bool:
        """Whether regions are written anywhere."""
        return self.regions and (self.exr or self.masks)


def label_of(path: str) -> str:
    """What frames along a path are named after: the path, or the name of its file as an artifact's may be written."""
    return re.sub(r"[^A-Za-z0-9._+-]+", "_", Path(path).stem).strip("._+-") or "path"


def frames_of(text: str, count: int) -> range:
    """'10-19' -> range(10, 20), '7' -> range(7, 8), '' -> all; cut at `count`. ValueError for anything else."""
    if not text:
        return range(count)
    match = re.fullmatch(r"(\d+)(?:-(\d+))?", text)
    if not match or int(match[2] or match[1]) < int(match[1]):
        raise ValueError(f"frames {text!r} is neither a number nor a span A-B with A <= B")
    return range(int(match[1]), min(count, int(match[2] or match[1]) + 1))
