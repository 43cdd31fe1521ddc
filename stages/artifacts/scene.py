"""Reads a scene artifact into cameras and images, and finds the space it is fitted in."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from schemas.errors import ArtifactDamaged, BadInput
from schemas.exr import read_depth
from schemas.images import image_channels, read_image
from schemas.manifest import MANIFEST
from schemas.safe_reading import sound
from schemas.scene import POINTS_FILE, SCENE_FILE, Bounds, Scene, View, read_scene
from schemas.tensors import load_tensors
from schemas.work_folder import Artifact, sources_of
from stylerf import validation
from stylerf.editing.extraction import check_pixels
from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.srgb import exposed

EXPOSURE_STOPS = "exposure_stops"  # among the figures of a fit: by view
MOST_STOPS = 64
EDIT_TARGETS = "edit/targets.safetensors"  # of a scene whose photos show an edit: which pixels, and their depths
EARLIER = "earlier_"  # prefix of the names of what earlier edits left there
_TARGET = re.compile(rf"([0-9]{{1,9}})\.({EARLIER})?(pixels|depth)")


@dataclass(frozen=True, eq=False)
class Points:
    """Sparse points of the capture. xyz: [n, 3] float32 scene units, rgb: [n, 3] uint8, error: [n] float32 pixels."""

    xyz: np.ndarray
    rgb: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, eq=False)
class SceneData:
    """A scene ready for use; images and depths are read on demand. stops: how much to darken each view's photo.

    retaken: the image of a view, by its index, if that is not its photo.
    """

    artifact: Artifact
    scene: Scene
    cameras: list[Camera]
    points: Points | None
    stops: Mapping[str, float] = field(default_factory=dict)
    retaken: Callable[[int], np.ndarray] | None = None

    @property
    def folder(self) -> Path:
        """Of the artifact."""
        return self.artifact.path

    @property
    def views(self) -> tuple[View, ...]:
        """The views in the order of `cameras`."""
        return self.scene.views

    @property
    def splits(self) -> dict[str, list[int]]:
        """Indices of the views by split: `train` and `test`."""
        return {name: self.scene.split(name) for name in ("train", "test")}

    @property
    def layout(self) -> str:
        """object, forward or unbounded."""
        return self.scene.layout

    @property
    def bounds(self) -> Bounds:
        """Box, near and far in scene units."""
        return self.scene.bounds

    @property
    def background(self) -> str:
        """alpha (images are RGBA, to be composited by the reader), white, black or none."""
        return self.scene.background

    def images(self, index: int) -> np.ndarray:
        """Image of view `index`, [height, width, 3 or 4] float32, sRGB 0..1, straight alpha; gray becomes RGB.

        ArtifactDamaged if it is missing, damaged or does not have its camera's size.
        """
        if self.retaken:
            return self.retaken(index)
        view = self.views[index]
        try:
            pixels = read_image(self.artifact.file(view.image)).pixels
        except BadInput as error:
            raise ArtifactDamaged(f"{error}; run `stylerf import` again") from error
        if pixels.shape[:2] != (view.height, view.width):
            raise ArtifactDamaged(
                f"{self.folder / view.image} is {pixels.shape[1]}x{pixels.shape[0]}, but its camera expects "
                f"{view.width}x{view.height}; run `stylerf import` again"
            )
        pixels = pixels if pixels.shape[2] >= 3 else np.repeat(pixels, 3, axis=2)
        return exposed(pixels, -self.stops[view.name]) if view.name in self.stops else pixels

    def as_stored(self, index: int) -> bool:
        """Whether images(index) is the unchanged content of its file."""
        return self.retaken is None and self.views[index].name not in self.stops

    @property
    def exposure_figures(self) -> dict[str, dict[str, float]]:
        """For the manifest of what is trained on these photos: how they were taken, even if the fit is deleted.

        Photos that show an edit all have one exposure and do not reveal the original ones.
        """
        return {} if self.artifact.has(EDIT_TARGETS) else {EXPOSURE_STOPS: dict(self.stops)}

    def channels(self, index: int) -> int:
        """3 or 4: the channels of images(index), according to the file's header."""
        try:
            return max(3, image_channels(self.artifact.file(self.views[index].image)))
        except BadInput as error:
            raise ArtifactDamaged(f"{error}; run `stylerf import` again") from error

    def truth_depth(self, index: int) -> np.ndarray | None:
        """Known planar depth of view `index`, [height, width] float32 scene units; None if there is none."""
        relative = self.scene.truth.depth_file(index)
        if relative is None or not self.artifact.has(relative):
            return None
        try:
            depth = read_depth(self.artifact.file(relative))
        except BadInput as error:
            raise ArtifactDamaged(f"{error}; run `stylerf import` again") from error
        view = self.views[index]
        if depth.shape != (view.height, view.width):
            raise ArtifactDamaged(
                f"{self.folder / relative} does not match its camera's size; run `stylerf import` again"
            )
        return depth


