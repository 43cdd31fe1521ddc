"""Small real files of every supported format: captures with poses in each form, pictures, flows, weights, lists."""

import json
import struct
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from schemas.exr import ExrView, write_exr
from schemas.images import write_png
from schemas.tensors import save_tensors
from tests.stylerf_cli import capture

CONFIG = """# options of a whole chain
seed = 7
threads = 1
device = "cpu"
downscale = 1.0
test_every = 4
[import]
layout = "auto"
background = "none"
[fit]
budget = "60s"
capacity = "fixed:32x8x8"
smoothness = 0.5
[stylize]
method = "arf"
"""
POINTS = ((0.3, 0.4, 0.5), (0.1, 0.9, 0.7), (0.8, 0.2, 0.3), (0.5, 0.5, 0.1), (0.2, 0.1, 0.9), (0.6, 0.7, 0.4))


def write_captures(folder: Path) -> None:
    """Write folder/NAME/source for every kind of capture."""
    for suffix in ("png", "jpg", "tif", "exr"):
        source = _source(folder, f"photo {suffix}")
        pixels = (oiio.ImageBuf(str(source / "images" / "p01.png"))).get_pixels(oiio.UINT8)
        (source / "images" / "p01.png").unlink()
        picture = oiio.ImageBuf(np.ascontiguousarray(pixels))
        assert picture.write(str(source / "images" / f"p01.{suffix}"), "half" if suffix == "exr" else "uint8")
        content = capture.transforms()
        content["frames"][1]["file_path"] = f"images/p01.{suffix}"
        capture.write_transforms(source, content)

    beside = _source(folder, "beside")
    write_png(beside / "masks" / "p03.png", np.pad(np.full((20, 30), 255, np.uint8), ((8, 8), (9, 9))))
    flat = np.ones((36, 48), np.float32)
    view = ExrView(np.ones((36, 48, 3), np.float32), flat, flat, flat, np.eye(4), (45, 45, 24, 18), 0.1, 9.0)
    write_exr(beside / "truth" / "depth_p00.exr", view)
    capture.write_transforms(beside, capture.transforms())

    alone = _source(folder, "alone")
    (alone / "images" / "p03.png").unlink()

    blender = _source(folder, "Blender")
    content = capture.transforms()
    angle = 2 * float(np.arctan(capture.WIDTH / 2 / capture.FOCAL))
    capture.write_transforms(blender, {"camera_angle_x": angle, "frames": content["frames"]})

    capture.write_transforms(_source(folder, "instant-ngp"), content | {"aabb_scale": 4, "k1": 0.01, "scale": 0.33})

    studio = _source(folder, "nerfstudio")
    write_png(studio / "masks" / "p02.png", np.full((36, 48), 255, np.uint8))
    for number, frame in enumerate(content["frames"]):
        frame["colmap_im_id"] = number
    content["frames"][2]["mask_path"] = "masks/p02.png"
    more = {"camera_model": "OPENCV", "k1": 0.01, "k2": 0.0, "p1": 0.0, "p2": 0.0,
            "train_filenames": [f"images/p0{number}.png" for number in range(3)], "val_filenames": ["images/p03.png"],
            "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]], "applied_scale": 0.5}  # fmt: skip
    capture.write_transforms(studio, content | more)

    text = _source(folder, "COLMAP text")
    capture.write_colmap(text)
    _write_points(text / "sparse" / "0")
    binary = _source(folder, "COLMAP binary")
    _write_binary(text / "sparse" / "0", binary / "sparse" / "0")

    np.save(_source(folder, "LLFF") / "poses_bounds.npy", capture.llff())
    config = _source(folder, "config")
    capture.write_transforms(config, capture.transforms())
    (config / "options.toml").write_text(CONFIG)


def _source(folder: Path, name: str) -> Path:
    source = folder / name / "source"
    capture.write_images(source)
    return source


def _write_points(model: Path) -> None:
    """Return six points that all four photos see."""
    lines = (model / "images.txt").read_text().split("\n")
    for number, one in enumerate(capture.cameras()):
        seen = (one.camera_from_world @ np.column_stack([POINTS, np.ones(len(POINTS))]).T)[:3].T
        pixels = seen[:, :2] / seen[:, 2:] * capture.FOCAL + [capture.WIDTH / 2, capture.HEIGHT / 2]
        lines[2 * number + 1] = " ".join(f"{x:.3f} {y:.3f} {at + 1}" for at, (x, y) in enumerate(pixels))
    (model / "images.txt").write_text("\n".join(lines))
    points = [
        f"{at + 1} {x} {y} {z} 120 130 140 0.5 " + " ".join(f"{image} {at}" for image in range(1, 5))
        for at, (x, y, z) in enumerate(POINTS)
    ]
    (model / "points3D.txt").write_text("\n".join(points) + "\n")


def _write_binary(text: Path, model: Path) -> None:
    """Write the same model as COLMAP's binary files."""
    model.mkdir(parents=True)
    numbers = [capture.FOCAL, capture.FOCAL, capture.WIDTH / 2, capture.HEIGHT / 2]
    (model / "cameras.bin").write_bytes(struct.pack("<QIiQQ4d", 1, 1, 1, capture.WIDTH, capture.HEIGHT, *numbers))
    lines = (text / "images.txt").read_text().split("\n")
    packed = struct.pack("<Q", 4)
    for at in range(4):
        words, seen = lines[2 * at].split(), lines[2 * at + 1].split()
        packed += (
            struct.pack("<I7dI", int(words[0]), *map(float, words[1:8]), int(words[8])) + words[9].encode() + b"\0"
        )
        packed += struct.pack("<Q", len(seen) // 3)
        for x, y, point in zip(seen[::3], seen[1::3], seen[2::3]):
            packed += struct.pack("<ddQ", float(x), float(y), int(point))
    (model / "images.bin").write_bytes(packed)
    packed = struct.pack("<Q", len(POINTS))
    for at, place in enumerate(POINTS):
        packed += struct.pack("<Q3d3BdQ", at + 1, *place, 120, 130, 140, 0.5, 4)
        for image in range(1, 5):
            packed += struct.pack("<II", image, at)
    (model / "points3D.bin").write_bytes(packed)


def write_loose(folder: Path, painting: Path) -> None:
    """Write files that are read on their own: style images, flows, weights."""
    folder.mkdir(parents=True)
    small = oiio.ImageBufAlgo.resize(oiio.ImageBuf(str(painting)), roi=oiio.ROI(0, 64, 0, 48))
    for suffix in ("png", "jpg", "tif"):
        assert small.write(str(folder / f"painting.{suffix}"), "uint8")
    flow = np.random.default_rng(0).normal(size=(12, 16, 2)).astype("<f4")
    (folder / "flow.flo").write_bytes(struct.pack("<fii", 202021.25, 16, 12) + flow.tobytes())
    np.save(folder / "flow.npy", flow)
    import torch

    # A VGG-19 to conv3_1 in AdaIN's layout: a convolution of 1x1, then five of 3x3.
    random = np.random.default_rng(1)
    state = {"0.weight": 255 * np.eye(3, dtype=np.float32)[::-1, :, None, None], "0.bias": np.zeros(3, np.float32)}
    for place, out, taken in ((2, 64, 3), (5, 64, 64), (9, 128, 64), (12, 128, 128), (16, 256, 128)):
        state[f"{place}.weight"] = random.normal(size=(out, taken, 3, 3)).astype(np.float32) / 100
        state[f"{place}.bias"] = np.zeros(out, np.float32)
    save_tensors(folder / "weights.safetensors", state)
    torch.save({name: torch.from_numpy(array.copy()) for name, array in state.items()}, folder / "weights.pth")


def camera_path(size: int = 12) -> list[dict]:
    """Write one small picture, as in docs/artifacts.md."""
    pose = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 3.5], [0, 0, 0, 1]]
    lens = {"fx": 1.4 * size, "fy": 1.4 * size, "cx": size / 2, "cy": size / 2}
    return [{"name": "one", "width": size, "height": size, **lens, "world_from_camera": pose}]


def studio_path() -> dict:
    """Write a camera path as nerfstudio's viewer saves it."""
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 3.5, 0, 0, 0, 1]
    frames = [{"camera_to_world": matrix, "fov": 50.0, "aspect": 1.0} for _ in range(2)]
    return {"camera_type": "perspective", "render_height": 12, "render_width": 12, "fps": 24, "seconds": 1.0,
            "camera_path": frames, "keyframes": [], "is_cycle": False}  # fmt: skip


def write_paths(folder: Path) -> None:
    """Write both to files."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "path.json").write_text(json.dumps(camera_path()))
    (folder / "studio.json").write_text(json.dumps(studio_path()))
