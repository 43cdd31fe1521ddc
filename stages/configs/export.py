"""Options of `stylerf export`."""

from dataclasses import dataclass
from typing import Any

from stages.configs import advanced, option
from stages.configs.fit import budget_of
from stages.configs.render import OWN_VIEWS, SLOWEST_FPS

# Formats of each kind of export, the default ones first.
FORMATS: dict[str, tuple[str, ...]] = {
    "mesh": ("glb", "obj", "ply"),
    "splats": ("ply", "spz", "glb", "usdc", "usda"),
    "cameras": ("transforms", "colmap", "camera-path", "3dgs", "chan", "usd", "colmap-text"),
    "shot": ("usdc", "usda"),
}
DEFAULT_FORMATS = {"mesh": 1, "splats": 1, "cameras": 2, "shot": 1}  # how many of them are written if none are named
MOST_SPLATS = 5_000_000
WITH_PHOTOS = ("transforms", "colmap", "colmap-text")  # formats that list the photos of their cameras
_LISTED = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in FORMATS.items())
_ALONG_PATHS = ("cameras", "shot")


@dataclass(frozen=True)
class ExportConfig:
    """What is exported, to which files."""

    kind: str = option("mesh", flag="--as", choices=tuple(FORMATS), help="what to export (default: mesh)")
    formats: str = option(
        "", flag="--format", metavar="F,F...",
        help=f"formats, separated by commas; {_LISTED} (default: the first, of cameras the first two)",
    )  # fmt: skip
    units: str = option(
        "source", choices=("source", "scene"), help="coordinates of the photos' source, or normalized scene units"
    )
    path: str = option(
        "", metavar="views|train|test|orbit|spiral|interpolate|FILE",
        help="cameras to export, as in render (default: views; orbit for a shot)", digest="path_digest",
    )  # fmt: skip
    path_digest: str = ""
    geometry: str = option("mesh", choices=("mesh", "splats"), help="representation of the field in a shot")
    count: int = option(60, help="number of frames of an orbit, spiral or interpolation")
    fps: float = option(24.0, help="frames per second of camera paths")
    photos: bool = option(True, help="copy the scene's photos beside transforms.json and COLMAP models of its views")
    faces: int = option(200_000, help="maximum number of triangles of a mesh (0: no limit)")
    resolution: int = option(256, help="cells per side of the marching-cubes grid, averaged over the axes")
    keep_pieces: bool = option(False, help="keep small disconnected pieces of a mesh")
    splats: int = option(300_000, help="maximum number of splats")
    budget: str = option("2m", help="time (60s, 2m) or number of steps for optimizing splats")
    reach: float = advanced(
        8.0, help="extent of a mesh: multiples of a capture's inner box, or of the nearest depth if forward-facing"
    )
    meters_per_unit: float = advanced(1.0, help="length of a unit in USD files, meters")

    def __post_init__(self) -> None:
        unknown = [name for name in self.chosen if name not in FORMATS[self.kind]]
        if unknown or len(set(self.chosen)) < len(self.chosen):
            what = f"{unknown[0]!r} is unknown" if unknown else "one is named twice"
            raise ValueError(f"--format of --as {self.kind} takes any of {', '.join(FORMATS[self.kind])}: {what}")
        if self.count < 1 or not SLOWEST_FPS <= self.fps <= 240 or not 0 < self.meters_per_unit <= 1e6:
            raise ValueError("count must be at least 1, fps in [1/1001, 240] and meters-per-unit in (0, 1e6]")
        if not (16 <= self.resolution <= 1024 and 1 < self.reach <= 1e4 and (self.faces == 0 or self.faces >= 100)):
            raise ValueError("resolution must be 16 to 1024, reach in (1, 1e4], and faces 0 or at least 100")
        if not 100 <= self.splats <= MOST_SPLATS:
            raise ValueError(f"splats must be 100 to {MOST_SPLATS:,}")
        budget_of(self.budget)
        if idle := self._idle():
            raise ValueError(f"{idle} has no effect on an export --as {self.kind} of {', '.join(self.chosen)}")

    def _idle(self) -> str:
        """Return the first option that is set, but has no effect on this kind of export; "" without one."""
        own = self.along in OWN_VIEWS
        splats = self.kind == "splats" or (self.kind == "shot" and self.geometry == "splats")
        mesh = self.kind == "mesh" or (self.kind == "shot" and not splats)
        usd = self.kind == "shot" or bool({"usd", "usda", "usdc"} & set(self.chosen))
        used = {
            "path": self.kind in _ALONG_PATHS,
            "count": self.kind in _ALONG_PATHS and not own,
            "fps": self.kind == "shot" or bool({"camera-path", "chan", "usd"} & set(self.chosen)),
            "photos": self.kind == "cameras" and own and bool(set(WITH_PHOTOS) & set(self.chosen)),
            "meters_per_unit": usd,
            "geometry": self.kind == "shot",
            "splats": splats,
            "budget": splats,
        } | dict.fromkeys(("faces", "resolution", "keep_pieces", "reach"), mesh)
        defaults: Any = ExportConfig.__dataclass_fields__
        idle = [name for name, there in used.items() if not there and getattr(self, name) != defaults[name].default]
        return ("--" + idle[0].replace("_", "-")) if idle else ""

    @property
    def chosen(self) -> tuple[str, ...]:
        """The formats to write."""
        if not self.formats:
            return FORMATS[self.kind][: DEFAULT_FORMATS[self.kind]]
        return tuple(name.strip() for name in self.formats.split(","))

    @property
    def along(self) -> str:
        """The path of the cameras, with the default filled in; "" where the export has none."""
        return self.path or {"cameras": "views", "shot": "orbit"}.get(self.kind, "")
