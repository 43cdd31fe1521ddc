"""scene.json: the views of a scene, their cameras, the lenses of their photos, and facts about the capture.

Camera axes are OpenCV's (x right, y down, z forward); pixel (i, j) has its center at (i + 0.5, j + 0.5).
"""

import math
import re
from collections import Counter
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from schemas.atomic_write import write_json
from schemas.errors import ArtifactDamaged, BadInput
from schemas.json_numbers import FOCAL_LENGTHS, LARGEST, LARGEST_PICTURE, LARGEST_SIDE, matrix, number, numbers, whole
from schemas.safe_names import relative_path
from schemas.safe_reading import read_json

SCENE_FILE = "scene.json"
POINTS_FILE = "points.safetensors"
LAYOUTS = ("object", "forward", "unbounded")
BACKGROUNDS = ("alpha", "white", "black", "none")
SPLITS = ("train", "test")
OTHER_LENSES = ("fov", "division", "eucm", "thin_prism_fisheye", "rad_tan_thin_prism_fisheye")
LENS_KINDS = ("brown", "fisheye", *OTHER_LENSES)
MOST_COEFFICIENTS = 12
LARGEST_COEFFICIENT = 1e12  # k3 of a lens of 20 picture widths is beyond 1e6
LARGEST_PHOTO_SIDE = 1 << 20  # pixels; photos may be larger than the pictures made from them
_NUMBER_IN_PATTERN = re.compile(r"0+(?=\.[^./]*$)")

Matrix = tuple[tuple[float, ...], ...]


