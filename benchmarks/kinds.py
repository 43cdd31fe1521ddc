"""Kinds of fields at equal time: `python -m benchmarks.kinds DATA OUT.json [BUDGET [SCENE...]]`.

With $STYLERF_BENCH_WORK, the work folders are kept there.

Protocol: every scene is fitted with each kind of field, growing as in the product, all for BUDGET (seconds of training,
or steps), one seed; mean PSNR and SSIM of the test views by `stylerf eval`; Mrays/s: for rendering those views without
writing files, median of PASSES passes over all of them after one warm-up pass. Peak memory: of the fit's process.
"""

import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.capacity import imported
from benchmarks.conditions import here_and_now
from benchmarks.fits import stylerf

KINDS = {
    "vm": ("--field", "vm"),
    "hash": ("--field", "hash"),
    "voxel": ("--field", "voxel"),
    "vm+hash": ("--field", "vm+hash"),
    "hash+vm": ("--field", "hash+vm"),
    "hash, small network": ("--field", "hash", "--head", "mlp"),
}
PASSES = 5
BUDGET, SCENES = "60s", ("lego 200x200", "fern 504x378", "fox 270x480")


def rays_a_second(work: Path, name: str) -> float:
    """Return the rendering speed for the test views of a field, rays per second."""
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
    cameras = [scene.cameras[i] for i in scene.splits["test"]]
    seconds = []
    for _ in range(1 + PASSES):
        begun = time.perf_counter()
        for camera in cameras:
            render_view(field, camera, threads=threads)
        seconds.append(time.perf_counter() - begun)
    return sum(c.width * c.height for c in cameras) / statistics.median(seconds[1:])


def measure(scene: str, kind: str, budget: str, work: Path) -> dict:
    """Return a row."""
    label = "kind-" + kind.replace(", ", "-").replace(" ", "-")
    load = round(os.getloadavg()[0], 2)
    fitted = stylerf("fit", str(work), "--budget", budget, "--no-buffers", "--name", label, *KINDS[kind])
    manifest = json.loads((work / "field" / label / "manifest.json").read_text())
    quality = stylerf("eval", str(work), "--of", label)["figures"]
    return {
        "scene": scene,
        "kind": kind,
        "psnr": round(quality["psnr"], 3),
        "ssim": round(quality["ssim"], 4),
        "parameters": fitted["figures"]["parameters"],
        "steps": fitted["figures"]["steps"],
        "train_seconds": fitted["figures"]["train_seconds"],
        "peak_memory_mb": round(manifest["peak_memory_mb"]),
        "mrays_a_second": round(rays_a_second(work, label) / 1e6, 3),
        "load_before": load,
    }


def main() -> None:
    data, out = Path(sys.argv[1]), Path(sys.argv[2])
    budget, rows = sys.argv[3] if len(sys.argv) > 3 else BUDGET, []
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(os.environ.get("STYLERF_BENCH_WORK", scratch))
        for scene in sys.argv[4:] or SCENES:
            work = kept / scene.replace(" ", "-")
            imported(data, scene, work)
            for kind in KINDS:
                rows.append(measure(scene, kind, budget, work))
                print(rows[-1], flush=True)
                report = {
                    "command": f"python -m benchmarks.kinds DATA OUT.json {budget}",
                    "protocol": __doc__.split("Protocol: ")[1],
                    **here_and_now(),
                    "rows": rows,
                }
                out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
