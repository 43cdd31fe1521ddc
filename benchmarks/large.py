"""A large capture in bounded memory: `python -m benchmarks.large FOLDER OUT.json [STEP ...]`.

STEP: photos, scene, memory, stream, render (default: all, in this order; FOLDER keeps the results, about 3 GB).

Protocol: the procedural still life from 300 viewpoints, rendered at 100x75 and enlarged to 1600x1200 with noise of +-3
of 255 on every opaque pixel, RGBA: 2.3 GB of pixels; a scene of them, created without importing. `stylerf fit
--capacity fixed:128 --budget STEPS --memory 8G`, which keeps the photos in memory; the same with --memory 2500M, which
reads them from a file; the two fields are compared bit by bit; `stylerf render --frames 0-3`. Peak memory is that of
each command's process (VmHWM, including mapped files); milliseconds per step are for training only.
"""

import json
import os
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.conditions import here_and_now
from benchmarks.fits import stylerf
from schemas.images import to_uint8, write_png
from schemas.scene import Bounds, Scene, View, as_matrix, write_scene
from schemas.work_folder import Recipe, WorkFolder
from stages.pipeline.demo_scene import ANGLE_X
from stylerf.procedural.still_life import StillLife, dome_cameras

VIEWS, SMALL, SCALE, STEPS = 300, 100, 16, "200"
SIZE = (SMALL * SCALE, SMALL * 3 // 4 * SCALE)  # width, height
BOUNDS = {"memory": "8G", "stream": "2500M"}


def photos(folder: Path, work: Path) -> dict:
    """Write the missing photos."""
    life, begun = StillLife(0), time.perf_counter()
    cameras = dome_cameras(VIEWS, SMALL, "train", 0, angle_x=ANGLE_X)
    noise = np.random.default_rng(0).integers(-3, 4, (SIZE[1], SIZE[0], 3), dtype=np.int16)
    for index, camera in enumerate(cameras):
        path = folder / f"photos/{camera.name}.png"
        if path.is_file():
            continue
        small = to_uint8(life.render(camera).rgba)[SMALL // 8 : SMALL // 8 + SMALL * 3 // 4]
        large = np.repeat(np.repeat(small, SCALE, 0), SCALE, 1)
        moved = np.roll(noise, 7 * index, (0, 1))
        large[..., :3] = np.clip(large[..., :3] + moved, 0, 255) * (large[..., 3:] > 0)
        write_png(path, large)
    size = sum(path.stat().st_size for path in (folder / "photos").iterdir())
    return {"photos": VIEWS, "size": SIZE, "files_mb": round(size / 1e6), "seconds": round(time.perf_counter() - begun)}


def taken(work: Path, kind: str, name: str) -> dict:
    """Return the time and memory that creating an artifact took."""
    manifest = json.loads((work / kind / name / "manifest.json").read_text())
    return {"wall_seconds": round(manifest["seconds"], 1), "peak_memory_mb": round(manifest["peak_memory_mb"])}


def scene_of(folder: Path, work: Path) -> dict:
    """Create the scene directly: importing would decode and rewrite every photo, one at a time."""
    begun = WorkFolder(work).begin("scene", "main", Recipe("pose_import", 1, {}, []))
    focal, views = 0.5 * SIZE[0] / np.tan(0.5 * ANGLE_X), []
    (begun.path / "images").mkdir()
    for index, camera in enumerate(dome_cameras(VIEWS, SMALL, "train", 0, angle_x=ANGLE_X)):
        image, split = f"images/{camera.name}.png", "train" if index else "test"
        os.link(folder / f"photos/{camera.name}.png", begun.path / image)
        pinhole = (*SIZE, focal, focal, SIZE[0] / 2, SIZE[1] / 2)
        views.append(View(camera.name, image, split, *pinhole, as_matrix(camera.world_from_camera)))
    bounds = Bounds(((-1.5, -1.5, -1.5), (1.5, 1.5, 1.5)), 1.5, 6.5)
    write_scene(begun.path, Scene(tuple(views), "object", "given", bounds, "alpha", as_matrix(np.eye(4))))
    begun.commit()
    return {"views": VIEWS, "pixel_bytes": 4 * SIZE[0] * SIZE[1] * VIEWS}


def fit(folder: Path, work: Path, way: str) -> dict:
    """Run one fit, with its photos in memory or streamed (`way`); return the row."""
    name = f"fit-{way}"
    more = ("--budget", STEPS, "--capacity", "fixed:128", "--no-buffers", "--name", name, "--memory", BOUNDS[way])
    figures = stylerf("fit", str(work), *more)["figures"]
    each = 1e3 * figures["train_seconds"] / figures["steps"]
    same = work / "field/fit-memory/field.safetensors", work / f"field/{name}/field.safetensors"
    return {
        "bound": BOUNDS[way], **taken(work, "field", name), "ms_a_step": round(each, 1), "steps": figures["steps"],
        "psnr": figures["held_out_psnr"], "same_field_as_in_memory": same[0].read_bytes() == same[1].read_bytes(),
        "load_after": round(os.getloadavg()[0], 2),
    }  # fmt: skip


def rendered(folder: Path, work: Path) -> dict:
    """Render four frames at full size; return the row."""
    made = stylerf("render", str(work), "--of", "fit-memory", "--path", "train", "--frames", "0-3", "--memory", "2G")
    return taken(work, "frames", made["name"])


STEPS_OF = {
    "photos": photos,
    "scene": scene_of,
    "memory": lambda folder, work: fit(folder, work, "memory"),
    "stream": lambda folder, work: fit(folder, work, "stream"),
    "render": rendered,
}


def main() -> None:
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    for step in sys.argv[3:] or list(STEPS_OF):
        found = STEPS_OF[step](folder, folder / "work")
        print(step, found, flush=True)
        report = json.loads(out.read_text()) if out.is_file() else {}
        report |= {
            "command": "python -m benchmarks.large FOLDER OUT.json", "protocol": __doc__.split("Protocol: ")[1],
            **here_and_now(),
            step: found,
        }  # fmt: skip
        out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
