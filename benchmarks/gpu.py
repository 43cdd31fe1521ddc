"""Benchmark the GPU path: `python -m benchmarks.gpu DATA OUT.json [PARTS]`.

DATA holds lego, fern and styles (see benchmarks/fits.py). PARTS: ceilings, kernels, lego, fern, arf, desrf, edit,
render; default: all. Without a GPU, it stops without writing any figures.

Protocol: fits, stylizations and edits are the stylerf commands below with --device cuda, one process each; seconds are
from the manifests (training only where noted). Lego is refitted for each budget; its time to a quality is the smallest
budget whose fit reaches it on the test views, white background. Frames are whole views of the longest fits of lego and
fern, kept on the device. Kernels: median of 30 launches after 5 for warm-up, timed by events while the host is ahead,
with a cold cache and random inputs. `bound` counts each input once and each output once; repeated reads from the cache
are not counted, so the share of the bandwidth is a lower bound. One seed.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import torch

from benchmarks import gpu_deform

BUDGETS = ("5s", "10s", "20s", "40s")
GOALS = (31.0, 33.0)
BUSY_CYCLES = 10_000_000  # a few milliseconds, in which the host can queue any of these calls
SHOVEL = ["--at", "r_10:600,180", "--at", "r_10:488,200", "--neck", "0", "--tolerance", "26", "--reach", "0.38"]


class NoGpu(SystemExit):
    """Raised if there is no GPU to measure."""


def device_here() -> torch.device:
    """Return the GPU; raise NoGpu with a one-line reason if there is none."""
    from stylerf.kernels.gpu import interpreted, unavailable

    why = "Triton's interpreter is on (TRITON_INTERPRET=1)" if interpreted() else unavailable()
    if why is not None:
        raise NoGpu(f"no figures written: {why}")
    return torch.device("cuda")


def stylerf(*arguments: str) -> dict:
    """Run one command; return its --json object."""
    command = [sys.executable, "-m", "stylerf_cli.main", *arguments, "--json"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def seconds_of(call, device: torch.device, repeats: int = 30) -> tuple[float, float]:
    """Return (median, spread: half of the interquartile range) of one call, seconds.

    On a GPU, the cache is cold, and the device is kept busy until the host has queued the whole call, so the two events
    measure only the device's time.
    """
    times = []
    flush = torch.empty(1 << 30, dtype=torch.uint8, device=device) if device.type == "cuda" else None
    for number in range(5 + repeats):
        if device.type == "cuda":
            begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
            flush.zero_()
            torch.cuda._sleep(BUSY_CYCLES)
            begin.record()
            call()
            end.record()
            end.synchronize()
            took = begin.elapsed_time(end) / 1e3
        else:
            begun = time.perf_counter()
            call()
            took = time.perf_counter() - begun
        if number >= min(5, repeats):
            times.append(took)
    quarters = statistics.quantiles(times, n=4) if len(times) > 1 else [times[0]] * 3
    return statistics.median(times), (quarters[2] - quarters[0]) / 2


def ceilings(device: torch.device, megabytes: int = 2048, side: int = 8192, repeats: int = 30) -> dict:
    """Return the copy bandwidth (bytes read plus bytes written) and the rate of matrix products."""
    source = torch.rand(megabytes << 18, device=device)
    target = torch.empty_like(source)
    copy, _ = seconds_of(lambda: target.copy_(source), device, repeats)
    found = {"copy_gb_per_s": round(2 * source.nbytes / copy / 1e9, 1)}
    for name, dtype in (("bfloat16", torch.bfloat16), ("float32", torch.float32)):
        a, b = (torch.randn((side, side), device=device, dtype=dtype) for _ in range(2))
        product, _ = seconds_of(lambda a=a, b=b: a @ b, device, repeats)
        found[f"matmul_{name}_tflop_per_s"] = round(2 * side**3 / product / 1e12, 2)
    return found


KINDS = ("vm", "stylized", "hash", "voxel", "hash-mlp")


def random_field(vertices: int, kind: str = "vm"):
    """Return a box of thin fog with the ranks of the capacity levels and half of its cells occupied.

    kind: of density and color (hash-mlp: of the color of a vm density); stylized: a vm density with a stylization's
    hash color. A voxel grid keeps all of its blocks.
    """
    from stylerf.fields.hash_grid import HashColor
    from stylerf.fields.occupancy_grid import OccupancyGrid
    from stylerf.fields.radiance_field import RadianceField
    from stylerf.geometry.space_warp import SpaceWarp
    from stylerf.training.fit.settings import Capacity, Kinds, first_parts

    generator, capacity = np.random.default_rng(0), Capacity(np.full(3, vertices), vertices, finest=max(32, vertices))
    of_color, _, head = kind.partition("-")
    names = {"stylized": ("vm", "vm"), "hash-mlp": ("vm", "hash")}.get(kind, (kind, of_color))
    density, color = first_parts(Kinds(*names, head or "linear"), capacity, capacity, generator)
    density.values[-1] = -2.0
    if kind == "stylized":
        color = HashColor.create(generator)
    occupancy = OccupancyGrid(min(64, vertices))
    occupancy.set_occupied(generator.random(occupancy.cells**3) < 0.5)
    return RadianceField(SpaceWarp.box([-1] * 3, [1] * 3), density, color, occupancy, 1 / vertices)


def random_rays(count: int, device: torch.device):
    """Return rays towards the center of the box from around it."""
    from stylerf.kernels.gpu.ray_samples import GpuRays

    generator = np.random.default_rng(1)
    origins = generator.normal(size=(count, 3))
    origins *= 3 / np.linalg.norm(origins, axis=1, keepdims=True)
    ways = generator.uniform(-0.7, 0.7, (count, 3)) - origins
    return GpuRays.of(origins, ways / np.linalg.norm(ways, axis=1, keepdims=True), device)


def kernels(device: torch.device, bandwidth: float, rays: int = 1 << 15, vertices: int = 192, repeats=30) -> list[dict]:
    """Return each kernel's time on one batch, and its minimum bytes per second as a fraction of the bandwidth."""
    rows = []
    for kind in KINDS:
        calls, samples = launches(device, rays, vertices, kind)
        for name, (call, fewest) in calls.items():
            median, spread = seconds_of(call, device, repeats)
            rows.append(
                {
                    "kernel": name, "rays": rays, "samples": samples, "microseconds": round(median * 1e6, 1),
                    "spread": round(spread * 1e6, 1), "bound_bytes": int(fewest),
                    "gb_per_s": round(fewest / median / 1e9, 1),
                    "share_of_copy": round(fewest / median / 1e9 / bandwidth, 4),
                }
            )  # fmt: skip
    return rows


