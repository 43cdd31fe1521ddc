"""The cameras along a path: the scene's own views, a generated path, or those of a camera file."""

from pathlib import Path

from schemas.errors import BadInput
from stages.artifacts.camera_files import read_cameras
from stages.artifacts.scene import SceneData
from stages.configs.render import OWN_VIEWS, frames_of
from stylerf.geometry.camera_paths import PATHS, path_camera
from stylerf.geometry.cameras import Camera

Shot = tuple[Camera, int | None]


def shots_along(scene: SceneData, path: str, count: int, frames: str = "") -> list[Shot]:
    """Return the cameras along a path, each with the index of the scene's view that it repeats, or None.

    Args:
        path: train, test, views, one of PATHS or a camera file.
        count: frames of one of PATHS.
        frames: part of the path to return, as of `stylerf render --frames`.

    Raises:
        BadInput: the path has no such frames, or its file cannot be used.
    """
    splits = scene.splits
    own = dict(zip(OWN_VIEWS, (splits["train"], splits["test"], sorted(splits["train"] + splits["test"])), strict=True))
    if path in PATHS:
        cameras = [scene.cameras[i] for i in own["views"]]
        focus = focus_depth(scene)
        return [(path_camera(path, cameras, i, count, focus), None) for i in _chosen(path, frames, count)]
    if path in own:
        shots: list[Shot] = [(scene.cameras[i], i) for i in own[path]]
        if not shots:
            raise BadInput(f"{scene.folder}: the scene has no {path} views")
    else:
        shots = [(camera, None) for camera in read_cameras(Path(path), scene).cameras]
    return [shots[i] for i in _chosen(path, frames, len(shots))]


def _chosen(path: str, frames: str, count: int) -> range:
    chosen = frames_of(frames, count)
    if not len(chosen):
        raise BadInput(f"--frames {frames}: the path {path} has {count} frames, counted from 0")
    return chosen


def focus_depth(scene: SceneData) -> float:
    """Return the depth around which forward-facing paths turn: the mean of near and far in inverse depth."""
    bounds = scene.bounds
    return 1 / (0.5 * (1 / max(bounds.near, 1e-3) + 1 / max(bounds.far, bounds.near * 2)))
