"""Lens distortion and its inverse.

Undistorted points are (x, y) = (X/Z, Y/Z); distorted ones are normalized image coordinates (u - cx)/fx, (v - cy)/fy.
"""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.lens_models import LENSES, tangent_of

KINDS = ("brown", "fisheye", *LENSES)
# A pinhole image cannot span 180 degrees: a fisheye is cropped at this slope, 63 degrees off the axis.
WIDEST_SLOPE = 2.0
BAND_ROWS = 64

Intrinsics = tuple[float, float, float, float]  # fx, fy, cx, cy


@dataclass(frozen=True)
class Distortion:
    """A lens model.

    brown (Brown 1966, OpenCV's model): x' = x N(r^2)/D(r^2) + 2 p1 x y + p2 (r^2 + 2 x^2), y' likewise with p1 and p2
    swapped, N = 1 + sum radial[i] r^(2i+2), D = 1 + sum denominator[i] r^(2i+2).

    fisheye (Kannala-Brandt): x' = x theta'/r, theta = atan(r), theta' = theta (1 + sum radial[i] theta^(2i+2)).

    Other kinds: lens_models.py, with their parameters in `others`.
    """

    kind: str = "brown"
    radial: tuple[float, ...] = ()
    tangential: tuple[float, float] = (0.0, 0.0)
    denominator: tuple[float, ...] = ()
    others: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InvalidValue(f"unknown distortion {self.kind!r}")
        if not np.isfinite([*self.radial, *self.tangential, *self.denominator, *self.others]).all():
            raise InvalidValue("a distortion coefficient is NaN or infinite")

    @property
    def none(self) -> bool:
        """Whether there is no distortion."""
        return self.kind == "brown" and not any((*self.radial, *self.tangential, *self.denominator))

    def distort(self, points: np.ndarray) -> np.ndarray:
        """Return distorted points [..., 2] for undistorted points [..., 2]."""
        if self.kind in LENSES:
            return LENSES[self.kind][0](points, self.others)
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
        """Return undistorted points [..., 2] for distorted points [..., 2], by Newton's method; NaN where it fails."""
        points = np.asarray(points, dtype=np.float64)
        found = self._start(points)
        # Forward differences: their error slows convergence but does not change the solution, a zero of the residual.
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
        lost = ~(np.abs(self.distort(found) - points).max(axis=-1) < 1e-7)  # negated, so that NaN counts as lost
        return np.where(lost[..., None], np.nan, found)

    def _start(self, points: np.ndarray) -> np.ndarray:
        if self.kind == "fisheye":
            return tangent_of(points, ())
        return LENSES[self.kind][1](points, self.others) if self.kind in LENSES else points.copy()


def _series(coefficients: tuple[float, ...], squared: np.ndarray) -> np.ndarray:
    total = np.zeros_like(squared)
    for coefficient in reversed(coefficients):
        total = (total + coefficient) * squared
    return 1.0 + total


def from_colmap(model: str, params: list[float]) -> tuple[Intrinsics, Distortion]:
    """Convert a COLMAP camera model and its parameters to (fx, fy, cx, cy) and a distortion.

    Raises:
        InvalidValue: The model is unknown or the number of parameters is wrong.
    """
    shared = {"SIMPLE_PINHOLE": 0, "SIMPLE_RADIAL": 1, "RADIAL": 2, "SIMPLE_RADIAL_FISHEYE": 1, "RADIAL_FISHEYE": 2,
              "SIMPLE_FISHEYE": 0}  # fmt: skip
    separate = {"PINHOLE": 0, "OPENCV": 4, "FULL_OPENCV": 8, "OPENCV_FISHEYE": 4, "FISHEYE": 0}
    if model == "SIMPLE_DIVISION":
        model, params = "DIVISION", [*params[:1], *params]
    kind = model.lower()
    count = LENSES[kind][2] if kind in LENSES else shared.get(model, separate.get(model))
    if count is None:
        known = ", ".join([*shared, *separate, *map(str.upper, LENSES), "SIMPLE_DIVISION"])
        raise InvalidValue(f"its camera model {model} is unknown; undistort the images first, or use one of {known}")
    lead = 3 if model in shared else 4
    if len(params) != lead + count:
        raise InvalidValue(f"camera model {model} takes {lead + count} parameters, found {len(params)}")
    fx, fy, cx, cy = [params[0], *params[:3]] if model in shared else params[:4]
    rest = tuple(float(value) for value in params[lead:])
    if kind in LENSES:
        return (fx, fy, cx, cy), Distortion(kind, others=rest)
    if model.endswith("FISHEYE"):
        return (fx, fy, cx, cy), Distortion("fisheye", rest)
    if model in separate and count:
        k1, k2, p1, p2, *more = rest
        return (fx, fy, cx, cy), Distortion("brown", (k1, k2, *more[:1]), (p1, p2), tuple(more[1:4]))
    return (fx, fy, cx, cy), Distortion("brown", rest)


