"""Lens distortion: where a ray of the ideal pinhole falls on the real picture, and back.

Points are (x, y) = (X/Z, Y/Z) before, and normalized image coordinates (u - cx)/fx, (v - cy)/fy after.
"""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue

KINDS = ("brown", "fisheye")
# A pinhole picture cannot show a half turn: a fisheye is cut at this slope (63 degrees off the axis).
WIDEST_SLOPE = 2.0


@dataclass(frozen=True)
class Distortion:
    """brown: x' = x N(r^2)/D(r^2) + 2 p1 x y + p2 (r^2 + 2 x^2), y' likewise with p1 and p2 swapped (Brown 1966,
    OpenCV's model), N = 1 + sum radial[i] r^(2i+2), D = 1 + sum denominator[i] r^(2i+2).

    fisheye: x' = x theta'/r, theta = atan(r), theta' = theta (1 + sum radial[i] theta^(2i+2)) (Kannala-Brandt).
    """

    kind: str = "brown"
    radial: tuple[float, ...] = ()
    tangential: tuple[float, float] = (0.0, 0.0)
    denominator: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InvalidValue(f"unknown distortion {self.kind!r}")
        if not np.isfinite([*self.radial, *self.tangential, *self.denominator]).all():
            raise InvalidValue("a distortion coefficient is NaN or infinite")

    @property
    def none(self) -> bool:
        """Whether this is the pinhole itself."""
        return self.kind == "brown" and not any((*self.radial, *self.tangential, *self.denominator))

    def distort(self, points: np.ndarray) -> np.ndarray:
        """Pinhole points [..., 2] -> points on the picture [..., 2]."""
        x, y = points[..., 0], points[..., 1]
        squared = x * x + y * y
        if self.kind == "fisheye":
            r = np.sqrt(squared)
            theta = np.arctan(r)
            scale = np.where(r > 1e-9, theta / np.maximum(r, 1e-9), 1.0) * _series(self.radial, theta * theta)
            return points * scale[..., None]
        scale = _series(self.radial, squared) / _series(self.denominator, squared)
        p1, p2 = self.tangential
        cross = 2 * x * y
        return np.stack(
            [
                x * scale + p1 * cross + p2 * (squared + 2 * x * x),
                y * scale + p2 * cross + p1 * (squared + 2 * y * y),
            ],
            axis=-1,
        )

    def undistort(self, points: np.ndarray) -> np.ndarray:
        """Points on the picture [..., 2] -> pinhole points [..., 2], by Newton's method; NaN where there is none."""
        points = np.asarray(points, dtype=np.float64)
        found = self._fisheye_start(points) if self.kind == "fisheye" else points.copy()
        step = 1e-6
        for _ in range(30):
            here = self.distort(found)
            dx = (self.distort(found + [step, 0]) - here) / step
            dy = (self.distort(found + [0, step]) - here) / step
            residual = points - here
            determinant = dx[..., 0] * dy[..., 1] - dx[..., 1] * dy[..., 0]
            determinant = np.where(np.abs(determinant) < 1e-12, np.nan, determinant)
            move = np.stack(
                [
                    dy[..., 1] * residual[..., 0] - dy[..., 0] * residual[..., 1],
                    dx[..., 0] * residual[..., 1] - dx[..., 1] * residual[..., 0],
                ],
                axis=-1,
            )
            found = found + move / determinant[..., None]
        lost = ~(np.abs(self.distort(found) - points).max(axis=-1) < 1e-7)
        return np.where(lost[..., None], np.nan, found)

    def _fisheye_start(self, points: np.ndarray) -> np.ndarray:
        r = np.linalg.norm(points, axis=-1, keepdims=True)
        return points * np.where(r > 1e-9, np.tan(np.minimum(r, 1.45)) / np.maximum(r, 1e-9), 1.0)


def _series(coefficients: tuple[float, ...], squared: np.ndarray) -> np.ndarray:
    total = np.zeros_like(squared)
    for coefficient in reversed(coefficients):
        total = (total + coefficient) * squared
    return 1.0 + total


