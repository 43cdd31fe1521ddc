"""A capture of white dots in the air, photographed from six known cameras: closed-form poses for any format of them."""

from pathlib import Path

import numpy as np

from schemas.images import read_image, write_png
from tests.stages.importing import scene_of
from tests.stages.photo_room import look_at
from tests.stylerf_cli.capture import quaternion

WIDTH, HEIGHT, FOCAL = 160, 120, 150.0
POINTS = np.random.default_rng(1).uniform(-1, 1, (30, 3))
LENSES = (
    ("SIMPLE_PINHOLE", (150, 84, 57)),
    ("PINHOLE", (150, 170, 84, 57)),
    ("SIMPLE_RADIAL", (150, 84, 57, -0.1)),
    ("RADIAL", (150, 84, 57, -0.1, 0.05)),
    ("OPENCV", (150, 160, 84, 57, -0.1, 0.02, 0.01, -0.02)),
    ("FULL_OPENCV", (150, 160, 84, 57, -0.1, 0.02, 0.01, -0.02, 0.01, 0.02, 0.01, 0)),
    ("OPENCV_FISHEYE", (150, 160, 84, 57, 0.03, -0.02, 0.01, 0)),
    ("SIMPLE_RADIAL_FISHEYE", (150, 84, 57, 0.03)),
    ("RADIAL_FISHEYE", (150, 84, 57, 0.03, -0.02)),
    ("SIMPLE_FISHEYE", (150, 84, 57)),
    ("FISHEYE", (150, 160, 84, 57)),
    ("FOV", (150, 160, 84, 57, 0.7)),
    ("THIN_PRISM_FISHEYE", (150, 160, 84, 57, 0.03, -0.02, 0.01, -0.005, 0.01, 0, 0.01, -0.02)),
    ("RAD_TAN_THIN_PRISM_FISHEYE",
     (150, 160, 84, 57, 0.03, -0.02, 0.01, 0, 0, 0, 0.01, -0.005, 0.01, 0.005, -0.01, 0.002)),
    ("SIMPLE_DIVISION", (150, 84, 57, -0.3)),
    ("DIVISION", (150, 160, 84, 57, -0.2)),
    ("EUCM", (150, 160, 84, 57, 0.6, 1.1)),
)  # fmt: skip


def poses(count: int = 6) -> list[np.ndarray]:
    """world_from_camera [4, 4], OpenCV axes, on a ring around the dots, of which no two see the same."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return [
        look_at((4 * np.cos(a), 4 * np.sin(a), 1.2 + 0.4 * np.sin(3 * a)), (0, 0, 0)).world_from_camera for a in angles
    ]


def quaternion_and_shift(pose: np.ndarray) -> list[float]:
    """Of camera_from_world, as COLMAP has it."""
    inverse = np.linalg.inv(pose)
    return [*map(float, quaternion(inverse[:3, :3])), *map(float, inverse[:3, 3])]


def seen(pose: np.ndarray, intrinsics=(FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2), points: np.ndarray = POINTS) -> np.ndarray:
    """Pixels [n, 2] of points through a pinhole (fx, fy, cx, cy)."""
    inverse = np.linalg.inv(pose)
    inside = points @ inverse[:3, :3].T + inverse[:3, 3]
    return inside[:, :2] / inside[:, 2:] * intrinsics[:2] + intrinsics[2:]


def write_photos(folder: Path, names: list[str], lens=None, project=None, size=(WIDTH, HEIGHT), blank=False) -> None:
    """folder/NAME of each. lens: a COLMAP model and its parameters, through which pycolmap projects; project: from
    points in the camera's frame [n, 3] to pixels; else the pinhole of FOCAL. blank: another picture of noise alone.
    """
    for name, pose in zip(names, poses(len(names)), strict=True):
        inverse = np.linalg.inv(pose)
        inside = POINTS @ inverse[:3, :3].T + inverse[:3, 3]
        if lens:
            import pycolmap

            camera = pycolmap.Camera(model=lens[0], width=WIDTH, height=HEIGHT, params=lens[1])
            places = np.array([camera.img_from_cam(one) for one in inside])
        else:
            places = project(inside) if project else seen(pose)
        write_png(folder / name, _photo(places[:0] if blank else places, size))


def _photo(places: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    gray = np.random.default_rng(0).uniform(0.05, 0.25, (size[1], size[0]))
    for x, y in places:
        across, down = (
            np.exp(-((np.arange(side) + 0.5 - at) ** 2) / 3.4) for side, at in zip(size, (x, y), strict=True)
        )
        spot = down[:, None] * across
        gray = gray * (1 - spot) + spot
    return np.repeat((gray * 255).astype(np.uint8)[..., None], 3, axis=2)


def error(artifact, points: np.ndarray = POINTS) -> float:
    """Median distance in pixels of the dots in an imported picture from where its camera puts them: the worst view's.

    Infinite where a view shows fewer than four dots that stand apart.
    """
    scene = scene_of(artifact)
    moved = np.array(scene.scene_from_source)
    inside = points @ moved[:3, :3].T + moved[:3, 3]
    worst = 0.0
    for view in scene.views:
        places = seen(np.array(view.world_from_camera), (view.fx, view.fy, view.cx, view.cy), inside)
        picture = read_image(artifact.path / view.image).pixels[..., :3].min(axis=2)
        errors = []
        for index, (x, y) in enumerate(places):
            apart = np.hypot(*(np.delete(places, index, axis=0) - places[index]).T).min()
            if apart > 9 and 7 < x < view.width - 7 and 7 < y < view.height - 7:
                left, top = int(x) - 5, int(y) - 5
                light = (picture[top : top + 11, left : left + 11] - 0.3).clip(0)
                rows, columns = np.mgrid[top : top + 11, left : left + 11] + 0.5
                total = max(light.sum(), 1e-9)
                errors.append(np.hypot((light * columns).sum() / total - x, (light * rows).sum() / total - y))
        worst = max(worst, float(np.median(errors)) if len(errors) > 3 else np.inf)
    return worst