# Newton's method may diverge to NaN, which is checked below.
@np.errstate(over="ignore", invalid="ignore")
def pinhole_of(size: tuple[int, int], intrinsics: Intrinsics, distortion: Distortion) -> Intrinsics:
    """Return the pinhole camera that shows as much as possible of a distorted image without blank pixels.

    It has the same size (width, height) and pixel aspect ratio.

    Raises:
        InvalidValue: The distortion folds the image, so its edge cannot be undistorted.
    """
    if distortion.none:
        return intrinsics
    (width, height), (fx, fy, cx, cy) = size, intrinsics
    along = np.linspace(0.0, 1.0, 65)
    lows: list[float] = []
    highs: list[float] = []
    for axis, extent in ((0, (width, height)), (1, (height, width))):
        for far_side in (0, 1):
            edge = np.empty((65, 2))
            edge[:, axis] = far_side * extent[0]
            edge[:, 1 - axis] = along * extent[1]
            ideal = distortion.undistort((edge - [cx, cy]) / [fx, fy])[:, axis]
            if distortion.kind != "brown":
                ideal = np.nan_to_num(ideal, nan=np.inf if far_side else -np.inf)  # too far off the axis: cropped below
            if np.isnan(ideal).any():
                raise InvalidValue(
                    "its distortion coefficients fold the image at its edge; check k1, k2, p1, p2, the focal length"
                )
            # The innermost point of a curved edge, so that no pixels beyond it are shown.
            (highs if far_side else lows).append(float(ideal.min() if far_side else ideal.max()))
    lower, upper = np.maximum(lows, -WIDEST_SLOPE), np.minimum(highs, WIDEST_SLOPE)
    if not np.all(lower < upper):
        raise InvalidValue("its distortion leaves no rectangle of the image; check its coefficients")
    # A single scale preserves the pixel aspect ratio; the longer side of the rectangle is cropped.
    scale = max(width / (upper[0] - lower[0]) / fx, height / (upper[1] - lower[1]) / fy)
    fx, fy = scale * fx, scale * fy
    cx, cy = np.array([width, height]) / 2 - (lower + upper) / 2 * [fx, fy]
    return float(fx), float(fy), float(cx), float(cy)


def source_positions(
    size: tuple[int, int], pinhole: Intrinsics, intrinsics: Intrinsics, distortion: Distortion
) -> np.ndarray:
    """Return, for each pixel center of the pinhole image, its position in the distorted image.

    Returns:
        [height, width, 2] float32, in pixels; pixel (i, j) has its center at (i + 0.5, j + 0.5).
    """
    width, height = size
    positions = np.empty((height, width, 2), np.float32)
    x = (np.arange(width) + 0.5 - pinhole[2]) / pinhole[0]
    for top in range(0, height, BAND_ROWS):  # a lens model needs ten times the memory of its positions
        y = (np.arange(top, min(top + BAND_ROWS, height)) + 0.5 - pinhole[3]) / pinhole[1]
        ideal = np.stack(np.meshgrid(x, y), axis=-1)
        positions[top : top + len(y)] = distortion.distort(ideal) * intrinsics[:2] + intrinsics[2:]
    return positions
