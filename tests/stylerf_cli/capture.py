"""A small posed capture to be damaged: four photos around a corner, with transforms.json, COLMAP or LLFF poses."""

import json
from pathlib import Path

import numpy as np

from schemas.images import write_png
from stylerf.geometry.cameras import Camera
from tests.stages.photo_room import walk

WIDTH, HEIGHT, FOCAL = 48, 36, 45.0
GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])


def cameras() -> list[Camera]:
    """Four of them, named p00 to p03."""
    return walk(4, width=WIDTH, height=HEIGHT, focal=FOCAL)


def write_images(folder: Path) -> None:
    """images/pNN.png: smooth colors, none of them black."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    for number, camera in enumerate(cameras()):
        pixels = np.stack([40 + 4 * columns, 60 + 5 * rows, np.full_like(rows, 90 + 20 * number)], -1)
        write_png(folder / "images" / f"{camera.name}.png", pixels.astype(np.uint8))


def transforms() -> dict:
    """As instant-ngp writes it."""
    frames = [
        {"file_path": f"images/{one.name}.png", "transform_matrix": (one.world_from_camera @ GL_FROM_CV).tolist()}
        for one in cameras()
    ]
    return {"w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "fl_y": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2, "frames": frames}


def write_transforms(folder: Path, content: object) -> None:
    """NaN and infinities stay what they are, as Python's own writer has it."""
    (folder / "transforms.json").write_text(json.dumps(content))


def write_colmap(
    folder: Path, camera: str = f"1 PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2}"
) -> None:
    """sparse/0 as text; `camera`: the one line of cameras.txt."""
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    lines = []
    for number, one in enumerate(cameras(), start=1):
        inverse = one.camera_from_world
        numbers = [*quaternion(inverse[:3, :3]), *inverse[:3, 3]]
        lines += [f"{number} {' '.join(f'{value:.12f}' for value in numbers)} 1 {one.name}.png", ""]
    (model / "cameras.txt").write_text(camera + "\n")
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    (model / "points3D.txt").write_text("")


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(w, x, y, z) of a rotation: the eigenvector of Bar-Itzhack's symmetric matrix (2000) to its largest value."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    matrix = [[a - e - i, d + b, g + c, h - f], [d + b, e - a - i, h + f, c - g], [g + c, h + f, i - a - e, d - b],
              [h - f, c - g, d - b, a + e + i]]  # fmt: skip
    x, y, z, w = np.linalg.eigh(np.array(matrix) / 3)[1][:, -1]
    return np.array([w, x, y, z])


def llff() -> np.ndarray:
    """[4, 17]."""
    rows = []
    for one in cameras():
        right, down, forward, center = one.world_from_camera[:3].T
        pose = np.column_stack([down, right, -forward, center, [HEIGHT, WIDTH, FOCAL]])
        rows.append([*pose.ravel(), 1.0, 9.0])
    return np.array(rows)