def launches(device: torch.device, rays: int, vertices: int, kind: str) -> tuple[dict, int]:
    """Return ({kernel: (its launch, minimum bytes moved)}, samples) for random rays through a random field."""
    from benchmarks import gpu_edit
    from stylerf.fields.gpu.field import GpuField
    from stylerf.kernels.cpu.adam import AdamRates
    from stylerf.kernels.gpu import launch
    from stylerf.kernels.gpu.ray_samples import GpuAdamState

    field, going = GpuField(random_field(vertices, kind), device), random_rays(rays, device)
    rendered = field.render_rays(going, weight_threshold=0.0)
    s, n, colors = rendered.samples, rendered.samples.capacity, rendered.colors
    gradients, sums = torch.randn_like(rendered.out), torch.zeros(3, device=device)
    of_sigma, of_colors = launch.composite_backward(s, colors, rendered.out, gradients, 0.0)
    to_density, to_color, *moments = (
        torch.zeros_like(part.values) for part in (field.density, field.color, field.color, field.color)
    )
    wanted, background = torch.rand((rays, 4), device=device), torch.rand((rays, 3), device=device)
    density, color, ways = 4 * len(to_density), 4 * len(to_color), going.directions
    named = {"stylized": "hash sum"}.get(kind, kind)  # its levels are summed, without a head

    def adam() -> None:
        to_color.fill_(1e-9)  # otherwise, every run would be skipped
        state = GpuAdamState(field.color.values, to_color, *moments)
        launch.adam(state, AdamRates(1e-9, 0.9, 0.99, 1e-15, 0.1, 0.01), 0, len(to_color))

    calls = {
        f"{named} color": (lambda: field.color.visible_colors(s, ways, 0.0), n * 32 + color),
        f"{named} color backward": (
            lambda: field.color.backward(s, ways, colors, of_colors, to_color), n * 40 + 3 * color,
        ),
        f"adam, {named} color": (adam, 9 * color),
    }  # fmt: skip
    if kind in ("vm", "hash", "voxel"):
        calls |= {
            f"march and {kind} density": (lambda: field.march(going, 512, 1e-3, n), rays * 56 + n * 36 + density),
            f"{kind} density backward": (
                lambda: field.density.backward(s, of_sigma, to_density), n * 20 + 3 * density,
            ),
            f"{kind} density smoothness": (lambda: field.density.smooth(1e-9, to_density), 3 * density),
        }  # fmt: skip
    if kind in ("vm", "stylized"):
        calls |= gpu_deform.launches(kind, field, going, rendered, of_sigma, of_colors)
    if kind == "vm":
        calls |= {
            "composite": (lambda: launch.composite(s, colors), n * 20 + rays * 36),
            "composite backward": (
                lambda: launch.composite_backward(s, colors, rendered.out, gradients, 0.0), n * 40 + rays * 56,
            ),
            "loss": (lambda: launch.photometric_loss(rendered.out, wanted, background, s, 1.0, sums), rays * 88),
        }  # fmt: skip
    if kind == "stylized":
        calls |= gpu_edit.launches(rendered, of_colors, wanted)
    return calls, n


