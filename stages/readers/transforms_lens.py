"""Lenses of a transforms.json: focal lengths, centers, sizes and distortion; a frame's values override the file's."""

import math
from collections.abc import Iterable

from schemas.errors import BadInput
from schemas.safe_names import printable
from stylerf.geometry.distortion import Distortion

_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "OPENCV", "SIMPLE_RADIAL", "RADIAL")
_FISHEYES = ("OPENCV_FISHEYE", "FISHEYE")
# instant-ngp's other lenses, each marked by its key.
_OTHER_LENSES = ("ftheta_p0", "latlong", "equirectangular", "orthographic")
_BEYOND = ("k5", "k6")  # of FULL_OPENCV's denominator
LARGEST_SIDE = 1_000_000
KEYS = {
    *("w", "h", "fl_x", "fl_y", "cx", "cy", "x_fov", "y_fov", "camera_angle_x", "camera_angle_y"),
    *("camera_model", "is_fisheye", "distortion_params", "k1", "k2", "k3", "k4", "p1", "p2", *_BEYOND, *_OTHER_LENSES),
}
# Two keys of one focal length may differ by rounding.
_ONE_FOCAL = 0.01


class Numbers:
    """Numbers of a frame, which override those of the file; BadInput if one is not a number."""

    def __init__(self, content: dict, frame: dict, where: str) -> None:
        self.content, self.frame, self.where = content, frame, where

    def has(self, key: str) -> bool:
        """Return whether the frame or the file has the key."""
        return key in self.frame or key in self.content

    def raw(self, key: str, default: object = None) -> object:
        """Return the value as written."""
        return self.frame.get(key, self.content.get(key, default))

    def get(self, key: str, default: float = math.nan) -> float:
        """Return a number; a string of digits is accepted too, as in nerfstudio."""
        return self.number(self.raw(key, default), key)

    def number(self, value: object, key: str) -> float:
        """`value` as a float."""
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            try:
                return float(value)
            except ValueError:
                pass
            except OverflowError as error:
                raise BadInput(f"{self.where}: {key} is out of range; export it again") from error
        shown = printable(f"{value!r:.40}")
        raise BadInput(f"{self.where}: {key} is {shown}, expected a number; export it again")

    def side(self, key: str) -> int | None:
        """Return a width or height in pixels, None if missing."""
        if not self.has(key):
            return None
        value = self.get(key)
        if not 1 <= value < LARGEST_SIDE:
            raise BadInput(f"{self.where}: {key} is {value:g}, expected a size in pixels; export it again")
        return round(value)


def intrinsics(numbers: Numbers) -> tuple[tuple[float, float, float, float], tuple[float, float]]:
    """(fx, fy, cx, cy) in pixels and the horizontal and vertical angles in radians, NaN if missing.

    A frame with its own focal length, of either axis, takes none from the file. Within one, fl_x has priority over
    x_fov (degrees) over camera_angle_x (radians). BadInput if both axes are missing.
    """
    keys = _keys("x") | _keys("y")
    level = next((one for one in (numbers.frame, numbers.content) if keys & one.keys()), {})
    focals, angles = [], []
    for axis in "xy":
        focals.append(_focal(numbers, level, f"fl_{axis}"))
        degrees = _focal(numbers, level, f"{axis}_fov")
        angles.append(_focal(numbers, level, f"camera_angle_{axis}") if math.isnan(degrees) else math.radians(degrees))
    if all(map(math.isnan, (*focals, *angles))):
        raise BadInput(
            f"{numbers.where} has no focal length: neither fl_x nor camera_angle_x nor x_fov, nor fl_y, "
            "camera_angle_y, y_fov; export it with one of them"
        )
    (fx, fy), (across, down) = focals, angles
    return (fx, fy, _center(numbers, "cx"), _center(numbers, "cy")), (across, down)