def from_colmap(model: str, params: list[float]) -> tuple[tuple[float, float, float, float], Distortion]:
    """COLMAP's camera model and parameters -> (fx, fy, cx, cy) and the distortion; InvalidValue for other models."""
    shared = {"SIMPLE_PINHOLE": 0, "SIMPLE_RADIAL": 1, "RADIAL": 2, "SIMPLE_RADIAL_FISHEYE": 1, "RADIAL_FISHEYE": 2,
              "SIMPLE_FISHEYE": 0}  # fmt: skip
    separate = {"PINHOLE": 0, "OPENCV": 4, "FULL_OPENCV": 8, "OPENCV_FISHEYE": 4, "FISHEYE": 0}
    count = shared.get(model, separate.get(model))
    if count is None:
        known = ", ".join([*shared, *separate])
        raise InvalidValue(
            f"its camera model {model} is not known; undistort the pictures first, or use one of {known}"
        )
    lead = 3 if model in shared else 4
    if len(params) != lead + count:
        raise InvalidValue(f"camera model {model} takes {lead + count} parameters, found {len(params)}")
    f = [params[0], *params] if model in shared else list(params)
    rest = tuple(float(value) for value in f[4:])
    if model.endswith("FISHEYE"):
        return tuple(f[:4]), Distortion("fisheye", rest)
    if model in separate and count:
        return tuple(f[:4]), Distortion("brown", rest[:2] + rest[4:5], rest[2:4], rest[5:8])
    return tuple(f[:4]), Distortion("brown", rest)


# A search that runs off to infinity ends in NaN, which is asked for below; numpy need not warn of it too.
@np.errstate(over="ignore", invalid="ignore")
def pinhole_of(
    size: tuple[int, int], intrinsics: tuple[float, float, float, float], distortion: Distortion
) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of the pinhole of the same size (width, height) and shape of pixels that shows most of the picture
    without a blank pixel.

    InvalidValue where the distortion folds the picture so that its edge has no counterpart.
    """
    if distortion.none:
        return intrinsics
    (width, height), (fx, fy, cx, cy) = size, intrinsics
    along = np.linspace(0.0, 1.0, 65)
    lower, upper = [], []
    for axis, extent in ((0, (width, height)), (1, (height, width))):
        for far_side in (0, 1):
            edge = np.empty((65, 2))
            edge[:, axis] = far_side * extent[0]
            edge[:, 1 - axis] = along * extent[1]
            ideal = distortion.undistort((edge - [cx, cy]) / [fx, fy])[:, axis]
            if distortion.kind == "fisheye":
                ideal = np.nan_to_num(ideal, nan=np.inf if far_side else -np.inf)
            if np.isnan(ideal).any():
                raise InvalidValue(
                    "its distortion coefficients fold the picture at its edge; check k1, k2, p1, p2, the focal length"
                )
            (upper if far_side else lower).append(ideal.min() if far_side else ideal.max())
    lower, upper = np.maximum(lower, -WIDEST_SLOPE), np.minimum(upper, WIDEST_SLOPE)
    if not (lower < upper).all():
        raise InvalidValue("its distortion leaves no rectangle of the picture; check its coefficients")
    # One scale: pixels keep the shape that they have on the sensor, and the longer way of the rectangle is cut.
    scale = max(width / (upper[0] - lower[0]) / fx, height / (upper[1] - lower[1]) / fy)
    fx, fy = scale * fx, scale * fy
    cx, cy = np.array([width, height]) / 2 - (lower + upper) / 2 * [fx, fy]
    return float(fx), float(fy), float(cx), float(cy)


def source_positions(
    size: tuple[int, int],
    pinhole: tuple[float, float, float, float],
    intrinsics: tuple[float, float, float, float],
    distortion: Distortion,
) -> np.ndarray:
    """For each pixel center of the pinhole picture, its position on the distorted one: [height, width, 2] float32,
    pixel (i, j) having its center at (i + 0.5, j + 0.5)."""
    width, height = size
    rows, columns = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")
    ideal = np.stack([(columns - pinhole[2]) / pinhole[0], (rows - pinhole[3]) / pinhole[1]], axis=-1)
    return (distortion.distort(ideal) * intrinsics[:2] + intrinsics[2:]).astype(np.float32)
