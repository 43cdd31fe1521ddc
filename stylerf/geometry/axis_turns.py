"""Turns between coordinate systems whose up is another axis, exact: signed permutations of the axes."""

import numpy as np

UP_AXES = {"y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}


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
