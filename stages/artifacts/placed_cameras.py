"""Cameras of files, from the coordinates of the file to scene units."""

from dataclasses import dataclass

import numpy as np

from schemas.errors import BadInput
from stages.artifacts.scene import SceneData
from stages.artifacts.world_axes import file_from_scene
from stylerf.errors import InvalidValue
from stylerf.geometry.camera_conventions import checked_pose
from stylerf.geometry.cameras import Camera
from stylerf.geometry.scene_normalization import moved

MOST_CAMERAS = 100_000  # more than an hour of film


@dataclass(frozen=True, eq=False)
class CameraFile:
    """Cameras in scene units, in frame order, and remarks for the user on how they were read, one line each."""

    cameras: list[Camera]
    remarks: tuple[str, ...] = ()


def in_scene(pose: np.ndarray, scene: SceneData, where: str, up: str = "") -> np.ndarray:
    """Return a pose of the scene's source in scene units.

    Args:
        pose: [4, 4], OpenCV axes.
        where: begins messages.
        up: y or z where the file's coordinates are the source's turned so that this axis is up.

    Raises:
        BadInput: it is not a pose.
    """
    return moved(checked(pose, where), np.linalg.inv(file_from_scene(scene, "source", up)))


def checked(pose: np.ndarray, where: str) -> np.ndarray:
    """Return a pose with an exact rotation; BadInput if its matrix is not a rotation."""
    try:
        return checked_pose(pose)
    except InvalidValue as error:
        raise BadInput(f"{where}: {error}") from error


def check_count(count: int, where: str) -> None:
    """Reject more cameras than a file can sensibly contain."""
    if count > MOST_CAMERAS:
        raise BadInput(f"{where} lists {count:,} cameras; at most {MOST_CAMERAS:,} can be read")
