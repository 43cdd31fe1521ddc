"""COLMAP's model files, binary or text, read strictly.

COLMAP's own reader, given a file that was cut short or altered, may read on for ever, ask for exabytes of memory, or
take in a part without a word; here every count is held against the bytes that are there, and nothing may be left over.
Rigs and frames are not needed: images.bin and images.txt hold each photo's own pose too.
"""

import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.errors import BadInput

# In the order of their numbers in binary files: the name in text files, and the count of parameters.
MODELS = (
    ("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8), ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4), ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16), ("SIMPLE_DIVISION", 4), ("DIVISION", 5), ("SIMPLE_FISHEYE", 3), ("FISHEYE", 4),
    ("EUCM", 6), ("EQUIRECTANGULAR", 2),
)  # fmt: skip
LONGEST_NAME = 4096


@dataclass(frozen=True)
class ModelCamera:
    """model: COLMAP's name of it; params: in COLMAP's order; size in pixels."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class ModelImage:
    """camera_from_world: [3, 4], OpenCV axes."""

    name: str
    camera: int
    camera_from_world: np.ndarray


@dataclass(frozen=True, eq=False)
class Model:
    """Cameras by number; photos; points [n, 3] float64 with colours [n, 3] uint8 and errors [n] float32 pixels."""

    cameras: dict[int, ModelCamera]
    images: list[ModelImage]
    xyz: np.ndarray
    rgb: np.ndarray
    error: np.ndarray


class _Damaged(Exception):
    pass


def read_model(folder: Path) -> Model:
    """The model in `folder`; BadInput naming the file where one is missing, cut short, altered so that it shows, or of
    an unknown camera model. Points may be missing as a whole."""
    binary = (folder / "cameras.bin").is_file()
    cameras = _read(folder, "cameras", binary, _cameras_binary, _cameras_text)
    images = _read(folder, "images", binary, _images_binary, _images_text)
    points = (np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0, np.float32))
    if (folder / f"points3D{'.bin' if binary else '.txt'}").is_file():
        points = _read(folder, "points3D", binary, _points_binary, _points_text)
    for image in images:
        if image.camera not in cameras:
            raise BadInput(
                f"the COLMAP model {folder}: {image.name} has camera {image.camera}, which is missing; export it again"
            )
    if not images:
        raise BadInput(f"the COLMAP model {folder} holds no photo with a pose; reconstruct again")
    return Model(cameras, images, *points)


def _read(folder: Path, name: str, binary: bool, from_binary, from_text):
    path = folder / f"{name}{'.bin' if binary else '.txt'}"
    try:
        if binary:
            data = _Bytes(path.read_bytes())
            content = from_binary(data)
            data.end()
            return content
        return from_text(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}); export the COLMAP model again") from error
    except _Damaged as error:
        raise BadInput(f"{path} is damaged ({error}); export the COLMAP model again") from error
    except (ValueError, IndexError, struct.error, OverflowError) as error:
        raise BadInput(f"{path} is damaged (no {name} of COLMAP); export the COLMAP model again") from error


class _Bytes:
    """A little-endian file read from front to back."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, layout: str) -> tuple:
        size = struct.calcsize("<" + layout)
        self._need(size)
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += size
        return values

    def count(self, least_bytes: int) -> int:
        """A count of items that take at least so many bytes each."""
        (number,) = self.take("Q")
        self._need(number * least_bytes)
        return number

    def skip(self, size: int) -> None:
        self._need(size)
        self.at += size

    def text(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + LONGEST_NAME)
        if end < 0:
            raise _Damaged("a name does not end")
        text = self.data[self.at : end].decode("utf-8")
        self.at = end + 1
        return text

    def _need(self, size: int) -> None:
        if size > len(self.data) - self.at:
            raise _Damaged(f"cut short at byte {self.at} of {len(self.data)}")

    def end(self) -> None:
        if self.at != len(self.data):
            raise _Damaged(f"{len(self.data) - self.at} bytes too many")


def _cameras_binary(data: _Bytes) -> dict[int, ModelCamera]:
    cameras = {}
    for _ in range(data.count(24)):
        number, model, width, height = data.take("IiQQ")
        if not 0 <= model < len(MODELS):
            raise _Damaged(f"camera {number} is of a model that is not known, number {model}")
        name, count = MODELS[model]
        cameras[number] = _camera(name, width, height, data.take(f"{count}d"))
    return cameras


def _camera(name: str, width: int, height: int, params: tuple[float, ...]) -> ModelCamera:
    if not (0 < width < 1e6 and 0 < height < 1e6 and all(map(math.isfinite, params))):
        raise _Damaged(f"a camera of {width}x{height} pixels with parameters {params}")
    return ModelCamera(name, int(width), int(height), tuple(params))


def _images_binary(data: _Bytes) -> list[ModelImage]:
    images = []
    for _ in range(data.count(73)):
        _, *pose, camera = data.take("I7dI")
        images.append(_image(data.text(), camera, pose))
        data.skip(24 * data.count(24))
    return images


def _image(name: str, camera: int, pose: list[float]) -> ModelImage:
    quaternion, shift = np.array(pose[:4]), np.array(pose[4:])
    length = float(np.linalg.norm(quaternion))
    if not (np.isfinite(pose).all() and abs(length - 1) < 1e-3):
        raise _Damaged(f"the pose of {name!r} is no rotation")
    return ModelImage(name, camera, np.column_stack([rotation_of(quaternion / length), shift]))


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """Rotation [3, 3] of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _points_binary(data: _Bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = []
    for _ in range(data.count(51)):
        rows.append(data.take("Q3d3Bd"))
        data.skip(8 * data.count(8))
    return _points(rows)


def _points(rows: list[tuple]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sorted by number; those that are not finite are left out."""
    table = np.array([row[1:] for row in sorted(rows)], dtype=np.float64).reshape(-1, 7)
    table = table[np.isfinite(table).all(axis=1)]
    if ((table[:, 3:6] < 0) | (table[:, 3:6] > 255)).any():
        raise _Damaged("a colour is not within 0..255")
    return table[:, :3], table[:, 3:6].astype(np.uint8), table[:, 6].astype(np.float32)


def _lines(text: str) -> tuple[list[str], int | None]:
    """The lines without comments, and how many items the head says there are."""
    told, lines = None, []
    for line in text.splitlines():
        if not line.startswith("#"):
            lines.append(line)
        elif line.startswith("# Number of "):
            told = int(line.partition(":")[2].split(",")[0])
    return lines, told


def _whole(items: list, told: int | None) -> None:
    if told is not None and told != len(items):
        raise _Damaged(f"its head tells of {told} entries, {len(items)} are there")


def _cameras_text(text: str) -> dict[int, ModelCamera]:
    lines, told = _lines(text)
    cameras, counts = {}, dict(MODELS)
    for line in lines:
        if not line.strip():
            continue
        number, name, width, height, *params = line.split()
        if name not in counts:
            raise _Damaged(f"camera {number} is of a model that is not known, {name}")
        if len(params) != counts[name]:
            raise _Damaged(f"camera {number} has {len(params)} parameters where {name} has {counts[name]}")
        cameras[int(number)] = _camera(name, int(width), int(height), tuple(map(float, params)))
    _whole(list(cameras), told)
    return cameras


def _images_text(text: str) -> list[ModelImage]:
    """Each photo has two lines, of which the second, its observations, may be empty."""
    lines, told = _lines(text)
    while lines and not lines[-1].strip() and len(lines) % 2:
        lines.pop()
    images = []
    for line in lines[::2]:
        fields = line.split(maxsplit=9)
        images.append(_image(fields[9].strip(), int(fields[8]), [float(value) for value in fields[1:8]]))
    _whole(images, told)
    return images


def _points_text(text: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    lines, told = _lines(text)
    rows = []
    for line in lines:
        if not line.strip():
            continue
        fields = line.split()
        if len(fields) < 8 or len(fields) % 2:
            raise _Damaged(f"point {fields[0]} is cut short")
        rows.append((int(fields[0]), *map(float, fields[1:4]), *map(int, fields[4:7]), float(fields[7])))
    _whole(rows, told)
    return _points(rows)
