"""Camera files for `stylerf render --path`: a list in our own format, frames.json, nerfstudio's camera_path.json, any
transforms.json, COLMAP models, cameras.json of 3D Gaussian splatting, .chan and USD."""

import math
from pathlib import Path

import numpy as np

from schemas.canonical_json import digest_of, file_sha256
from schemas.errors import BadInput
from schemas.json_numbers import LARGEST_PICTURE, LARGEST_SIDE
from schemas.safe_names import check_utf8, printable
from schemas.safe_reading import read_json, read_text
from stages.artifacts.placed_cameras import CameraFile, check_count, checked, in_scene
from stages.artifacts.scene import SceneData
from stages.artifacts.usd_cameras import SUFFIXES, read_usd
from stages.readers import model_folders, transforms
from stages.readers.checked_values import entry_of, number, row, size
from stages.readers.colmap_model import files_of, read_model
from stages.readers.photos import lens_without_photo
from stages.readers.source import natural
from stylerf.errors import InvalidValue
from stylerf.geometry import distortion
from stylerf.geometry.camera_conventions import from_colmap, from_opengl, with_last_row
from stylerf.geometry.cameras import Camera
from stylerf.geometry.scene_normalization import moved

# Next to a camera_path.json: how nerfstudio rotated, shifted and scaled the frame of its source.
OF_NERFSTUDIO = "dataparser_transforms.json"
MOST_CHAN = 64 << 20  # bytes


def digest_of_cameras(path: Path) -> str:
    """Return the digest of the file or of a model's files, including the file with nerfstudio's frame if there is one.

    BadInput if the path is not UTF-8.
    """
    check_utf8(path)
    if path.is_dir():
        files = [one for folder in model_folders(path) for one in files_of(folder)]
        return digest_of([[one.name, file_sha256(one)] for one in files])
    beside = path.parent / OF_NERFSTUDIO
    return digest_of([file_sha256(path), file_sha256(beside)]) if beside.is_file() else file_sha256(path)


def read_cameras(path: Path, scene: SceneData) -> CameraFile:
    """Return the cameras of a file, in scene units; BadInput if its format is unknown or a camera is invalid."""
    where = f"--path {printable(str(path))}"
    if path.is_dir():
        return _checked_sizes(read_colmap(path, scene, where), where)
    if path.suffix.lower() == ".chan" and path.exists():
        return _checked_sizes(read_chan(path, scene, where), where)
    if path.suffix.lower() in SUFFIXES and path.exists():
        return _checked_sizes(read_usd(path, scene, where), where)
    try:
        content = read_json(path)
    except FileNotFoundError as error:
        raise BadInput(f"{where}: neither a known camera path nor an existing file") from error
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from error
    keys = content.keys() if isinstance(content, dict) else set()
    if "camera_path" in keys:
        found = _nerfstudio(content, path, scene, where)
    elif "frames" in keys:
        found = _transforms(path, scene, where)
    elif is_3dgs(content):
        found = read_3dgs(content, scene, where)
    elif isinstance(content, list) or "views" in keys:
        found = _ours(content if isinstance(content, list) else content["views"], scene.cameras[0], where)
    else:
        what = f"an object of {', '.join(map(printable, sorted(keys)[:6]))}" if keys else f"{content!r:.20}"
        raise BadInput(
            f"{where} is {what}; expected a list of cameras, each with world_from_camera, or an object with `views` "
            "(frames.json), `camera_path` (nerfstudio) or `frames` (transforms.json)"
        )
    return _checked_sizes(found, where)


def _checked_sizes(found: CameraFile, where: str) -> CameraFile:
    """Reject an empty list, and pictures too large to render."""
    if not found.cameras:
        raise BadInput(f"{where}: the list of cameras is empty")
    for index, camera in enumerate(found.cameras):
        if max(camera.width, camera.height) > LARGEST_SIDE or camera.width * camera.height > LARGEST_PICTURE:
            raise BadInput(
                f"{where}: camera {index} has {camera.width}x{camera.height} pixels; at most {LARGEST_SIDE} per side "
                f"and {LARGEST_PICTURE / 1e6:.0f} million in total are supported"
            )
    return found


def _ours(entries: object, like: Camera, where: str) -> CameraFile:
    """{world_from_camera, and optionally width, height, fx, fy, cx, cy} each, in scene units, maybe as `camera`."""
    cameras, distorted = [], 0
    for index, entry in enumerate(entries if isinstance(entries, list) else []):
        try:
            distorted += entry.get("camera", entry).get("distortion") is not None
            cameras.append(_camera_of_entry(entry.get("camera", entry), f"{index:04d}", like))
        except (AttributeError, KeyError, TypeError, ValueError, OverflowError, InvalidValue) as error:
            raise BadInput(f"{where}: camera {index} is invalid ({error})") from error
    remark = f"{where}: the lens distortion of {distorted} cameras is ignored; --plate renders it for the scene's views"
    return CameraFile(cameras, (remark,) if distorted else ())