def _center(numbers: Numbers, key: str) -> float:
    value = numbers.get(key)
    if numbers.has(key) and not math.isfinite(value):
        raise BadInput(f"{numbers.where}: {key} is {value:g}, expected a position in pixels; export it again")
    return value


def _keys(axis: str) -> set[str]:
    return {f"fl_{axis}", f"{axis}_fov", f"camera_angle_{axis}"}


def _focal(numbers: Numbers, level: dict, key: str) -> float:
    """Return the number of that key, NaN if missing; BadInput if it is not finite."""
    if key not in level:
        return math.nan
    value = numbers.number(level[key], key)
    if not math.isfinite(value):
        raise BadInput(f"{numbers.where}: {key} is {value:g}, but a focal length must be positive; repair the camera")
    return value


def disagreement(numbers: Numbers, width: int, height: int) -> str:
    """Return a remark if two keys give different focal lengths of an axis; otherwise empty."""
    for axis, side in (("x", width), ("y", height)):
        for level in (numbers.frame, numbers.content):
            values = {key: _focal(numbers, level, key) for key in (f"fl_{axis}", f"{axis}_fov", f"camera_angle_{axis}")}
            focals = dict(_in_pixels(values, side))
            if len(focals) > 1 and max(focals.values()) > (1 + _ONE_FOCAL) * min(focals.values()):
                first, *others = (f"{key} gives {value:.1f} px" for key, value in focals.items())
                return f"{numbers.where}: {first}, which is used, but {', '.join(others)}"
    return ""


def _in_pixels(values: dict[str, float], side: int) -> Iterable[tuple[str, float]]:
    for key, value in values.items():
        if key.startswith("fl_") and value > 0:
            yield key, value
        angle = math.radians(value) if key.endswith("_fov") else value
        if not key.startswith("fl_") and 0 < angle < math.pi:
            yield key, side / 2 / math.tan(angle / 2)


def distortion(numbers: Numbers) -> Distortion:
    """Return the distortion; BadInput unless it is a pinhole's Brown model or a Kannala-Brandt fisheye."""
    model = printable(str(numbers.raw("camera_model", "OPENCV"))).upper()
    other = next((key for key in _OTHER_LENSES if numbers.raw(key, False) not in (False, None)), None)
    fisheye = numbers.raw("is_fisheye", False)
    if fisheye not in (True, False, None):
        raise BadInput(f"{numbers.where}: is_fisheye is {printable(f'{fisheye!r:.40}')}, expected true or false")
    if fisheye:
        model = "OPENCV_FISHEYE"
    if other or model not in _PINHOLES + _FISHEYES:
        raise BadInput(
            f"{numbers.where}: its camera model {other or model} is not supported; undistort the pictures first, or "
            f"use one of {', '.join(_PINHOLES + _FISHEYES)}"
        )
    *k, p1, p2 = _coefficients(numbers)
    if not all(map(math.isfinite, (*k, p1, p2))):
        raise BadInput(f"{numbers.where}: a distortion coefficient is not finite; export it again")
    if beyond := next((key for key in _BEYOND if numbers.get(key, 0.0) != 0), None):
        raise BadInput(f"{numbers.where}: {beyond} is not supported; undistort the pictures first")
    return Distortion("fisheye", tuple(k)) if model in _FISHEYES else Distortion("brown", tuple(k), (p1, p2))


def _coefficients(numbers: Numbers) -> list[float]:
    """k1, k2, k3, k4, p1, p2: those of nerfstudio's distortion_params if present."""
    names = ("k1", "k2", "k3", "k4", "p1", "p2")
    listed = numbers.raw("distortion_params")
    if listed is None:
        return [numbers.get(name, 0.0) for name in names]
    if not isinstance(listed, list) or len(listed) != len(names):
        raise BadInput(f"{numbers.where}: distortion_params must list {', '.join(names)}; export it again")
    return [numbers.number(value, name) for value, name in zip(listed, names, strict=True)]
