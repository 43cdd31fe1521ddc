"""Ablation of the measures for real captures: `python -m benchmarks.captures DATA OUT.json [STEPS [SCENE...]]`.

With $STYLERF_BENCH_WORK, the work folders are kept there.

Protocol: every capture is fitted with the product's defaults, and once without each measure, all for STEPS steps on the
same rays, one seed. `psnr`, `ssim`: means over the test views by `stylerf eval`. `near`: percentage of test pixels
whose depth is below a third of their view's median depth, where captures have hardly anything but floaters. `heavy`:
mean number of samples per test ray with a weight above 0.01; a ray that hits one surface has one or two. `occupied`:
percentage of occupied cells in the occupancy grid. Budgets are in steps rather than seconds, so the load of the machine
does not matter.
"""

import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.conditions import here_and_now
from benchmarks.fits import SCENES, stylerf

CAPTURES = ("fox 270x480", "fern 504x378", "flower 504x378", "cup 400x300")
STEPS = 700
HEAVY = 0.01  # weight above which a sample is clearly visible
# By name: flags that disable or replace a measure, by layout.
MEASURES = {
    "defaults": {},
    "no near-camera gradient scaling": {"unbounded": ("--near-scaling-distance", "0")},
    "no smoothing": {"unbounded": ("--smoothness", "0"), "forward": ("--smoothness", "0")},
    "no clearing of unseen cells": {"unbounded": ("--least-weight", "0"), "forward": ("--least-weight", "0")},
    "no distortion loss": {"unbounded": ("--distortion-weight", "0"), "forward": ("--distortion-weight", "0")},
    "density: planes and lines": {"forward": ("--field", "vm")},
    "density: hash grid": {"unbounded": ("--field", "hash+vm")},
    "space: box": {"unbounded": ("--space", "box"), "forward": ("--space", "box")},
    "space: contraction": {"forward": ("--space", "contraction")},
    "view-independent colors": {"unbounded": ("--degree", "0"), "forward": ("--degree", "0")},
}


def near_share(depths: list[np.ndarray]) -> float:
    """Return the percentage of pixels nearer than a third of their view's median depth; depths: [h, w], 0: empty."""
    shares = []
    for depth in depths:
        seen = depth[depth > 0]
        if len(seen):
            shares.append(float((seen < np.median(seen) / 3).mean()))
    return 100 * float(np.mean(shares)) if shares else float("nan")


def depths_of(work: Path, name: str) -> list[np.ndarray]:
    """Return the depth [h, w] of every test view of a field."""
    from schemas.work_folder import WorkFolder
    from stages.artifacts.field import load_field
    from stages.artifacts.scene import load_scene
    from stylerf.kernels.cpu.compiling import set_threads
    from stylerf.rendering.view import render_view

    threads = set_threads(os.cpu_count() or 1)
    scene, field = (
        load_scene(WorkFolder(work).find("scene", "main")),
        load_field(WorkFolder(work).find("field", name))[0],
    )
    return [render_view(field, scene.cameras[i], threads=threads).z for i in scene.splits["test"]]


def heavy_samples(work: Path, name: str) -> float:
    """Return the mean number of samples with a weight above HEAVY, over every 37th ray of the test views."""
    from schemas.work_folder import WorkFolder
    from stages.artifacts.field import load_field
    from stages.artifacts.scene import load_scene
    from stylerf.kernels.cpu.compiling import set_threads
    from stylerf.kernels.cpu.ray_samples import Rays

    threads = set_threads(os.cpu_count() or 1)
    scene = load_scene(WorkFolder(work).find("scene", "main"))
    field = load_field(WorkFolder(work).find("field", name))[0]
    heavy = rays = 0
    for i in scene.splits["test"]:
        camera = scene.cameras[i]
        origins, directions = camera.rays(np.arange(0, camera.width * camera.height, 37))
        samples = field.march(Rays.of(origins, directions, field.space.near), 512, 1e-3, threads)
        for first, end in zip(samples.starts, samples.ends):
            heavy += int((samples.weights[first:end] > HEAVY).sum())
        rays += len(origins)
    return heavy / rays


def layout_of(work: Path) -> str:
    """Return object, forward or unbounded."""
    from schemas.work_folder import WorkFolder
    from stages.artifacts.scene import load_scene

    return load_scene(WorkFolder(work).find("scene", "main")).layout


def measure(scene: str, layout: str, name: str, steps: int, work: Path) -> dict | None:
    """Return a row, or None if the measure does not apply to this layout."""
    flags = MEASURES[name].get(layout, ())
    if not flags and MEASURES[name]:
        return None
    label = "capture-" + name.replace(" ", "-").replace(":", "")
    figures = stylerf("fit", str(work), "--budget", str(steps), "--no-buffers", "--name", label, *flags)["figures"]
    quality = stylerf("eval", str(work), "--of", label)["figures"]
    return {
        "scene": scene,
        "measure": name,
        "flags": " ".join(flags),
        "psnr": round(quality["psnr"], 3),
        "ssim": round(quality["ssim"], 4),
        "near": round(near_share(depths_of(work, label)), 3),
        "heavy": round(heavy_samples(work, label), 2),
        "occupied": round(100 * figures["occupied_share"], 1),
        "parameters": figures["parameters"],
        "train_seconds": figures["train_seconds"],
    }


def main() -> None:
    data, out = Path(sys.argv[1]), Path(sys.argv[2])
    steps = int(sys.argv[3]) if len(sys.argv) > 3 else STEPS
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(os.environ.get("STYLERF_BENCH_WORK", scratch))
        for scene in sys.argv[4:] or CAPTURES:
            folder, flags = SCENES[scene]
            work = kept / scene.replace(" ", "-")
            stylerf("import", str(data / folder), str(work), *flags)
            layout = layout_of(work)
            for name in MEASURES:
                if (row := measure(scene, layout, name, steps, work)) is None:
                    continue
                rows.append(row)
                print(row, flush=True)
                report = {
                    "command": f"python -m benchmarks.captures DATA OUT.json {steps}",
                    "protocol": __doc__.split("Protocol: ")[1],
                    **here_and_now(),
                    "rows": rows,
                }
                out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
