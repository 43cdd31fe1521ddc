"""The demo's dataset: photos of a procedural still life with poses and true depth, and a style image."""

from contextlib import suppress
from pathlib import Path

import numpy as np

from schemas.atomic_write import make_folder, write_json
from schemas.errors import BadInput
from schemas.exr import FAR_Z, ExrView, write_exr
from schemas.images import linear_from_srgb, to_uint8, write_png
from schemas.safe_reading import read_json
from stages.run.progress import Progress
from stylerf.geometry.cameras import Camera
from stylerf.procedural.painting import paint
from stylerf.procedural.still_life import StillLife, TrueView, dome_cameras

_GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])
PAINTING = "painting.png"
STAMP = "demo.json"
ANGLE_X = 0.6911112


def write_demo(
    folder: Path, size: int, train_views: int, test_views: int, seed: int, threads: int, progress: Progress
) -> None:
    """Write transforms_train.json, transforms_test.json (NeRF-synthetic), RGBA photos, truth/ and painting.png.

    A complete dataset of the same options is left as it is. demo.json holds the options, and is empty until everything
    is written.

    Args:
        size: side of the photos, pixels.
        seed: of the scene, the cameras and the style image.
    """
    wanted = {"size": size, "train_views": train_views, "test_views": test_views, "seed": seed}
    stamp = folder / STAMP
    with suppress(BadInput, FileNotFoundError):  # a damaged stamp is treated as missing
        if read_json(stamp) == wanted:
            return
    make_folder(folder)
    # Before anything else: the old stamp is wrong as soon as the first photo is replaced.
    write_json(stamp, {})
    life, done = StillLife(seed), 0
    progress.start("rendering photos of the still life", train_views + test_views, "view")
    for split, count, turn in (("train", train_views, seed), ("test", test_views, seed + 1000)):
        cameras = dome_cameras(count, size, split, turn, angle_x=ANGLE_X)
        for camera in cameras:
            write_view(folder, split, camera, life.render(camera, threads=threads))
            done += 1
            progress.update(done)
        frames = [
            {"file_path": f"{split}/{c.name}", "transform_matrix": (c.world_from_camera @ _GL_FROM_CV).tolist()}
            for c in cameras
        ]
        write_json(folder / f"transforms_{split}.json", {"camera_angle_x": ANGLE_X, "frames": frames})
    progress.finish()
    progress.say("painting the style image")
    write_png(folder / PAINTING, to_uint8(paint(512, seed)))
    write_json(stamp, wanted)


def write_view(folder: Path, split: str, camera: Camera, view: TrueView) -> None:
    """Write a photo and its true depth."""
    write_png(folder / split / f"{camera.name}.png", to_uint8(view.rgba))
    hit = np.isfinite(view.z)
    alpha = np.where(hit, 1.0, 0.0).astype(np.float32)
    truth = ExrView(
        rgb=linear_from_srgb(view.rgba[..., :3]) * alpha[..., None],
        alpha=alpha,
        z=np.where(hit, view.z, FAR_Z),
        ray_distance=np.where(hit, view.ray_distance, FAR_Z),
        world_from_camera=camera.world_from_camera,
        intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy),
        near=0.1,
        far=100.0,
        attributes={"source": "stylerf demo"},
    )
    write_exr(folder / "truth" / f"depth_{camera.name}.exr", truth)
