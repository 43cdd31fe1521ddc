"""The coordinates of exported files: source or scene units, as they are or rotated so that y or z is up.

Rotations are exact: signed permutations of the axes.
"""

import numpy as np

from stages.artifacts.scene import SceneData

UP_AXES = {"y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}


def file_from_scene(scene: SceneData, units: str, up: str = "") -> np.ndarray:
    """Return the similarity [4, 4] from scene units to the coordinates of a file.

    Args:
        units: source or scene.
        up: axis that is up in the file, y or z; "": not rotated.
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


def nearest_axis(direction: np.ndarray) -> np.ndarray:
    """Return the positive or negative coordinate axis [3] nearest to a direction [3]."""
    axis = np.zeros(3)
    largest = int(np.argmax(np.abs(direction)))
    axis[largest] = 1.0 if direction[largest] >= 0 else -1.0
    return axis


def turn_up(up: np.ndarray, to: str) -> np.ndarray:
    """Return the rotation [3, 3] by quarter turns that takes the axis `up` [3] to that named `to`, y or z.

    Up z to y is (x, y, z) -> (x, z, -y), as glTF exporters do; up -y to y, of COLMAP's cameras, (x, -y, -z).
    """
    wanted = UP_AXES[to]
    if np.array_equal(up, wanted):
        return np.eye(3)
    if np.array_equal(up, -wanted):
        return np.diag([1.0, -1.0, -1.0])  # a half turn about x, whichever of the two is up
    across = np.cross(up, wanted)
    turn: np.ndarray = np.outer(wanted, up) - np.outer(up, wanted) + np.outer(across, across)
    return turn