def as_matrix(values: Any) -> Matrix:
    """Convert a 4x4 array or nested list to nested tuples of floats; ValueError for any other shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (4, 4):
        raise ValueError(f"expected a 4x4 matrix, found {array.shape}")
    return tuple(tuple(float(value) for value in row) for row in array)


@dataclass(frozen=True)
class LensDistortion:
    """Distortion of normalized image coordinates; geometry/distortion.py has the formulas.

    Attributes:
        kind: brown (OpenCV's), fisheye (Kannala-Brandt), or one of OTHER_LENSES.
        radial, denominator: Coefficients of the polynomials of r^2 (brown) or theta^2 (fisheye, radial only).
        tangential: p1, p2.
        others: Parameters of OTHER_LENSES, in COLMAP's order.
    """

    kind: str = "brown"
    radial: tuple[float, ...] = ()
    tangential: tuple[float, ...] = (0.0, 0.0)
    denominator: tuple[float, ...] = ()
    others: tuple[float, ...] = ()


@dataclass(frozen=True)
class Lens:
    """A photo, upright: its size, its intrinsics in pixels, and the distortion that import has removed."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: LensDistortion


@dataclass(frozen=True)
class View:
    """One image and its camera.

    Attributes:
        image: Path inside the artifact.
        fx, fy, cx, cy: Pixels.
        world_from_camera: 4x4, scene units.
        source: The path of the user's file.
        lens: Of the photo that the image was made from; None if unknown.
    """

    name: str
    image: str
    split: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_from_camera: Matrix
    source: str = ""
    lens: Lens | None = None


@dataclass(frozen=True)
class Bounds:
    """The extent of the scene, in scene units.

    Attributes:
        aabb: Lower and upper corner of the object (layout `object`), of the part that is not contracted (`unbounded`),
            or of the frustum volume (`forward`).
        near, far: Planar depths that enclose everything visible.
    """

    aabb: tuple[tuple[float, float, float], tuple[float, float, float]]
    near: float
    far: float


@dataclass(frozen=True)
class Skipped:
    """An image of the source that is left out of the scene, and why."""

    source: str
    reason: str


@dataclass(frozen=True)
class Truth:
    """Ground truth of a synthetic scene.

    Attributes:
        depth: Pattern of planar-depth EXRs; its last run of zeros is replaced by the view's index:
            `truth/depth_000.exr` means `truth/depth_007.exr` for view 7.
    """

    depth: str | None = None

    def depth_file(self, index: int) -> str | None:
        """Return the depth file of view `index`, None without ground truth."""
        if self.depth is None:
            return None
        return _NUMBER_IN_PATTERN.sub(lambda zeros: str(index).zfill(len(zeros.group())), self.depth)


@dataclass(frozen=True)
class Scene:
    """The contents of scene.json. scene_from_source: 4x4 similarity (scale*R | t) from source world to scene units."""

    views: tuple[View, ...]
    layout: str
    layout_reason: str
    bounds: Bounds
    background: str
    scene_from_source: Matrix
    skipped: tuple[Skipped, ...] = ()
    truth: Truth = field(default_factory=Truth)
    sfm: dict[str, Any] | None = None

    def split(self, name: str) -> list[int]:
        """Return the indices of the views of a split, `train` or `test`."""
        return [index for index, view in enumerate(self.views) if view.split == name]


def validate_scene(scene: Scene) -> None:
    """Check everything that later stages rely on; BadInput names the first problem."""
    if not scene.views:
        raise BadInput("a scene needs at least one view; it has none")
    counts = Counter(view.name for view in scene.views)
    if twice := [name for name, count in counts.items() if count > 1]:
        raise BadInput(f"view names must be unique; {min(twice)!r} occurs {counts[min(twice)]} times")
    for view in scene.views:
        _validate_view(view)
    if scene.truth.depth is not None:
        relative_path(scene.truth.depth, "pattern of known depths", BadInput)
    _one_of(scene.layout, LAYOUTS, "layout")
    _one_of(scene.background, BACKGROUNDS, "background")
    bounds = scene.bounds
    corners = [*bounds.aabb[0], *bounds.aabb[1]]
    if not all(abs(value) <= LARGEST for value in corners):  # NaN fails this comparison
        raise BadInput(f"the scene's bounding box is not finite, or reaches beyond {LARGEST:g} units")
    if any(high - low < 1 / LARGEST for low, high in zip(*bounds.aabb, strict=True)):
        raise BadInput(f"the scene's bounding box {bounds.aabb} is empty: each lower corner must be below the upper")
    if not 1 / LARGEST <= bounds.near < bounds.far <= LARGEST:
        raise BadInput(
            f"near and far must satisfy 0 < near < far < {LARGEST:g}; they are {bounds.near:g} and {bounds.far:g}"
        )
    similarity = np.array(scene.scene_from_source)
    if not np.isfinite(similarity).all() or not np.linalg.det(similarity[:3, :3]) > 0:
        raise BadInput("scene_from_source is not an invertible similarity")


def _validate_view(view: View) -> None:
    # Renders are named after the view, so its name must not lead out of their folder.
    where = f"view {relative_path(view.name, 'name of a view', BadInput)}"
    relative_path(view.image, f"{where}: its image", BadInput)
    _one_of(view.split, SPLITS, f"{where}: split")
    if view.width < 1 or view.height < 1:
        raise BadInput(f"{where}: size {view.width}x{view.height} is empty")
    if max(view.width, view.height) > LARGEST_SIDE or view.width * view.height > LARGEST_PICTURE:
        raise BadInput(
            f"{where}: size {view.width}x{view.height}; at most {LARGEST_SIDE} pixels a side and "
            f"{LARGEST_PICTURE / 1e6:.0f} million in total are supported"
        )
    shortest, longest = FOCAL_LENGTHS
    if not all(math.isfinite(value) for value in (view.cx, view.cy)) or max(abs(view.cx), abs(view.cy)) > LARGEST:
        raise BadInput(f"{where}: its principal point {view.cx:g}, {view.cy:g} is far outside the picture")
    if not all(shortest <= value <= longest for value in (view.fx, view.fy)):
        raise BadInput(
            f"{where}: focal lengths must be positive, {shortest:g} to {longest:g} pixels, found {view.fx:g} and "
            f"{view.fy:g}"
        )
    pose = np.array(view.world_from_camera)
    if not np.isfinite(pose).all():
        raise BadInput(f"{where}: its pose contains NaN or infinity")
    if np.abs(pose[:3, 3]).max() > LARGEST:
        raise BadInput(f"{where}: its camera is {np.abs(pose[:3, 3]).max():g} units away; the limit is {LARGEST:g}")
    rotation = pose[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0:
        raise BadInput(f"{where}: the upper left 3x3 of its pose is not a rotation")
    if not np.allclose(pose[3], [0, 0, 0, 1]):
        raise BadInput(f"{where}: the last row of its pose is {pose[3].tolist()}, expected 0 0 0 1")
    try:
        lens_of(view.lens and asdict(view.lens), f"{where}: lens")
    except (ValueError, TypeError, KeyError) as error:
        raise BadInput(str(error)) from error


def _one_of(value: str, allowed: tuple[str, ...], what: str) -> None:
    if value not in allowed:
        raise BadInput(f"{what} is {value!r}; expected one of {', '.join(allowed)}")


def write_scene(folder: Path, scene: Scene) -> None:
    """Validate the scene and write scene.json into `folder`."""
    validate_scene(scene)
    write_json(Path(folder) / SCENE_FILE, scene)


def read_scene(folder: Path) -> Scene:
    """Read scene.json in `folder`; ArtifactDamaged if it is missing or invalid."""
    path = Path(folder) / SCENE_FILE
    try:
        scene = _from_dict(read_json(path, ArtifactDamaged))
        validate_scene(scene)
    except FileNotFoundError:
        raise ArtifactDamaged(f"{path} is missing; run `stylerf import` again") from None
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, BadInput) as error:
        raise ArtifactDamaged(f"{path} is damaged ({error}); run `stylerf import` again") from error
    return scene


def _from_dict(content: dict[str, Any]) -> Scene:
    _known_only(content, Scene)
    views = []
    for entry in content["views"]:
        _known_only(entry, View)
        views.append(_view(entry))
    bounds = content["bounds"]
    (x0, y0, z0), (x1, y1, z1) = (numbers(corner, "a corner of bounds.aabb", 3) for corner in bounds["aabb"])
    aabb = ((x0, y0, z0), (x1, y1, z1))
    truth = Truth(**(content.get("truth") or {}))
    if not isinstance(truth.depth, (str, type(None))):
        raise ValueError("truth.depth is not a pattern of file names")
    return Scene(
        views=tuple(views),
        layout=content["layout"],
        layout_reason=content["layout_reason"],
        bounds=Bounds(aabb, number(bounds["near"], "bounds.near"), number(bounds["far"], "bounds.far")),
        background=content["background"],
        scene_from_source=matrix(content["scene_from_source"], "scene_from_source", 1e30),  # in any unit
        skipped=tuple(Skipped(**item) for item in content.get("skipped", ())),
        truth=truth,
        sfm=content.get("sfm"),
    )


def _view(entry: dict[str, Any]) -> View:
    where = f"view {entry['name']}"
    sides = {key: whole(entry[key], f"{where}: {key}", 1, LARGEST_SIDE) for key in ("width", "height")}
    lens = {key: number(entry[key], f"{where}: {key}") for key in ("fx", "fy", "cx", "cy")}
    pose = matrix(entry["world_from_camera"], f"{where}: world_from_camera")
    photo = lens_of(entry.get("lens"), f"{where}: lens")
    return View(**{**entry, **sides, **lens, "world_from_camera": pose, "lens": photo})


def _known_only(entry: Any, kind: type[Scene | View | Lens | LensDistortion]) -> None:
    if not isinstance(entry, dict):
        raise ValueError(f"a {kind.__name__} is not an object")
    if unknown := sorted(entry.keys() - {item.name for item in fields(kind)}):
        raise ValueError(f"unknown fields {', '.join(unknown)} in a {kind.__name__}")


def lens_of(entry: Any, where: str) -> Lens | None:
    """Check an entry of scene.json, null for none; ValueError, TypeError or KeyError if it is invalid."""
    if entry is None:
        return None
    _known_only(entry, Lens)
    width, height = (whole(entry[key], f"{where}: {key}", 1, LARGEST_PHOTO_SIDE) for key in ("width", "height"))
    fx, fy = (number(entry[key], f"{where}: {key}", *FOCAL_LENGTHS) for key in ("fx", "fy"))
    cx, cy = (number(entry[key], f"{where}: {key}") for key in ("cx", "cy"))
    return Lens(width, height, fx, fy, cx, cy, distortion_of(entry["distortion"], where))


def distortion_of(entry: Any, where: str) -> LensDistortion:
    """Check the distortion of a lens; ValueError, TypeError or KeyError if it is invalid."""
    _known_only(entry, LensDistortion)
    if entry["kind"] not in LENS_KINDS:
        raise ValueError(f"{where}: kind is not one of {', '.join(LENS_KINDS)}")
    lists = {key: _coefficients(entry[key], f"{where}: {key}") for key in ("radial", "tangential", "denominator")}
    if len(lists["tangential"]) != 2:
        raise ValueError(f"{where}: tangential has {len(lists['tangential'])} numbers, expected 2")
    return LensDistortion(entry["kind"], **lists, others=_coefficients(entry.get("others", ()), f"{where}: others"))


def _coefficients(values: Any, what: str) -> tuple[float, ...]:
    if not isinstance(values, (list, tuple)) or len(values) > MOST_COEFFICIENTS:
        raise ValueError(f"{what} is not a list of at most {MOST_COEFFICIENTS} numbers")
    return numbers(values, what, len(values), -LARGEST_COEFFICIENT, LARGEST_COEFFICIENT)
