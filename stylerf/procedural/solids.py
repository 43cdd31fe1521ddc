"""The arrangement of the still life: its solids and their poses, packed into arrays for the kernels."""

from dataclasses import dataclass
from math import atan2, cos, radians, sin, sqrt

import numpy as np

from stylerf.procedural import shapes

TABLE_TOP = -0.42
TABLE_RADIUS = 1.2


@dataclass(frozen=True)
class Solid:
    """One solid: its shape, its pose, and its local bounding box.

    params: up to four parameters of the shape. low, high: corners of the local bounding box, scene units.
    world_from_local: [4, 4], a rigid transform.
    """

    name: str
    kind: int
    params: tuple[float, ...]
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    world_from_local: np.ndarray


def standing(x: float, y: float, turn_deg: float = 0.0, lift: float = 0.0) -> np.ndarray:
    """Return a pose [4, 4] on the table top at (x, y), rotated about the vertical, raised by `lift` scene units."""
    c, s = cos(radians(turn_deg)), sin(radians(turn_deg))
    pose = np.eye(4)
    pose[:2, :2] = [[c, -s], [s, c]]
    pose[:3, 3] = x, y, TABLE_TOP + lift
    return pose


def tipped(angle_deg: float) -> np.ndarray:
    """Return a rotation [4, 4] about the x axis, +y towards +z."""
    c, s = cos(radians(angle_deg)), sin(radians(angle_deg))
    turn = np.eye(4)
    turn[1:3, 1:3] = [[c, -s], [s, c]]
    return turn


def moved(x: float, y: float, z: float) -> np.ndarray:
    """Return a translation [4, 4]."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def leaning_cube(book: np.ndarray, depth: float, thickness: float, half: float, reach: float) -> np.ndarray:
    """Return the pose of a cube on an edge, `reach` in front of a flat book's long side, leaning on its upper edge.

    book: pose of the book's center on the table (local y across its short side); depth, thickness: full sides.
    The tilt is atan(thickness / reach), so that the cube's lower face touches the book's edge.
    """
    tilt = np.degrees(atan2(thickness, reach))
    edge = moved(-0.06, -0.5 * depth - reach, -0.5 * thickness)  # the cube's lower edge, in the book's frame
    return book @ edge @ tipped(tilt) @ moved(0.0, half, half)


def arrangement() -> list[Solid]:
    """Return the solids of the still life, within [-1.25, 1.25]^3, on the table top z = TABLE_TOP."""
    radius, thick = TABLE_RADIUS, 0.11
    ball, major, minor = 0.205, 0.185, 0.058
    rest = sqrt((ball + minor) ** 2 - major**2) + minor  # height of the center of a ball that rests in a flat ring
    length, depth, height = 0.30, 0.21, 0.062  # half sides of the book
    book = standing(0.47, 0.28, 32.0, height)
    cube = leaning_cube(book, 2 * depth, 2 * height, 0.145, 0.2)
    wax = 0.46
    lemon = _around(0.22, 0.145, 0.145)
    low = (-radius, -radius, -thick)
    table = Solid("table", shapes.DISC, (radius, thick, 0.03), low, (radius, radius, 0.0), moved(0, 0, TABLE_TOP))
    holder, candle = standing(-0.76, 0.16, -60.0), standing(-0.76, 0.16, 0.0, 0.105)
    fire = standing(-0.757, 0.16, 0.0, 0.105 + wax + 0.01)
    return [
        table,
        Solid("vase", shapes.VASE, (), (-0.29, -0.29, 0.0), (0.29, 0.29, 1.115), standing(-0.16, 0.46, 20.0)),
        Solid("pear", shapes.PEAR, (), (-0.2, -0.2, 0.0), (0.2, 0.2, 0.605), standing(-0.33, -0.2, -50.0)),
        Solid("apple", shapes.APPLE, (), (-0.22, -0.22, 0.0), (0.22, 0.22, 0.41), standing(0.12, -0.27, 30.0)),
        Solid("lemon", shapes.LEMON, (), *lemon, standing(0.52, -0.62, 35.0, 0.136)),
        Solid("lemon on the book", shapes.LEMON, (), *lemon, standing(0.52, 0.40, -25.0, 2 * height + 0.136)),
        Solid("book", shapes.BOOK, (length, depth, height), *_around(length, depth, height), book),
        Solid("cube", shapes.BOX, (0.145, 0.145, 0.145, 0.012), *_around(0.145, 0.145, 0.145), cube),
        Solid("ring", shapes.TORUS, (major, minor), *_around(0.245, 0.245, 0.06), standing(-0.70, -0.48, 0.0, minor)),
        Solid("ball", shapes.SPHERE, (ball,), *_around(ball, ball, ball), standing(-0.70, -0.48, 40.0, rest)),
        Solid("candle holder", shapes.HOLDER, (), (-0.21, -0.295, 0.0), (0.21, 0.21, 0.135), holder),
        Solid("candle", shapes.CANDLE, (wax,), (-0.08, -0.08, 0.0), (0.08, 0.08, wax + 0.05), candle),
        Solid("flame", shapes.FLAME, (), (-0.04, -0.04, -0.002), (0.04, 0.04, 0.165), fire),
        Solid("grapes", shapes.GRAPES, (), (-0.31, -0.27, 0.0), (0.27, 0.27, 0.27), standing(-0.12, -0.74, 15.0)),
    ]


def _around(a: float, b: float, c: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return the corners of a box about the origin with half sides a, b, c."""
    return (-a, -b, -c), (a, b, c)


def pack(solids: list[Solid]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pack solids into the kernels' arrays: kinds [n], poses [n, 12], params [n, 4], boxes [n, 6] (see tracing.py)."""
    kinds = np.array([solid.kind for solid in solids], np.int64)
    poses = np.stack([np.concatenate([s.world_from_local[:3, :3].ravel(), s.world_from_local[:3, 3]]) for s in solids])
    params = np.zeros((len(solids), 4))
    for row, solid in zip(params, solids):
        row[: len(solid.params)] = solid.params
    boxes = np.array([[*solid.low, *solid.high] for solid in solids], np.float64)
    return kinds, poses, params, boxes
