"""Warps of unbounded scene space to the unit cube that the fields live in.

box: an axis-aligned box, for objects. contraction: identity inside a box, all else drawn into a shell around it
(Barron et al. 2022, eq. 10, in the maximum norm so that the cube is filled). frustum: normalized device coordinates of
the average camera (Mildenhall et al. 2020, appendix C), for forward-facing captures.
"""

from dataclasses import dataclass

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.validation import LARGEST

KINDS = ("box", "contraction", "frustum")


@dataclass(frozen=True)
class SpaceWarp:
    """A warp: `kind` of KINDS; its float32 parameters as the kernels read them; marching bounds in scene units."""

    kind: str
    parameters: tuple[float, ...]
    near: float
    far: float

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InvalidValue(f"space kind {self.kind!r} is none of {', '.join(KINDS)}")
        if not (0 <= self.near < self.far <= LARGEST and np.abs(self.parameters).max() <= LARGEST):
            raise InvalidValue(f"space: near {self.near:g}, far {self.far:g} or a parameter is out of range")
        # What is divided by, in float32; of boxes the last is the mean of the three.
        divisors = self.parameters[:3] if self.kind == "frustum" else self.parameters[3:6]
        mean = 0.0 if self.kind == "frustum" else float(np.mean(divisors))
        if min(divisors) < 1 / LARGEST or not np.isclose(self.parameters[6], mean, rtol=1e-6):
            raise InvalidValue(f"space: parameters {self.parameters} make no {self.kind}")

    @staticmethod
    def box(low, high, near: float = 0.0, far: float = 1e6, kind: str = "box") -> "SpaceWarp":
        """Box (or the uncontracted box of a contraction) between two corners, scene units."""
        low, high = np.asarray(low, float), np.asarray(high, float)
        if not (high > low).all():
            raise InvalidValue(f"box corners {low} and {high} do not span a volume")
        extent = high - low
        if kind == "contraction":
            half = extent / 2
            values = (*((low + high) / 2), *(1 / half), float(np.mean(1 / half)))
        else:
            values = (*low, *(1 / extent), float(np.mean(1 / extent)))
        return SpaceWarp(kind, tuple(float(v) for v in values), float(near), float(far))

    @staticmethod
    def frustum(half_width: float, half_height: float, near: float, far: float, parallax: float = 0.0) -> "SpaceWarp":
        """Frustum along +z of the frame: |x| <= half_width z, |y| <= half_height z, z >= near.

        parallax: by how much views see the nearest point apart, against what is infinitely far, in the units of the
        half sides (baseline / near): it tells how finely depth need be told apart. 0: as finely as the sides.
        """
        values = half_width, half_height, near, parallax, 0.0, 0.0, 0.0
        return SpaceWarp("frustum", tuple(float(value) for value in values), near, far)

    @property
    def code(self) -> int:
        """Number of the kind, as the kernels know it."""
        return KINDS.index(self.kind)

    def packed(self) -> np.ndarray:
        """Parameters, [7] float32."""
        return np.asarray(self.parameters, dtype=np.float32)

    def cells_per_axis(self, resolution: int) -> np.ndarray:
        """Vertices per axis, [3] int64, so that `resolution`^3 vertices are spread evenly over the sides.

        Those of a frustum are as views see them: its width, its height and the parallax of its nearest point.
        """
        if self.kind == "contraction" or (self.kind == "frustum" and self.parameters[3] <= 0):
            return np.full(3, resolution, dtype=np.int64)
        if self.kind == "box":
            extent = 1.0 / np.asarray(self.parameters[3:6])
        else:
            width, height, _, parallax = self.parameters[:4]
            widest = 2 * max(width, height)
            extent = np.array([2 * width, 2 * height, np.clip(parallax, widest / 4, widest)])
        sides = resolution * extent / np.prod(extent) ** (1 / 3)
        return np.maximum(8, np.round(sides)).astype(np.int64)

    def warp(self, points: np.ndarray) -> np.ndarray:
        """World points [n, 3] to the unit cube, float64: the definition that the kernels are tested against."""
        points = np.asarray(points, dtype=np.float64)
        p = self.parameters
        if self.kind == "frustum":
            z = np.maximum(points[:, 2], p[2] / 2)
            return np.clip(
                np.stack(
                    [0.5 + 0.5 * points[:, 0] / (z * p[0]), 0.5 + 0.5 * points[:, 1] / (z * p[1]), 1 - p[2] / z], -1
                ),
                0,
                1,
            )
        local = (points - np.asarray(p[:3])) * np.asarray(p[3:6])
        if self.kind == "box":
            return np.clip(local, 0, 1)
        largest = np.maximum(np.abs(local).max(-1, keepdims=True), 1.0)
        return np.clip(0.5 + 0.25 * local * (2 - 1 / largest) / largest, 0, 1)

    def unwarp(self, cube: np.ndarray) -> np.ndarray:
        """Inverse of `warp` inside the open cube: [n, 3] -> world points, float64."""
        cube = np.asarray(cube, dtype=np.float64)
        p = self.parameters
        if self.kind == "frustum":
            z = p[2] / np.maximum(1 - cube[:, 2], 1e-9)
            return np.stack([(cube[:, 0] * 2 - 1) * p[0] * z, (cube[:, 1] * 2 - 1) * p[1] * z, z], -1)
        if self.kind == "box":
            return np.asarray(p[:3]) + cube / np.asarray(p[3:6])
        local = (cube - 0.5) * 4
        largest = np.abs(local).max(-1, keepdims=True)
        reach = np.maximum(largest, 1.0)
        radius = np.where(largest > 1, 1 / np.maximum(2 - reach, 1e-9), largest)
        return np.asarray(p[:3]) + local / np.maximum(largest, 1e-12) * radius / np.asarray(p[3:6])

    def describe(self) -> dict:
        """JSON form."""
        return {"kind": self.kind, "parameters": list(self.parameters), "near": self.near, "far": self.far}

    @staticmethod
    def restore(data: dict) -> "SpaceWarp":
        """From its JSON form."""
        kind, parameters = validation.one_of(data, "kind", KINDS), tuple(validation.numbers(data, "parameters", 7))
        return SpaceWarp(kind, parameters, validation.number(data, "near"), validation.number(data, "far"))