def load_scene(artifact: Artifact, seen_by: Artifact | None = None) -> SceneData:
    """Load and check the scene of an artifact; ArtifactDamaged if a file is missing or a camera is impossible.

    seen_by: an artifact made from a field; photos are then brought to the single exposure that its fit found for them.
    """
    artifact.check_sizes()
    scene = read_scene(artifact.file(SCENE_FILE).parent)
    for view in scene.views:
        artifact.file(view.image)
    try:
        cameras = [_camera(view) for view in scene.views]
    except InvalidValue as error:
        raise ArtifactDamaged(f"{artifact.path}: {error}; run `stylerf import` again") from error
    # Photos that show an edit were brought to it when the edit was distilled.
    stops = _stops(seen_by) if seen_by and not artifact.has(EDIT_TARGETS) else {}
    points = _points(artifact.file(POINTS_FILE)) if artifact.has(POINTS_FILE) else None
    return SceneData(artifact, scene, cameras, points, stops)


def view_index(scene: SceneData, name: str, option: str) -> int:
    """Return the index of a view by name, or by its number in the scene written as #12; BadInput suggests some names.

    A bare number is a name: the name of a missing photo must not select the photo with that index.
    """
    names = [view.name for view in scene.views]
    if name in names:
        return names.index(name)
    number = name.removeprefix("#")
    if number != name and number.isdecimal() and int(number) < len(names):
        return int(number)
    ordered = sorted({*names, name})
    at = ordered.index(name)
    some = [*ordered[max(0, at - 3) : at], *ordered[at + 1 : at + 4]] if len(names) > 6 else names
    known = f"{'the nearest of ' if len(names) > 6 else ''}the scene's {len(names)} views are {', '.join(some)}"
    raise BadInput(f"{option}: view {name!r} not found; {known}; `stylerf show WORK/scene/main` lists all")


def spread(views: list[int], count: int) -> list[int]:
    """Return `count` of the views, evenly spread: the middle one of each of `count` equal parts."""
    return [views[int((k + 0.5) * len(views) / count)] for k in range(count)]


def _stops(seen_by: Artifact) -> dict[str, float]:
    """Return by how many stops each view is overexposed, from the fit behind `seen_by`; empty if all are alike."""
    for made in [seen_by, *sources_of(seen_by, ("field",))]:
        if (stops := made.manifest.figures.get(EXPOSURE_STOPS)) is not None:
            with sound(made.path / MANIFEST, f"valid {EXPOSURE_STOPS}"):
                return {name: validation.number(stops, name, -MOST_STOPS, MOST_STOPS) for name in stops}
    return {}


def _camera(view: View) -> Camera:
    pose = np.array(view.world_from_camera)
    return Camera(view.name, view.width, view.height, view.fx, view.fy, view.cx, view.cy, pose)


def _points(path: Path) -> Points:
    tensors, _ = load_tensors(path)
    with sound(path, "a valid list of points"):
        xyz = validation.array(tensors, "xyz", np.float32, (None, 3))
        rgb = validation.array(tensors, "rgb", np.uint8, (len(xyz), 3))
        return Points(xyz, rgb, validation.array(tensors, "error", np.float32, (len(xyz),), most=None))


