"""Options of `stylerf render`."""

import re
from dataclasses import dataclass
from pathlib import Path

from stages.configs import advanced, option

OWN_VIEWS = ("train", "test", "views")  # paths of the scene's own views; "views": both others
SLOWEST_FPS = 1 / 1001  # video containers store the rate as a fraction with a denominator up to 1001


@dataclass(frozen=True)
class RenderConfig:
    """What is rendered, along which path, to which files."""

    path: str = option(
        "orbit",
        metavar="test|train|views|orbit|spiral|interpolate|FILE",
        help="cameras: the scene's own views; a path around, in front of or through them; or a file: "
        "frames.json, camera_path.json, transforms.json, cameras.json, .chan, USD, or a COLMAP model's folder "
        "(docs/artifacts.md)",
        digest="path_digest",
    )
    path_digest: str = ""
    count: int = option(60, help="number of frames of an orbit, spiral or interpolated path")
    frames: str = option("", metavar="A-B", help="render only frames A to B of the path, counted from 0: a shard")
    scale: float = option(1.0, help="image size relative to the scene's views")
    exr: bool = option(True, help="write OpenEXR: R G B A, Z, rayDistance.Z")
    regions: bool = option(True, help="write the work folder's regions as EXR channels mask.<name>")
    masks: bool = advanced(False, help="also write the regions as PNG, masks/<name>/NNNN.png")
    depth: bool = advanced(False, help="also write color-mapped depth")
    displacement: bool = advanced(False, help="also write the color-mapped displacement of a deformed field")
    video: bool = option(False, help="also write a video: MP4 (extra `video`), else GIF")
    fps: float = advanced(24.0, help="frames per second of the video")

    def __post_init__(self) -> None:
        frames_of(self.frames, 1 << 30)
        if self.count < 1 or not 0 < self.scale <= 8 or not SLOWEST_FPS <= self.fps <= 240:
            raise ValueError("count must be at least 1, scale in (0, 8] and fps in [1/1001, 240]")
        if self.masks and not self.regions:
            raise ValueError("masks are pictures of the regions, which no-regions leaves out")

    @property
    def shows_regions(self) -> bool:
        """Whether regions are written anywhere."""
        return self.regions and (self.exr or self.masks)


def label_of(path: str) -> str:
    """What frames along a path are named after: the path, or the name of its file as an artifact's may be written."""
    return re.sub(r"[^A-Za-z0-9._+-]+", "_", Path(path).stem)


def frames_of(text: str, count: int) -> range:
    """'10-19' -> range(10, 20), '7' -> range(7, 8), '' -> all; cut at `count`. ValueError for anything else."""
    if not text:
        return range(count)
    match = re.fullmatch(r"(\d+)(?:-(\d+))?", text)
    if not match or int(match[2] or match[1]) < int(match[1]):
        raise ValueError(f"frames {text!r} is neither a number nor a span A-B with A <= B")
    return range(int(match[1]), min(count, int(match[2] or match[1]) + 1))