def _camera_of_entry(entry: dict, name: str, like: Camera) -> Camera:
    """Fill in what an entry lacks from `like`: its size, horizontal field of view and center, at the entry's size.

    A single focal length applies to both axes: pixels are square.
    """
    width, height = int(entry.get("width", like.width)), int(entry.get("height", like.height))
    kx, ky = width / like.width, height / like.height
    fx = float(entry.get("fx", entry.get("fy", like.fx * kx)))
    fy = float(entry.get("fy", entry.get("fx", like.fy * kx)))
    cx, cy = float(entry.get("cx", like.cx * kx)), float(entry.get("cy", like.cy * ky))
    return Camera(name, width, height, fx, fy, cx, cy, np.array(entry["world_from_camera"], dtype=np.float64))


def _transforms(path: Path, scene: SceneData, where: str) -> CameraFile:
    """Read cameras in the frame of the scene's source, as import would; photos need not exist."""
    try:
        source = transforms.read(path, "")
        like = scene.cameras[0]
        cameras = []
        for index, one in enumerate(source.cameras):
            width, height = one.size or (like.width, like.height)
            lens = lens_without_photo(one, (width, height))
            pose = in_scene(one.world_from_camera, scene, f"frame {index}")
            cameras.append(Camera(f"{index:04d}", width, height, *lens, pose))
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from error
    bent = sum(not one.distortion.none for one in source.cameras)
    remarks = (f"the lens distortion of {bent} cameras in {path.name} is ignored",) if bent else ()
    return CameraFile(cameras, remarks)


def _nerfstudio(content: dict, path: Path, scene: SceneData, where: str) -> CameraFile:
    """Read a camera path exported by nerfstudio's viewer: camera_to_world with OpenGL axes, in nerfstudio's frame.

    That frame is known if dataparser_transforms.json is next to the file; otherwise it is assumed to be the source's.
    `fov` is vertical, in degrees.
    """
    kind = content.get("camera_type", "perspective")
    if kind != "perspective":
        raise BadInput(f"{where}: its camera_type is {printable(str(kind))[:40]}, expected perspective")
    entries = content["camera_path"]
    if not isinstance(entries, list):
        raise BadInput(f"{where}: camera_path is not a list; export the path again from nerfstudio's viewer")
    width, height = size(content, where, ("render_width", "render_height"))
    undo, remarks = _source_from_nerfstudio(path)
    cameras = []
    for index, entry in enumerate(entries):
        name = f"{where}: camera {index}"
        values = entry_of(entry, "camera_to_world", name)
        if isinstance(values, list) and all(isinstance(one, list) for one in values):
            values = [value for one in values for value in one]
        pose = from_opengl(with_last_row(row(values, 16, f"{name}: camera_to_world").reshape(4, 4)))
        angle = number(entry, "fov", name)
        if not 0 < angle < 180:
            raise BadInput(f"{name}: fov is {angle:g} degrees, expected 0 to 180")
        focal = height / 2 / math.tan(math.radians(angle) / 2)
        pose = in_scene(moved(checked(pose, name), undo), scene, name)
        cameras.append(Camera(f"{index:04d}", width, height, focal, focal, width / 2, height / 2, pose))
    return CameraFile(cameras, remarks)


def _source_from_nerfstudio(path: Path) -> tuple[np.ndarray, tuple[str, ...]]:
    """[4, 4] from nerfstudio's frame, x' = scale * transform x, back to that of its source."""
    beside = path.parent / OF_NERFSTUDIO
    if not beside.is_file():
        return np.eye(4), (
            f"{path.name} is assumed to be in the coordinate frame of the scene's source; if nerfstudio rotated or "
            f"scaled that frame, put the {OF_NERFSTUDIO} of its training run next to the file",
        )
    content, where = read_json(beside), printable(str(beside))
    rows = entry_of(content, "transform", where)
    values = [value for one in rows for value in one] if isinstance(rows, list) and all(
        isinstance(one, list) for one in rows
    ) else rows  # fmt: skip
    turn = checked(with_last_row(row(values, 12, f"{where}: transform").reshape(3, 4)), where)
    scale = number(content, "scale", where)
    if not scale > 0:
        raise BadInput(f"{where}: scale is {scale:g}, expected more than 0")
    return np.linalg.inv(np.diag([scale, scale, scale, 1]) @ turn), ()


def read_colmap(path: Path, scene: SceneData, where: str) -> CameraFile:
    """Read the cameras of a COLMAP model in a folder or its sparse/0, by the names of the photos."""
    folders = model_folders(path)
    if not folders:
        raise BadInput(f"{where} is a folder without a COLMAP model (cameras and images, here or in sparse/0)")
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
        remarks += (f"the lens distortion of {bent} cameras in {path.name} is ignored",)
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
            raise BadInput(f"{name}: rotation is not a 3x3 matrix")
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
    numbered = enumerate(read_text(path, MOST_CHAN).splitlines(), start=1)
    lines = [(place, line) for place, line in numbered if line.strip() and not line.startswith("#")]
    check_count(len(lines), where)
    for index, (place, line) in enumerate(lines):
        name = f"{where}: line {place}"
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
        f"{path.name}: assuming y up, rotation order ZXY and {like.width}x{like.height} pixels, which .chan files do "
        "not record",
    ))  # fmt: skip
