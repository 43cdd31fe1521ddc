"""Camera lists: nerfstudio's transforms.json and camera_path.json, cameras.json of 3D Gaussian splatting, Nuke's .chan,
COLMAP models.

Cameras are in the coordinates of the file, with OpenCV axes; the writers turn them to the axes of each format.
"""

import math
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from schemas.atomic_write import write_bytes, write_json
from stages.artifacts.scene import Points
from stylerf.geometry.cameras import Camera

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_SPLITS = {"train": ("train_filenames",), "test": ("val_filenames", "test_filenames")}
CHAN_COLUMNS = "frame tx ty tz rx ry rz vertical_fov"


def opengl_pose(camera: Camera) -> np.ndarray:
    """Return camera-to-world [4, 4] with x right, y up, z backward."""
    pose: np.ndarray = camera.world_from_camera @ _OPENGL_FROM_OPENCV
    return pose


def vertical_fov(camera: Camera) -> float:
    """Return the vertical field of view about the image's center, degrees: 2 atan(height / (2 fy))."""
    return math.degrees(2 * math.atan(camera.height / (2 * camera.fy)))


def write_transforms(path: Path, cameras: list[Camera], splits: dict[str, str], photo: str) -> None:
    """Write nerfstudio's transforms.json, each frame with its own lens.

    Args:
        splits: train, test or "" by camera name; listed if any is known.
        photo: pattern of file_path; {} is the camera's name.
    """
    frames = [
        {
            "file_path": photo.format(one.name), "w": one.width, "h": one.height, "fl_x": one.fx, "fl_y": one.fy,
            "cx": one.cx, "cy": one.cy, "transform_matrix": opengl_pose(one).tolist(),
        }
        for one in cameras
    ]  # fmt: skip
    lists = {
        key: [photo.format(one.name) for one in cameras if splits[one.name] == split]
        for split, keys in _SPLITS.items()
        if any(splits.values())
        for key in keys
    }
    write_json(path, {"camera_model": "PINHOLE", "frames": frames, **lists})


def write_camera_path(path: Path, cameras: list[Camera], fps: float) -> None:
    """Write nerfstudio's camera_path.json, for a frame that its dataparser has not changed."""
    entries = [
        {
            "camera_to_world": opengl_pose(one).ravel().tolist(), "fov": vertical_fov(one),
            "aspect": one.width / one.height,
        }
        for one in cameras
    ]  # fmt: skip
    write_json(path, {
        "camera_type": "perspective", "render_width": cameras[0].width, "render_height": cameras[0].height,
        "fps": fps, "seconds": len(cameras) / fps, "is_cycle": False, "smoothness_value": 0.0,
        "camera_path": entries,
    })  # fmt: skip


def write_3dgs(path: Path, cameras: list[Camera]) -> None:
    """Write cameras.json as the reference code of 3D Gaussian splatting does: rotation camera-to-world, OpenCV axes."""
    write_json(path, [
        {
            "id": index, "img_name": one.name, "width": one.width, "height": one.height,
            "position": one.center.tolist(), "rotation": one.world_from_camera[:3, :3].tolist(),
            "fy": one.fy, "fx": one.fx,
        }
        for index, one in enumerate(cameras)
    ])  # fmt: skip


def write_chan(path: Path, cameras: list[Camera]) -> None:
    """Write Nuke's .chan: a line per frame (from 1) with position, Euler angles and vertical field of view.

    Angles are degrees, rotation order ZXY, Nuke's default for cameras: a point is turned about z, then x, then y, so
    that the rotation is Ry Rx Rz. Cameras look along -z, y up. The file records neither the order nor the frame rate.
    Of the angles that describe one rotation, each frame has those nearest to the previous frame, so that they
    interpolate.
    """
    lines = []
    angles = np.zeros(3)
    for frame, camera in enumerate(cameras, start=1):
        pose = opengl_pose(camera)
        angles = _nearest_angles(pose[:3, :3], angles)
        values = np.array([*pose[:3, 3], *angles, vertical_fov(camera)])
        lines.append(f"{frame} " + " ".join(f"{value:.12g}" for value in values))
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _nearest_angles(rotation: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the angles rx, ry, rz, degrees, of the rotation Ry Rx Rz [3, 3] that are nearest to those `before`."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock", UserWarning)  # rz is 0 then, which is right too
        ry, rx, rz = Rotation.from_matrix(rotation).as_euler("YXZ", degrees=True)
    equal = np.array([[rx, ry, rz], [180 - rx, ry + 180, rz + 180]])
    equal += 360 * np.round((before - equal) / 360)
    nearest: np.ndarray = equal[np.abs(equal - before).sum(1).argmin()]
    return nearest


def write_colmap(
    folder: Path, cameras: list[Camera], points: Points | None, photo: Callable[[Camera], str], text: bool
) -> None:
    """Write a COLMAP model of pinhole cameras into `folder` by pycolmap: cameras, images, points3D, rigs and frames.

    Args:
        cameras: in the coordinates of the model. Equal lenses are one camera of the model.
        points: in the same coordinates; without tracks.
        photo: name of a camera's photo.
        text: write text files instead of binary ones.
    """
    from stylerf.environment.colmap import pycolmap

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