@dataclass(frozen=True, eq=False)
class EditTarget:
    """What an edit left of one view in EDIT_TARGETS: pixels [n] int64, row-major; depth [n] float32: sum(w t)."""

    pixels: np.ndarray
    depth: np.ndarray


def edit_targets(scene: SceneData) -> dict[tuple[int, str], EditTarget]:
    """Return the contents of EDIT_TARGETS by view index and "" for the last edit or EARLIER; ArtifactDamaged if they
    are invalid. Empty if the scene has no edit."""
    if not scene.artifact.has(EDIT_TARGETS):
        return {}
    path = scene.artifact.file(EDIT_TARGETS)
    arrays, _ = load_tensors(path)
    found = {}
    with sound(path, "valid edit targets"):
        for name in arrays:
            if not (match := _TARGET.fullmatch(name)) or int(match[1]) >= len(scene.cameras):
                raise InvalidValue(f"the array {name} belongs to no view of the scene")
            index, part, what = int(match[1]), match[2] or "", match[3]
            if what == "pixels":
                pixels = validation.array(arrays, name, np.int64, (None,))
                camera = scene.cameras[index]
                check_pixels(pixels, name, camera.width, camera.height)
                depth = validation.array(arrays, f"{index}.{part}depth", np.float32, (len(pixels),))
                found[index, part] = EditTarget(pixels, depth)
    return found


KIND_OF_LAYOUT = {"object": "box", "forward": "frustum", "unbounded": "contraction"}
_MARGIN = 1.02
# Half a side of a contraction's uncontracted box, in units of the cameras' distance from their subject. What is between
# the two is seldom the subject, and half of every axis goes to the box (decision 0042).
FOCUS = 0.6


def space_of(scene: SceneData, wanted: str) -> tuple[SpaceWarp, str]:
    """Return the warp and the reason as text. wanted: a kind, or auto for the one of the scene's layout.

    BadInput if the scene's bounds and cameras, although valid individually, enclose no volume.
    """
    try:
        return _space_of(scene, wanted)
    except InvalidValue as error:
        raise BadInput(
            f"{scene.folder}: its bounds and cameras enclose no volume to fit in ({error}); import it again"
        ) from error


def _space_of(scene: SceneData, wanted: str) -> tuple[SpaceWarp, str]:
    bounds = scene.bounds
    kind = KIND_OF_LAYOUT[scene.layout] if wanted == "auto" else wanted
    reason = f"{scene.layout} layout ({scene.scene.layout_reason})" if wanted == "auto" else "as requested"
    if kind == "box":
        return SpaceWarp.box(*bounds.aabb), reason
    if kind == "contraction":
        low, high = np.asarray(bounds.aabb)
        # An unbounded scene's box reaches as far as its cameras; other scenes know the contents of theirs.
        middle, half = (low + high) / 2, (FOCUS if scene.layout == "unbounded" else 1.0) * (high - low) / 2
        far = max(bounds.far, 1e3)
        return SpaceWarp.box(middle - half, middle + half, near=bounds.near, far=far, kind="contraction"), reason
    half_width, half_height = _frustum_sides(scene, bounds.near)
    centers = np.array([camera.world_from_camera[:3, 3] for camera in scene.cameras])
    parallax = np.ptp(centers, axis=0)[:2].max() / bounds.near
    return SpaceWarp.frustum(half_width, half_height, bounds.near, max(bounds.far, 1e4), parallax), reason


def _frustum_sides(scene: SceneData, near: float) -> tuple[float, float]:
    """Return the largest |x/z| and |y/z| that any view's corner sees beyond `near`, in the average camera's frame."""
    slopes = []
    for camera in scene.cameras:
        corners = np.array([[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]], float)
        for depth in (near, 4 * near, 1000 * near):
            points = camera.unproject(corners, np.full(4, depth))
            slopes.append(np.abs(points[:, :2]) / np.maximum(points[:, 2:], near / 2))
    widest = np.concatenate(slopes).max(0) * _MARGIN
    return float(widest[0]), float(widest[1])
