"""Nuke's .chan: one line per frame with position, Euler angles and vertical field of view.

Angles are degrees, rotation order ZXY, Nuke's default for cameras: a point is turned about z, then x, then y, so that
the rotation is Ry Rx Rz. Cameras look along -z, y up. The file states neither the order nor the frame rate.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from schemas.atomic_write import write_bytes
from stages.exporting.camera_lists import opengl_pose, vertical_fov
from stylerf.geometry.cameras import Camera

COLUMNS = "frame tx ty tz rx ry rz vertical_fov"


def write_chan(path: Path, cameras: list[Camera]) -> None:
    """Write cameras in the coordinates of the file; the first is frame 1."""
    lines = []
    for frame, camera in enumerate(cameras, start=1):
        pose = opengl_pose(camera)
        ry, rx, rz = Rotation.from_matrix(pose[:3, :3]).as_euler("YXZ", degrees=True)
        values = np.array([*pose[:3, 3], rx, ry, rz, vertical_fov(camera)])
        lines.append(f"{frame} " + " ".join(f"{value:.12g}" for value in values))
    write_bytes(path, ("\n".join(lines) + "\n").encode())
