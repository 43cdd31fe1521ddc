"""Lenses of a transforms.json: focal lengths, centers, sizes and distortion, a frame's own before those of the file."""

import math
from collections.abc import Iterable

from schemas.errors import BadInput
from schemas.safe_names import printable
from stylerf.geometry.distortion import Distortion

_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "OPENCV", "SIMPLE_RADIAL", "RADIAL")
_FISHEYES = ("OPENCV_FISHEYE", "FISHEYE")
# Lenses of instant-ngp that are no pinhole with distortion; the mere key names them.
_OTHER_LENSES = ("ftheta_p0", "latlong", "equirectangular", "orthographic")
_BEYOND = ("k5", "k6")  # of FULL_OPENCV's denominator
LARGEST_SIDE = 1_000_000
KEYS = {
    *("w", "h", "fl_x", "fl_y", "cx", "cy", "x_fov", "y_fov", "camera_angle_x", "camera_angle_y"),
    *("camera_model", "is_fisheye", "distortion_params", "k1", "k2", "k3", "k4", "p1", "p2", *_BEYOND, *_OTHER_LENSES),
}
# Two keys of one focal length say the same within rounding.
_ONE_FOCAL = 0.01


class Numbers:
    """Numbers of a frame, its own before those of the file; BadInput where one is no number."""

    def __init__(self, content: dict, frame: dict, where: str) -> None:
        self.content, self.frame, self.where = content, frame, where

    def told(self, key: str) -> bool:
        """Whether the frame or the file has the key."""
        return key in self.frame or key in self.content

    def raw(self, key: str, default: object = None) -> object:
        """The value as it stands there."""
        return self.frame.get(key, self.content.get(key, default))

    def get(self, key: str, default: float = math.nan) -> float:
        """A number; digits in quotes are one too, as nerfstudio takes them."""
        return self.number(self.raw(key, default), key)

    def number(self, value: object, key: str) -> float:
        """`value` as a float."""
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            try:
                return float(value)
            except ValueError:
                pass
            except OverflowError as error:
                raise BadInput(f"{self.where}: {key} is beyond all numbers; export it again") from error
        shown = printable(f"{value!r:.40}")
        raise BadInput(f"{self.where}: {key} is {shown}, expected a number; export it again")

    def side(self, key: str) -> int | None:
        """A width or height in pixels, None where it is not told."""
        if not self.told(key):
            return None
        value = self.get(key)
        if not 1 <= value < LARGEST_SIDE:
            raise BadInput(f"{self.where}: {key} is {value:g}, expected a size in pixels; export it again")
        return round(value)


def intrinsics(numbers: Numbers) -> tuple[tuple[float, float, float, float], tuple[float, float]]:
    """(fx, fy, cx, cy) in pixels and the angles across and down in radians, NaN where they are not told.

    A frame's own focal lengths come before the file's. Of one place, fl_x comes before x_fov (degrees) before
    camera_angle_x (radians). BadInput where neither axis is told.
    """
    focals, angles = [], []
    for axis in "xy":
        level = next((one for one in (numbers.frame, numbers.content) if _keys(axis) & one.keys()), {})
        focals.append(_told(numbers, level, f"fl_{axis}"))
        degrees = _told(numbers, level, f"{axis}_fov")
        angles.append(_told(numbers, level, f"camera_angle_{axis}") if math.isnan(degrees) else math.radians(degrees))
    if all(map(math.isnan, (*focals, *angles))):
        raise BadInput(
            f"{numbers.where} tells no focal length: neither fl_x nor camera_angle_x nor x_fov, nor fl_y, "
            "camera_angle_y, y_fov; export it with one of them"
        )
    return (*focals, *(_center(numbers, key) for key in ("cx", "cy"))), tuple(angles)


def _center(numbers: Numbers, key: str) -> float:
    value = numbers.get(key)
    if numbers.told(key) and not math.isfinite(value):
        raise BadInput(f"{numbers.where}: {key} is {value:g}, expected a position in pixels; export it again")
    return value


def _keys(axis: str) -> set[str]:
    return {f"fl_{axis}", f"{axis}_fov", f"camera_angle_{axis}"}


def _told(numbers: Numbers, level: dict, key: str) -> float:
    """The number of that key; BadInput where it is there and not finite. NaN where it is not there."""
    if key not in level:
        return math.nan
    value = numbers.number(level[key], key)
    if not math.isfinite(value):
        raise BadInput(f"{numbers.where}: {key} is {value:g}, a focal length must be positive; repair the camera")
    return value


def disagreement(numbers: Numbers, width: int, height: int) -> str:
    """In words, where two keys of one place tell different focal lengths of an axis; else empty."""
    for axis, side in (("x", width), ("y", height)):
        for level in (numbers.frame, numbers.content):
            told = {key: _told(numbers, level, key) for key in (f"fl_{axis}", f"{axis}_fov", f"camera_angle_{axis}")}
            focals = dict(_in_pixels(told, side))
            if len(focals) > 1 and max(focals.values()) > (1 + _ONE_FOCAL) * min(focals.values()):
                first, *others = (f"{key} tells {value:.1f} px" for key, value in focals.items())
                return f"{numbers.where}: {first}, which is taken, but {', '.join(others)}"
    return ""


def _in_pixels(told: dict[str, float], side: int) -> Iterable[tuple[str, float]]:
    for key, value in told.items():
        if key.startswith("fl_") and value > 0:
            yield key, value
        angle = math.radians(value) if key.endswith("_fov") else value
        if not key.startswith("fl_") and 0 < angle < math.pi:
            yield key, side / 2 / math.tan(angle / 2)


def distortion(numbers: Numbers) -> Distortion:
    """Of the lens; BadInput for lenses that are no pinhole with Brown's distortion and no Kannala-Brandt fisheye."""
    model = printable(str(numbers.raw("camera_model", "OPENCV"))).upper()
    other = next((key for key in _OTHER_LENSES if numbers.raw(key, False) not in (False, None)), None)
    fisheye = numbers.raw("is_fisheye", False)
    if fisheye not in (True, False, None):
        raise BadInput(f"{numbers.where}: is_fisheye is {printable(f'{fisheye!r:.40}')}, expected true or false")
    if fisheye:
        model = "OPENCV_FISHEYE"
    if other or model not in _PINHOLES + _FISHEYES:
        raise BadInput(
            f"{numbers.where}: its camera model {other or model} is not known; undistort the pictures first, or use "
            f"one of {', '.join(_PINHOLES + _FISHEYES)}"
        )
    *k, p1, p2 = _coefficients(numbers)
    if not all(map(math.isfinite, (*k, p1, p2))):
        raise BadInput(f"{numbers.where}: a distortion coefficient is not finite; export it again")
    if beyond := next((key for key in _BEYOND if numbers.get(key, 0.0) != 0), None):
        raise BadInput(f"{numbers.where}: {beyond} is not known; undistort the pictures first")
    return Distortion("fisheye", tuple(k)) if model in _FISHEYES else Distortion("brown", tuple(k), (p1, p2))


def _coefficients(numbers: Numbers) -> list[float]:
    """k1, k2, k3, k4, p1, p2: those of nerfstudio's distortion_params where it is there."""
    names = ("k1", "k2", "k3", "k4", "p1", "p2")
    listed = numbers.raw("distortion_params")
    if listed is None:
        return [numbers.get(name, 0.0) for name in names]
    if not isinstance(listed, list) or len(listed) != len(names):
        raise BadInput(f"{numbers.where}: distortion_params must list {', '.join(names)}; export it again")
    return [numbers.number(value, name) for value, name in zip(listed, names, strict=True)]