def fitted(data: Path, work: Path, scene: str, flags: list[str], budget: str) -> dict:
    """Run one fit; return its figures on the test views."""
    stylerf("import", str(data / scene), str(work), *flags)
    name = f"fit-{budget}"
    common = ["--budget", budget, "--no-buffers", "--name", name]
    made = stylerf("fit", str(work), "--device", "cuda", *common)["figures"]
    figures = stylerf("eval", str(work), "--of", name, "--device", "cuda")["figures"]
    return {
        "scene": scene, "budget": budget, "psnr": round(figures["psnr"], 2), "ssim": round(figures["ssim"], 4),
        "train_seconds": made["train_seconds"], "steps": made["steps"], "parameters": made["parameters"],
        "resolution": made["resolution"], **memory_of(work, "field", name),
    }  # fmt: skip


def memory_of(work: Path, kind: str, name: str) -> dict:
    """Return the seconds of the whole stage and its peak memory on host and GPU, from its manifest."""
    manifest = json.loads((work / kind / name / "manifest.json").read_text())
    return {
        "device": manifest["device"], "wall_seconds": round(manifest["seconds"], 1),
        "peak_memory_mb": round(manifest["peak_memory_mb"]), "gpu_memory_mb": manifest["figures"].get("gpu_memory_mb"),
    }  # fmt: skip


def time_to(rows: list[dict]) -> dict:
    """Return, for each goal, the training seconds of the smallest budget that reached it; null: none did."""
    reached = {goal: [row["train_seconds"] for row in rows if row["psnr"] >= goal] for goal in GOALS}
    return {f"seconds_to_{goal:g}_db": min(found) if found else None for goal, found in reached.items()}


def stylized(data: Path, work: Path, method: str, budget: str = "30s") -> dict:
    """Stylize the fern in the work folder with the starry night; return the row."""
    source = ["--of", f"fit-{BUDGETS[2]}"]
    if method == "desrf":
        stylerf("deform", str(work), *source, "--device", "cuda", "--name", "bent")
        source = ["--of", "bent"]
    painting = str(data / "styles" / "starry_night.jpg")
    requested = ["--style", painting, "--method", method, "--budget", budget, "--name", method]
    made = stylerf("stylize", str(work), *source, *requested, "--device", "cuda")["figures"]
    return {
        "method": method, "budget": budget, "steps": made["steps"], "train_seconds": made["train_seconds"],
        "features": made["features"]["name"], "style_distance": made["curve_style"][-1].get("style"),
        **memory_of(work, "field", method),
    }  # fmt: skip


