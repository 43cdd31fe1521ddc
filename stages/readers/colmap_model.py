"""COLMAP's model files, binary or text, read strictly.

Given a truncated or altered file, COLMAP's own reader (pycolmap.Reconstruction) may never return, request exabytes of
memory, or silently read only part of it; here every count is checked against the available bytes, and nothing may be
left over. Rigs and frames are not needed: images.bin and images.txt also contain each photo's pose.
"""

import math
import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.safe_names import printable
from schemas.safe_reading import read_bytes, read_text

# In the order of their numbers in binary files: the name in text files, and the number of parameters.
MODELS = (
    ("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8), ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4), ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16), ("SIMPLE_DIVISION", 4), ("DIVISION", 5), ("SIMPLE_FISHEYE", 3), ("FISHEYE", 4),
    ("EUCM", 6), ("EQUIRECTANGULAR", 2),
)  # fmt: skip
LONGEST_NAME = 4096
MOST_BYTES = 2 << 30  # of one file: images.bin of 5,000 photos with 10,000 features each takes 1.2 GB
# How far from 1 the length of a quaternion may be: manually written lists round to two or three digits.
ROUNDING = 1e-2


@dataclass(frozen=True)
class ModelCamera:
    """model: COLMAP's name; params: in COLMAP's order; size in pixels."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class ModelImage:
    """camera_from_world: [3, 4], OpenCV axes."""

    number: int
    name: str
    camera: int
    camera_from_world: np.ndarray


@dataclass(frozen=True, eq=False)
class Model:
    """Cameras by number; photos; points [n, 3] float64 with colors [n, 3] uint8 and errors [n] float32 pixels.

    remarks: what is unusual about the files, one line each.
    """

    cameras: dict[int, ModelCamera]
    images: list[ModelImage]
    xyz: np.ndarray
    rgb: np.ndarray
    error: np.ndarray
    remarks: tuple[str, ...] = ()


class _Damaged(Exception):
    pass


def whole(folder: Path) -> list[str]:
    """Return which of .bin and .txt have both the cameras and the photos of the model in `folder`, preferred first."""
    pairs = {end: [folder / f"{name}{end}" for name in ("cameras", "images")] for end in (".bin", ".txt")}
    return [end for end, pair in pairs.items() if all(path.is_file() for path in pair)]


def files_of(folder: Path) -> list[Path]:
    """Return the existing files of a model, of both kinds."""
    names = [f"{name}{end}" for name in ("cameras", "images", "points3D") for end in (".bin", ".txt")]
    return [folder / name for name in names if (folder / name).is_file()]


def read_model(folder: Path) -> Model:
    """Read the model in `folder`: the binary one, as COLMAP does, or the text if that is missing or damaged.

    BadInput names a file that is missing, truncated, visibly altered, or of an unknown camera model. All points may be
    missing.
    """
    kinds, there = whole(folder), [path.name for path in files_of(folder)]
    if not kinds:
        raise BadInput(
            f"the COLMAP model {folder} is incomplete: it has {', '.join(there) or 'no file'}, and needs both cameras "
            "and images, as .bin or as .txt; export it again, or find new poses with --format photos"
        )
    if len(kinds) == 1:
        half = [name for name in there if not name.endswith(kinds[0]) and not name.startswith("points3D")]
        unused = (f"{folder}: {half[0]} alone is not a model and is not used",) if half else ()
        return _model(folder, kinds[0], unused)
    try:
        binary = _model(folder, ".bin")
    except BadInput as error:
        return _model(folder, ".txt", (f"{error}; using its text files",))
    return replace(binary, remarks=binary.remarks + _against_text(folder, binary))


def _model(folder: Path, end: str, remarks: tuple[str, ...] = ()) -> Model:
    binary, found = end == ".bin", list(remarks)
    cameras = _read(folder / f"cameras{end}", _cameras_binary if binary else _cameras_text, found)
    images = _read(folder / f"images{end}", _images_binary if binary else _images_text, found)
    points = (np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0, np.float32))
    if (path := folder / f"points3D{end}").is_file():
        points = _read(path, _points_binary if binary else _points_text, found)
    first: dict[int, ModelImage] = {}
    for image in images:
        if image.camera not in cameras:
            raise BadInput(
                f"the COLMAP model {folder}: {printable(image.name)} has camera {image.camera}, which is missing; "
                "export it again"
            )
        if (other := first.setdefault(image.number, image)) is not image:
            two = f"{printable(other.name)} and {printable(image.name)}"
            raise BadInput(
                f"the COLMAP model {folder}: {two} share the number {image.number}; number the photos uniquely"
            )
    if not images:
        raise BadInput(f"the COLMAP model {folder} contains no photo with a pose; reconstruct again")
    return Model(cameras, images, *points, tuple(found))


def _against_text(folder: Path, binary: Model) -> tuple[str, ...]:
    """Return remarks on the text files next to the binary model being read: none if they agree within their digits."""
    remarks: list[str] = []
    try:
        cameras = _read(folder / "cameras.txt", _cameras_text, remarks)
        images = {one.name: one for one in _read(folder / "images.txt", _images_text, remarks)}
    except BadInput as error:
        return (f"{error}; using the binary model next to it",)
    ours = {one.name: one for one in binary.images}
    equal = [
        np.allclose(images[name].camera_from_world, one.camera_from_world, rtol=1e-4, atol=1e-4)
        and _alike(cameras.get(images[name].camera), binary.cameras[one.camera])
        for name, one in ours.items()
        if name in images
    ]
    if len(images) == len(ours) == sum(equal):
        return ()
    counts = f"{len(images)} photos, {sum(equal)} of them as in the binary model"
    return (
        f"{folder}: its text files hold a different model ({counts}) and are not used; to use them, move the .bin "
        "files away",
    )


def _alike(one: ModelCamera | None, other: ModelCamera) -> bool:
    return (
        one is not None
        and (one.model, one.width, one.height) == (other.model, other.width, other.height)
        and np.allclose(one.params, other.params, rtol=1e-4, atol=1e-6)
    )


def _read(path: Path, parse, remarks: list[str]):
    try:
        if path.suffix == ".bin":
            data = _Bytes(read_bytes(path, MOST_BYTES))
            content = parse(data)
            data.end()
            return content
        lines = _Lines(read_text(path, MOST_BYTES))
        content = parse(lines)
        if path.stem == "points3D":
            return content
        if lines.declared not in (None, len(content)):
            remarks.append(f"{path}: its header declares {lines.declared} entries, found {len(content)}")
        return content
    except FileNotFoundError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}); export the COLMAP model again") from error
    except _Damaged as error:
        raise BadInput(f"{path} is damaged ({printable(str(error)[:300])}); export the COLMAP model again") from error
    except (ValueError, IndexError, struct.error, OverflowError) as error:
        raise BadInput(f"{path} is damaged (not COLMAP {path.stem}); export the COLMAP model again") from error


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

    def count(self, item_bytes: int) -> int:
        """Read a count of items of at least `item_bytes` bytes each."""
        (number,) = self.take("Q")
        self._need(number * item_bytes)
        return number

    def skip(self, size: int) -> None:
        self._need(size)
        self.at += size

    def text(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + LONGEST_NAME)
        if end < 0:
            raise _Damaged("a name is not terminated")
        name = self.data[self.at : end]
        self.at = end + 1
        try:
            return name.decode("utf-8")
        except UnicodeDecodeError:
            raise _Damaged(f"the name {printable(name.decode('latin-1'))!r} is not UTF-8; rename the photo") from None

    def _need(self, size: int) -> None:
        if size > len(self.data) - self.at:
            raise _Damaged(f"truncated at byte {self.at} of {len(self.data)}")

    def end(self) -> None:
        if self.at != len(self.data):
            raise _Damaged(f"{len(self.data) - self.at} extra bytes")


def _cameras_binary(data: _Bytes) -> dict[int, ModelCamera]:
    cameras: dict[int, ModelCamera] = {}
    for _ in range(data.count(24)):
        number, model, width, height = data.take("IiQQ")
        if not 0 <= model < len(MODELS):
            raise _Damaged(f"camera {number} has unknown model number {model}")
        name, count = MODELS[model]
        _add(cameras, number, _camera(name, width, height, data.take(f"{count}d")))
    return cameras


def _camera(name: str, width: int, height: int, params: tuple[float, ...]) -> ModelCamera:
    if not (0 < width < 1e6 and 0 < height < 1e6 and all(map(math.isfinite, params))):
        raise _Damaged(f"a camera of {width}x{height} pixels with parameters {params}")
    return ModelCamera(name, int(width), int(height), tuple(params))


def _add(cameras: dict[int, ModelCamera], number: int, camera: ModelCamera) -> None:
    if cameras.setdefault(number, camera) != camera:
        raise _Damaged(f"two cameras have number {number}")


def _images_binary(data: _Bytes) -> list[ModelImage]:
    images = []
    for _ in range(data.count(73)):
        number, *pose, camera = data.take("I7dI")
        images.append(_image(number, data.text(), camera, pose))
        data.skip(24 * data.count(24))
    return images


def _image(number: int, name: str, camera: int, pose: list[float]) -> ModelImage:
    quaternion, shift = np.array(pose[:4]), np.array(pose[4:])
    length = math.hypot(*quaternion)  # no warning where it overflows
    if not (np.isfinite(pose).all() and abs(length - 1) < ROUNDING):
        why = f": its quaternion has length {length:.3g}, expected 1" if math.isfinite(length) else ""
        raise _Damaged(f"the pose of {printable(name)!r} is not a rotation{why}")
    return ModelImage(number, name, camera, np.column_stack([rotation_of(quaternion / length), shift]))


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
    numbers, values = array("Q"), array("d")
    for _ in range(data.count(51)):
        number, *point = data.take("Q3d3Bd")
        numbers.append(number)
        values.extend(point)
        data.skip(8 * data.count(8))
    return _points(numbers, values)


def _points(numbers: array, values: array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points from rows (x, y, z, r, g, b, error), sorted by number, without those that are not finite."""
    table = np.array(values, dtype=np.float64).reshape(-1, 7)[np.argsort(np.array(numbers), kind="stable")]
    table = table[np.isfinite(table).all(axis=1)]
    if ((table[:, 3:6] < 0) | (table[:, 3:6] > 255)).any():
        raise _Damaged("a color is not within 0..255")
    return table[:, :3], table[:, 3:6].astype(np.uint8), table[:, 6].astype(np.float32)


class _Lines:
    """The lines of a text file without blank ones and comments. declared: number of entries according to its header."""

    def __init__(self, text: str) -> None:
        self.declared: int | None = None
        self._lines = text.split("\n")
        self._at = 0

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """(where, line): the line number as text, and the stripped line."""
        while (found := self.next(blank=False)) is not None:
            yield f"line {self._at}", found

    def next(self, blank: bool) -> str | None:
        """Return the next line that is not a comment, with blank=True also a blank one; None at the end."""
        while self._at < len(self._lines):
            line = self._lines[self._at].strip()
            self._at += 1
            if line.startswith("#"):
                self._head(line)
            elif line or blank:
                return line
        return None

    def back(self) -> None:
        """Put back the line that was read last."""
        self._at -= 1

    def _head(self, line: str) -> None:
        count = line.partition(":")[2].split(",")[0].strip()
        if line.startswith("# Number of ") and count.isdecimal():
            self.declared = int(count)


def _cameras_text(lines: _Lines) -> dict[int, ModelCamera]:
    cameras: dict[int, ModelCamera] = {}
    counts = dict(MODELS)
    for where, line in lines:
        number, name, *numbers = line.split()
        if name not in counts:
            raise _Damaged(f"camera {number} has unknown model {name}")
        if len(numbers) != counts[name] + 2:
            raise _Damaged(f"camera {number} has {max(0, len(numbers) - 2)} parameters, but {name} has {counts[name]}")
        try:
            width, height, params = int(numbers[0]), int(numbers[1]), tuple(map(float, numbers[2:]))
            _add(cameras, int(number), _camera(name, width, height, params))
        except ValueError:
            raise _Damaged(f"{where}: expected a camera (number, model, width, height, parameters)") from None
    return cameras


def _images_text(lines: _Lines) -> list[ModelImage]:
    """Each photo has a second line, its observations, which may be empty; manually written lists omit it."""
    images = []
    for where, line in lines:
        fields = line.split(maxsplit=9)
        if len(fields) < 10 or _observations(line):
            raise _Damaged(f"{where}: expected a photo (number, quaternion, translation, camera, name)")
        try:
            number, camera, pose = int(fields[0]), int(fields[8]), [float(value) for value in fields[1:8]]
        except ValueError:
            raise _Damaged(f"{where}: expected a photo (number, quaternion, translation, camera, name)") from None
        try:
            images.append(_image(number, fields[9], camera, pose))
        except _Damaged as error:
            raise _Damaged(f"{where}: {error}") from None
        second = lines.next(blank=True)
        if second and not _observations(second):
            lines.back()
    return images


def _observations(line: str) -> bool:
    """Return whether a line contains observations, x y point of each, and not a photo whose name is a number.

    Only as many of its numbers, which may be tens of thousands, are examined as a photo's line has.
    """
    fields = line.split(maxsplit=10)
    if not all(map(_is_number, fields[:10])):
        return False
    photo = len(fields) >= 10 and not any("." in fields[place] for place in (0, 8)) and _unit(fields[1:5])
    return not photo if len(fields) > 9 else len(fields) % 3 == 0


def _unit(fields: list[str]) -> bool:
    return abs(math.hypot(*map(float, fields)) - 1) < ROUNDING


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _points_text(lines: _Lines) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    numbers, values = array("Q"), array("d")
    for where, line in lines:
        fields = line.split()
        if len(fields) < 8 or len(fields) % 2:
            raise _Damaged(f"{where}: point {fields[0]:.20} is incomplete")
        numbers.append(int(fields[0]))
        values.extend((*map(float, fields[1:4]), *map(int, fields[4:7]), float(fields[7])))
    return _points(numbers, values)
