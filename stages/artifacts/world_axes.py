"""The coordinates of exported files: source or scene units, as they are or turned so that y or z is up."""

import numpy as np

from stages.artifacts.scene import SceneData
from stylerf.geometry.axis_turns import nearest_axis, turn_up


def file_from_scene(scene: SceneData, units: str, up: str = "") -> np.ndarray:
    """Return the similarity [4, 4] from scene units to the coordinates of a file.

    Args:
        units: source or scene.
        up: axis that is up in the file, y or z; "": not turned.
    """
    matrix = np.linalg.inv(np.array(scene.scene.scene_from_source)) if units == "source" else np.eye(4)
    if not up:
        return matrix
    turn = np.eye(4)
    turn[:3, :3] = turn_up(nearest_axis(matrix[:3, :3] @ _up_of(scene)), up)
    return turn @ matrix


def scale_of(similarity: np.ndarray) -> float:
    """Return the scale of a similarity [4, 4]."""
    return float(np.cbrt(np.linalg.det(similarity[:3, :3])))


def applied(similarity: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Apply a similarity [4, 4] to points [n, 3]."""
    moved: np.ndarray = points @ similarity[:3, :3].T + similarity[:3, 3]
    return moved


def _up_of(scene: SceneData) -> np.ndarray:
    """Return up in scene units: -y where the mean camera is upright (stylerf/geometry/scene_normalization.facing)."""
    return np.array([0.0, -1.0, 0.0]) if scene.layout == "forward" else np.array([0.0, 0.0, 1.0])
