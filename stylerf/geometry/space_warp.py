"""Warps of scene space to the unit cube in which fields are defined.

box: an axis-aligned box, for objects. contraction: linear inside a box, with the rest of space contracted into a shell
around it (Barron et al. 2022, eq. 10, with the maximum norm, which fills the cube). frustum: normalized device
coordinates of the mean camera (Mildenhall et al. 2020, appendix C), for forward-facing captures.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.validation import LARGEST

KINDS = ("box", "contraction", "frustum")
# How far a camera may be inside a frustum, in near depths, with its views still starting at `near`, as in training:
# captures show nothing nearer than 1 / FORWARD_NEAR of it (scene_normalization.py), and their cameras stay behind.
AHEAD = 0.25


@dataclass(frozen=True)
class SpaceWarp:
    """A warp of scene space to the unit cube.

    Attributes:
        kind: One of KINDS.
        parameters: 7 floats, in the kernels' layout.
        near, far: Range of ray marching, scene units; near is the distance from the camera, see view_start().
    """

    kind: str
    parameters: tuple[float, ...]
    near: float
    far: float

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InvalidValue(f"unknown space kind {self.kind!r}; expected one of {', '.join(KINDS)}")
        if not (0 <= self.near < self.far <= LARGEST and np.abs(self.parameters).max() <= LARGEST):
            raise InvalidValue(f"space: near {self.near:g}, far {self.far:g} or a parameter is out of range")
        # Kernels divide by these in float32; the last parameter of a box is the mean of its three scales.
        divisors = self.parameters[:3] if self.kind == "frustum" else self.parameters[3:6]
        mean = 0.0 if self.kind == "frustum" else float(np.mean(divisors))
        if min(divisors) < 1 / LARGEST or not np.isclose(self.parameters[6], mean, rtol=1e-6):
            raise InvalidValue(f"space: parameters {self.parameters} do not describe a {self.kind}")

    @staticmethod
    def box(low: ArrayLike, high: ArrayLike, near: float = 0.0, far: float = 1e6, kind: str = "box") -> "SpaceWarp":
        """Return a box, or a contraction with this uncontracted box, between two corners, scene units."""
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
        """Return the frustum |x| <= half_width z, |y| <= half_height z, z >= near.

        Args:
            half_width, half_height: Half sides at z = 1.
            near, far: Range of ray marching, scene units.
            parallax: Parallax of the nearest point between views, baseline / near, which determines the depth
                resolution; 0: the same as for the sides.
        """
        values = half_width, half_height, near, parallax, 0.0, 0.0, 0.0
        return SpaceWarp("frustum", tuple(float(value) for value in values), near, far)

    @property
    def code(self) -> int:
        """The kind's code in the kernels."""
        return KINDS.index(self.kind)

    def packed(self) -> np.ndarray:
        """Return the parameters as [7] float32."""
        return np.asarray(self.parameters, dtype=np.float32)

    def cells_per_axis(self, resolution: int) -> np.ndarray:
        """Return the number of vertices per axis, [3] int64: `resolution`^3 in total, evenly spaced.

        The sides of a frustum are measured in the image: its width, its height and the nearest point's parallax.
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

    def color_cells(self, resolution: int) -> np.ndarray:
        """Return cells_per_axis() for colors: in a frustum, a third finer laterally and half as fine in depth.

        Photos show lateral detail; in depth, the density already separates surfaces (decision 0055).
        """
        across_and_depth = (4 / 3, 4 / 3, 1 / 2) if self.kind == "frustum" else (1, 1, 1)
        sides = np.round(self.cells_per_axis(resolution) * np.array(across_and_depth))
        return np.maximum(8, sides).astype(np.int64)

    def marching_step(self, resolution: int) -> float:
        """Return the marching step for a density of `resolution`^3, cube units.

        One sample per cell; in a frustum, which rays cross in depth, where less detail is needed than laterally, two
        samples per three cells (decision 0059).
        """
        return (1.5 if self.kind == "frustum" else 1.0) / resolution

    def warp(self, points: np.ndarray) -> np.ndarray:
        """Map world points [n, 3] to the unit cube, float64: the reference for the kernels."""
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
        # With m clamped to at least 1, (2 - 1/m)/m is 1 inside the box: one formula for inside and outside.
        largest = np.maximum(np.abs(local).max(-1, keepdims=True), 1.0)
        return np.clip(0.5 + 0.25 * local * (2 - 1 / largest) / largest, 0, 1)

    def unwarp(self, cube: np.ndarray) -> np.ndarray:
        """Map points of the open unit cube [n, 3] to world points, float64: the inverse of warp()."""
        cube = np.asarray(cube, dtype=np.float64)
        p = self.parameters
        if self.kind == "frustum":
            z = p[2] / np.maximum(1 - cube[:, 2], 1e-9)  # the far face is at infinity
            return np.stack([(cube[:, 0] * 2 - 1) * p[0] * z, (cube[:, 1] * 2 - 1) * p[1] * z, z], -1)
        if self.kind == "box":
            return np.asarray(p[:3]) + cube / np.asarray(p[3:6])
        local = (cube - 0.5) * 4
        largest = np.abs(local).max(-1, keepdims=True)
        reach = np.maximum(largest, 1.0)
        # The inverse of m' = 2 - 1/m, which reaches 2 at infinity.
        radius = np.where(largest > 1, 1 / np.maximum(2 - reach, 1e-9), largest)
        return np.asarray(p[:3]) + local / np.maximum(largest, 1e-12) * radius / np.asarray(p[3:6])

    def view_start(self, center: np.ndarray) -> float:
        """Return the distance, scene units, at which a rendered view's rays start. center: of its camera, [3].

        This is `near`, except in a frustum if the camera has moved towards or past the near plane.
        """
        ahead = float(center[2]) if self.kind == "frustum" else 0.0
        if ahead <= AHEAD * self.near:
            return self.near
        return max(self.near - ahead, 1e-3 * self.near)  # not 0, which marks empty depth

    @property
    def middle(self) -> float:
        """Depth, scene units, half way from a camera to infinity when depth is measured as t / (t + middle)."""
        return self.parameters[2] if self.kind == "frustum" else 1.0

    def describe(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {"kind": self.kind, "parameters": list(self.parameters), "near": self.near, "far": self.far}

    @staticmethod
    def restore(data: dict[str, Any]) -> "SpaceWarp":
        """Rebuild a warp from its JSON form."""
        kind, parameters = validation.one_of(data, "kind", KINDS), tuple(validation.numbers(data, "parameters", 7))
        return SpaceWarp(kind, parameters, validation.number(data, "near"), validation.number(data, "far"))
