"""A colored ball of splats, cameras around it, and the files in which 3D Gaussian splatting keeps both."""

import json
from pathlib import Path

import numpy as np

from stylerf.geometry.cameras import Camera
from tests.stages.photo_room import look_at

NAMES = (
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
)  # fmt: skip
C0 = 0.28209479177387814


def ball(count: int = 1500, seed: int = 0) -> dict[str, np.ndarray]:
    """Columns by property: opaque splats on the unit sphere, colored by their position."""
    places = np.random.default_rng(seed).normal(size=(count, 3))
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    colors = 0.5 + 0.4 * np.sin(4 * places)
    values = {name: np.zeros(count, np.float32) for name in NAMES}
    values |= dict(zip(NAMES[:3], places.T.astype(np.float32), strict=True))
    values |= {f"f_dc_{k}": ((colors[:, k] - 0.5) / C0).astype(np.float32) for k in range(3)}
    values |= {f"scale_{k}": np.full(count, np.log(0.06), np.float32) for k in range(3)}
    return values | {"opacity": np.full(count, 4, np.float32), "rot_0": np.ones(count, np.float32)}


def write_ply(path: Path, columns: dict[str, np.ndarray], format: str = "binary_little_endian", count=None) -> Path:
    """count: what the header declares, if not the truth."""
    rows = len(next(iter(columns.values())))
    kind = {"f4": "float", "f8": "double", "u1": "uchar"}
    order = ">" if "big" in format else "<"
    table = np.empty(rows, [(name, order + values.dtype.str[1:]) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    lines = [f"property {kind[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    declared = f"element vertex {rows if count is None else count}"
    head = ["ply", f"format {format} 1.0", declared, *lines, "end_header", ""]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join(head).encode() + table.tobytes())
    return path


def around(count: int = 8) -> list[Camera]:
    """Cameras on a ring, of which every other is higher."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return [
        look_at((4 * np.cos(a), 4 * np.sin(a), 1.5 * (k % 2)), (0, 0, 0), f"im_{k:02d}", 64, 48, 55.0)
        for k, a in enumerate(angles)
    ]  # fmt: skip


def entry(camera: Camera) -> dict:
    """As camera_to_JSON of 3DGS writes it."""
    pose = camera.world_from_camera
    return {
        "id": 0, "img_name": camera.name, "width": camera.width, "height": camera.height,
        "position": pose[:3, 3].tolist(), "rotation": pose[:3, :3].tolist(), "fx": camera.fx, "fy": camera.fy,
    }  # fmt: skip


def write_output(folder: Path) -> Path:
    """3DGS's output folder."""
    write_ply(folder / "point_cloud" / "iteration_7000" / "point_cloud.ply", ball(20))
    write_ply(folder / "point_cloud" / "iteration_30000" / "point_cloud.ply", ball())
    (folder / "cameras.json").write_text(json.dumps([entry(camera) for camera in around()]))
    return folder
