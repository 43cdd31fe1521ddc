"""Cameras of COLMAP models, of 3D Gaussian splatting's cameras.json and of Nuke's .chan, for `render --path`."""

import math
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.safe_names import printable
from schemas.safe_reading import read_text
from stages.artifacts.placed_cameras import CameraFile, check_count, checked, in_scene
from stages.artifacts.scene import SceneData
from stages.readers import model_folders
from stages.readers.checked_values import entry_of, number, row, size
from stages.readers.colmap_model import read_model
from stages.readers.source import natural
from stylerf.errors import InvalidValue
from stylerf.geometry import distortion
from stylerf.geometry.camera_conventions import from_colmap, from_opengl, with_last_row
from stylerf.geometry.cameras import Camera

MOST_CHAN = 64 << 20  # bytes


def read_colmap(path: Path, scene: SceneData, where: str) -> CameraFile:
    """Read the cameras of a COLMAP model in a folder or its sparse/0, by the names of the photos."""
    folders = model_folders(path)
    if not folders:
        raise BadInput(f"{where} is a folder without a COLMAP model (cameras and images, also in sparse/0)")
    try:
        model = read_model(folders[0])
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from error
    check_count(len(model.images), where)
    cameras, bent = [], 0
    for index, image in enumerate(sorted(model.images, key=lambda one: natural(one.name))):
        lens, name = model.cameras[image.camera], f"{where}: {printable(image.name)}"
        try:
            intrinsics, warp = distortion.from_colmap(lens.model, list(lens.params))
            pose = in_scene(from_colmap(image.camera_from_world), scene, name)
            cameras.append(Camera(f"{index:04d}", lens.width, lens.height, *intrinsics, pose))
        except InvalidValue as error:
            raise BadInput(f"{name}: {error}") from error
        bent += not warp.none
    remarks = model.remarks
    if bent:
        remarks += (f"{bent} cameras of {path.name} have a lens distortion, which renders leave out",)
    return CameraFile(cameras, remarks)


def is_3dgs(content: object) -> bool:
    """Return whether a JSON document looks like cameras.json of 3D Gaussian splatting."""
    first = content[0] if isinstance(content, list) and content else None
    return isinstance(first, dict) and {"position", "rotation"} <= first.keys()


def read_3dgs(content: list, scene: SceneData, where: str) -> CameraFile:
    """Read {position, rotation, width, height, fx, fy} each: camera-to-world, OpenCV axes, centered principal point."""
    check_count(len(content), where)
    cameras = []
    for index, entry in enumerate(content):
        name = f"{where}: camera {index}"
        center, rows = row(entry_of(entry, "position", name), 3, f"{name}: position"), entry_of(entry, "rotation", name)
        if not isinstance(rows, list) or len(rows) != 3:
            raise BadInput(f"{name}: rotation is no 3x3 matrix")
        rotation = np.stack([row(one, 3, f"{name}: rotation") for one in rows])
        pose = with_last_row(np.concatenate([rotation, center[:, None]], axis=1))
        width, height = size(entry, name)
        try:
            lens = number(entry, "fx", name), number(entry, "fy", name), width / 2, height / 2
            cameras.append(Camera(f"{index:04d}", width, height, *lens, in_scene(pose, scene, name)))
        except InvalidValue as error:
            raise BadInput(f"{name}: {error}") from error
    return CameraFile(cameras)


def read_chan(path: Path, scene: SceneData, where: str) -> CameraFile:
    """Read lines of frame, position, Euler angles and vertical field of view, in degrees; rotation order ZXY, y up.

    Pictures have the size of the scene's first view, and without a field of view its lens.
    """
    from scipy.spatial.transform import Rotation

    like, cameras = scene.cameras[0], []
    lines = [line for line in read_text(path, MOST_CHAN).splitlines() if line.strip() and not line.startswith("#")]
    check_count(len(lines), where)
    for index, line in enumerate(lines):
        name = f"{where}: line {index + 1}"
        try:
            values = [float(word) for word in line.split()]
        except ValueError:
            values = []
        if len(values) not in (7, 8) or not all(map(math.isfinite, values)):
            raise BadInput(
                f"{name} is {printable(line)[:40]!r}, expected frame tx ty tz rx ry rz and the vertical field of view"
            )
        _, x, y, z, rx, ry, rz, *angle = values
        if angle and not 0 < angle[0] < 180:
            raise BadInput(f"{name}: the field of view is {angle[0]:g} degrees, expected 0 to 180")
        pose = np.eye(4)
        # Turned about z, then x, then y: R = Ry Rx Rz.
        pose[:3, :3] = Rotation.from_euler("YXZ", [ry, rx, rz], degrees=True).as_matrix()
        pose[:3, 3] = x, y, z
        focal = like.height / 2 / math.tan(math.radians(angle[0]) / 2) if angle else like.fy
        lens = focal * like.fx / like.fy, focal, like.width / 2, like.height / 2
        placed = in_scene(from_opengl(checked(pose, name)), scene, name, "y")
        try:
            cameras.append(Camera(f"{index:04d}", like.width, like.height, *lens, placed))
        except InvalidValue as error:
            raise BadInput(f"{name}: {error}") from error
    return CameraFile(cameras, (
        f"{path.name} is taken to have y up, rotation order ZXY and pictures of {like.width}x{like.height}, which "
        "a .chan does not state",
    ))  # fmt: skip
