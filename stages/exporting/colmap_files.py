"""COLMAP models of pinhole cameras, written by pycolmap."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from stages.artifacts.scene import Points
from stylerf.geometry.cameras import Camera


def write_model(
    folder: Path, cameras: list[Camera], points: Points | None, photo: Callable[[Camera], str], text: bool
) -> None:
    """Write cameras, images and points3D (and rigs and frames, as this version of COLMAP does) into `folder`.

    Args:
        cameras: in the coordinates of the model. Equal lenses are one camera of the model.
        points: in the same coordinates; without tracks.
        photo: name of a camera's photo.
        text: write text files instead of binary ones.
    """
    import pycolmap

    model = pycolmap.Reconstruction()
    lenses: dict[tuple, int] = {}
    for number, one in enumerate(cameras, start=1):
        lens = (one.width, one.height, one.fx, one.fy, one.cx, one.cy)
        if lens not in lenses:
            lenses[lens] = len(lenses) + 1
            model.add_camera_with_trivial_rig(pycolmap.Camera(
                camera_id=lenses[lens], model="PINHOLE", width=one.width, height=one.height, params=list(lens[2:])
            ))  # fmt: skip
        image = pycolmap.Image(name=photo(one), camera_id=lenses[lens], image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.linalg.inv(one.world_from_camera)[:3]))
    for xyz, rgb in zip(points.xyz, points.rgb, strict=True) if points else ():
        model.add_point3D(xyz.astype(np.float64), pycolmap.Track(), rgb)
    folder.mkdir(parents=True)
    (model.write_text if text else model.write_binary)(folder)