def edited(work: Path) -> dict:
    """Run a complete local edit of the lego in the work folder; return the row."""
    name = "shovel"
    requested = ["--of", f"fit-{BUDGETS[2]}", *SHOVEL, "--recolor", "--palette", "0=#2050d0", "--name", name]
    seconds = stylerf("edit", str(work), *requested, "--device", "cuda")["seconds"]
    return {"edit": name, "seconds": seconds, "sum": round(sum(seconds.values()), 1)}


def frames(field, cameras: list, device: torch.device, repeats: int = 30) -> dict:
    """Return whole views per second, with images kept on the device."""
    from stylerf.rendering.view_gpu import GpuRenderer

    made = GpuRenderer(field, device)
    turn = iter(range(1 << 30))
    median, spread = seconds_of(lambda: made.pixels(cameras[next(turn) % len(cameras)]), device, repeats)
    pixels = cameras[0].width * cameras[0].height
    return {
        "width": cameras[0].width, "height": cameras[0].height, "frames_per_s": round(1 / median, 1),
        "milliseconds": round(median * 1e3, 3), "spread": round(spread * 1e3, 3),
        "mrays_per_s": round(pixels / median / 1e6, 1), "half_precision": made.half,
    }  # fmt: skip


def frames_of(work: Path, name: str, device: torch.device) -> dict:
    """Return frames() for a fit at its test views."""
    from schemas.work_folder import WorkFolder
    from stages.artifacts.field import load_field
    from stages.artifacts.scene import load_scene

    store = WorkFolder(work)
    scene = load_scene(store.get("scene", "main"))
    field, _ = load_field(store.get("field", name))
    return frames(field, [scene.cameras[i] for i in scene.splits["test"][:16]], device)


PARTS = ("ceilings", "kernels", "lego", "fern", "arf", "desrf", "edit", "render")


def measure(part: str, data: Path, kept: Path, report: dict, device: torch.device) -> None:
    """Add one part to the report; later parts use the work folders of earlier ones."""
    lego, fern = kept / "lego", kept / "fern"
    if part == "ceilings":
        report[part] = ceilings(device)
    elif part == "kernels":
        bandwidth = report.get("ceilings", {}).get("copy_gb_per_s") or ceilings(device)["copy_gb_per_s"]
        report[part] = kernels(device, bandwidth)
    elif part == "lego":
        rows = [fitted(data, lego, "lego", [], budget) for budget in BUDGETS]
        report[part] = {"rows": rows, **time_to(rows), "final_psnr": rows[-1]["psnr"]}
    elif part == "fern":
        report[part] = fitted(data, fern, "fern", ["--images", "images_4"], BUDGETS[2])
    elif part in ("arf", "desrf"):
        report[part] = stylized(data, fern, part)
    elif part == "edit":
        report[part] = edited(lego)
    else:
        report[part] = {
            "lego": frames_of(lego, f"fit-{BUDGETS[-1]}", device),
            "fern": frames_of(fern, f"fit-{BUDGETS[2]}", device),
        }


def machine_of(device: torch.device) -> dict:
    """Return a description of the machine."""
    import triton

    properties = torch.cuda.get_device_properties(device)
    return {
        "gpu": properties.name, "memory_gb": round(properties.total_memory / 1e9, 1),
        "multiprocessors": properties.multi_processor_count, "torch": torch.__version__, "cuda": torch.version.cuda,
        "triton": triton.__version__, "python": sys.version.split()[0], "cores": os.cpu_count(),
        "commit": subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
        ).stdout.strip(),
    }  # fmt: skip


def main(arguments: list[str]) -> None:
    data, out, wanted = Path(arguments[0]), Path(arguments[1]), arguments[2:] or list(PARTS)
    device = device_here()
    report = {
        "command": "python -m benchmarks.gpu DATA OUT.json", "protocol": __doc__.split("Protocol: ")[1],
        "machine": machine_of(device), "date": datetime.now(UTC).date().isoformat(),
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(os.environ.get("STYLERF_BENCH_WORK", scratch))
        for part in wanted:
            try:
                measure(part, data, kept, report, device)
            except Exception as error:
                # Report a failed part and measure the others: GPU time is scarce.
                words = getattr(error, "stderr", None) or str(error)
                report[part] = {"failed": f"{type(error).__name__}: {words[-600:]}"}
            print(part, json.dumps(report[part]), flush=True)
            out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
