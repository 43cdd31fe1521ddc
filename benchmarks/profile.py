"""Profile a fit's step and compare kernels with their memory bounds: `python -m benchmarks.profile WORK OUT`.

WORK holds an imported scene.

Protocol: for each capacity, a fit at that single capacity takes LEARNING steps, so that its occupancy is realistic; the
next STEPS steps are timed per kernel, on one thread and on all. A kernel's bound is the time that this machine needs,
in a separate kernel and on the same number of threads, for the memory accesses that the kernel cannot avoid: `march`
and `color` read 18 rows per sample from the table, at the same positions as the last batch, prefetching each sample's
rows while the previous one is read; the backward passes read them and add to 18 rows of a buffer of the same size;
`adam` reads all gradients, and reads and writes five arrays where they are nonzero, at the bandwidth of a triad over
arrays as long as the table. Arithmetic is not part of a bound. Minimum of REPEATS. `psnr`: of training rays after
LEARNING steps.
"""

import dataclasses
import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from numba import prange

from benchmarks.conditions import here_and_now
from stylerf.kernels.cpu.compiling import parallel_kernel, set_threads
from stylerf.kernels.cpu.simd_vm import axpy_row, vm_prefetch
from stylerf.kernels.cpu.vm import place, places

CAPACITIES = ("64x16x24", "128x16x24", "192x16x24", "256x16x24")
LEARNING, STEPS, REPEATS = 150, 30, 25
# Kernels by their name here: where the fit calls them.
KERNELS = {
    "draw rays": ("stylerf.training.common.ray_dataset", "gather"),
    "march": ("stylerf.kernels.cpu.vm", "march_density"),
    "significant": ("stylerf.rendering.rays", "visible_weights"),
    "color": ("stylerf.kernels.cpu.vm", "color"),
    "composite": ("stylerf.rendering.rays", "composite"),
    "composite backward": ("stylerf.rendering.rays", "composite_backward"),
    "color backward": ("stylerf.kernels.cpu.vm", "color_backward"),
    "density backward": ("stylerf.kernels.cpu.vm", "density_backward"),
    "smoothness": ("stylerf.kernels.cpu.vm", "smoothness_backward"),
    "adam": ("stylerf.training.common.adam", "adam"),
    "occupancy": ("stylerf.kernels.cpu.vm", "density_at"),
}


@parallel_kernel
def read_rows(table, size, ranks, x, threads, sums):
    """Add the 18 rows of every point x [n, 3] to sums [threads, rank]."""
    n = len(x)
    rank = np.int64(len(ranks))
    flat = sums.reshape(-1)
    for thread in prange(threads):
        stop = (thread + 1) * n // threads
        for p in range(thread * n // threads, stop):
            if p + 1 < stop:
                vm_prefetch(table, np.int64(0), *places(x[p + 1], size, rank), ranks)
            for m in range(3):
                first, second, line, _, _, _ = place(m, x[p], size, rank)
                for at in (first, first + rank, second, second + rank, line, line + rank):
                    axpy_row(np.float32(1), table, at, flat, thread * rank, ranks)


@parallel_kernel
def add_rows(table, size, ranks, x, threads, row, to):
    """Add `row` to the 18 rows of every point x [n, 3] in the thread's buffer to[thread], laid out as the table."""
    n = len(x)
    rank = np.int64(len(ranks))
    flat = to.reshape(-1)
    stride = to.shape[1]
    for thread in prange(threads):
        stop = (thread + 1) * n // threads
        for p in range(thread * n // threads, stop):
            if p + 1 < stop:
                vm_prefetch(flat, np.int64(thread * stride), *places(x[p + 1], size, rank), ranks)
            for m in range(3):
                first, second, line, _, _, _ = place(m, x[p], size, rank)
                for at in (first, first + rank, second, second + rank, line, line + rank):
                    axpy_row(np.float32(1), row, np.int64(0), flat, thread * stride + at, ranks)


@parallel_kernel
def triad(a, b, ranks, threads):
    """a += 2 b, a row of len(ranks) at a time; a plain numba loop is limited by its index checks."""
    rows = len(a) // len(ranks)
    for thread in prange(threads):
        for row in range(thread * rows // threads, (thread + 1) * rows // threads):
            at = np.int64(row * len(ranks))
            axpy_row(np.float32(2), b, at, a, at, ranks)


def least(work) -> float:
    """Return the minimum seconds of REPEATS runs."""
    work()
    found = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        work()
        found.append(time.perf_counter() - begun)
    return min(found)


def triad_bandwidth(length: int, threads: int) -> float:
    """Return bytes per second of a triad over float32 arrays of `length` elements."""
    a, b = (np.ones(length, np.float32) for _ in range(2))  # zeros would all map to one page of memory
    return 3 * a.nbytes / least(lambda: triad(a, b, (np.int8(0),) * 16, threads))


class Watch:
    """Times kernels while a fit runs: seconds by name, and each one's last arguments."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.last: dict[str, tuple] = {}
        self.moved = 0.0  # bytes, by adam
        self.looking = 0.0  # this class's own seconds

    def __enter__(self) -> "Watch":
        self._kept = []
        for name, (module, attribute) in KERNELS.items():
            holder = sys.modules[module]
            self._kept.append((holder, attribute, getattr(holder, attribute)))
            setattr(holder, attribute, self._timed(name, getattr(holder, attribute)))
        return self

    def __exit__(self, *_) -> None:
        for holder, attribute, kernel in self._kept:
            setattr(holder, attribute, kernel)

    def _timed(self, name: str, kernel):
        def timed(*arguments):
            begun = time.perf_counter()
            if name == "adam":
                self.moved += moved_by_adam(arguments[0].gradients, *arguments[2:4])
            self.last[name] = arguments
            at = time.perf_counter()
            self.looking += at - begun
            kernel(*arguments)
            self.seconds[name] += time.perf_counter() - at

        return timed


def fitter_of(work: Path, capacity: str, threads: int, scratch: Path):
    """Return a fit at a single capacity, without growth, set up as in `stylerf fit`."""
    from schemas.work_folder import WorkFolder
    from stages.artifacts.photos import bank_of
    from stages.artifacts.scene import load_scene, space_of
    from stages.configs.fit import FitConfig
    from stages.nerf_fit import fit_settings
    from stages.run.progress import Context, Silent
    from stylerf.training.fit.fitter import Fitter
    from stylerf.training.fit.settings import CapacityLevel

    scene = load_scene(WorkFolder(work).find("scene", "main"))
    space = space_of(scene, "auto")[0]
    settings = fit_settings(FitConfig(budget="1000000"), scene, space)
    resolution, density, color = map(int, capacity.split("x"))
    settings = dataclasses.replace(
        settings, levels=(CapacityLevel(resolution, density, color),), level_ends=(), prunings=()
    )
    bank = bank_of(scene, scene.splits["train"], scratch, Context(progress=Silent(), threads=threads))
    return Fitter(space, bank, 0, settings, 0, threads)


def bounds(watch: Watch, threads: int) -> tuple[dict[str, float], dict[str, int]]:
    """Return, by kernel, the seconds of the last batch's unavoidable reads and additions, and what the batch held."""
    density, ranks, samples, sigma_gradients, _ = watch.last["density backward"]
    parameters, color_ranks, _, _, colors, _, _ = watch.last["color backward"]
    every = np.concatenate([np.arange(a, b) for a, b in zip(samples.starts, samples.ends)])
    x = np.ascontiguousarray(samples.x[every])
    learning, shown = sigma_gradients[every] * samples.sigma[every] != 0, colors[every, 0] >= 0
    table, size = density.table, density.layout
    found = {"march": _rows(table, size, ranks, x, threads)[0]}
    found["density backward"] = sum(_rows(table, size, ranks, x[learning], threads))
    reads, adds = _rows(parameters.table, parameters.size, color_ranks, x[shown], threads)
    found |= {"color": reads, "color backward": reads + adds}
    counts = {
        "rays": len(samples.ends),
        "samples": len(x),
        "learning": int(learning.sum()),
        "colored": int(shown.sum()),
    }
    return found, counts


def _rows(table, size, ranks, x, threads: int) -> tuple[float, float]:
    rank = len(ranks)
    sums, row = np.zeros((threads, rank), np.float32), np.ones(rank, np.float32)
    buffer = np.zeros((threads, len(table)), np.float32)
    reads = least(lambda: read_rows(table, size, ranks, x, threads, sums))
    return reads, least(lambda: add_rows(table, size, ranks, x, threads, row, buffer))


def moved_by_adam(gradients: np.ndarray, begin: int, end: int) -> float:
    """Return bytes: every gradient is read; runs of eight with any are cleared, their values and moments rewritten."""
    length = (end - begin) // 8 * 8
    runs = np.abs(gradients[:, begin : begin + length]).max(0).reshape(-1, 8).max(1) > 0
    return 4.0 * (end - begin) * (gradients.shape[0] * (1 + runs.mean()) + 6 * runs.mean())


def measure(work: Path, capacity: str, threads: int, scratch: Path) -> dict:
    """Return a row: milliseconds per step by kernel, its bound, and what the batch held."""
    set_threads(threads)
    fitter = fitter_of(work, capacity, threads, scratch)
    fitter.warm_up()
    for _ in range(LEARNING):
        fitter.step()
    psnr = fitter.held_out_psnr()
    with Watch() as watch:
        begun = time.perf_counter()
        for _ in range(STEPS):
            fitter.step()
        whole = time.perf_counter() - begun - watch.looking
    found, counts = bounds(watch, threads)
    bandwidth = triad_bandwidth(fitter.parameters, threads)
    found["adam"] = watch.moved / STEPS / bandwidth
    kernels = {name: 1e3 * seconds / STEPS for name, seconds in watch.seconds.items()}
    kernels["all else"] = 1e3 * whole / STEPS - sum(kernels.values())
    return {
        "capacity": capacity,
        "threads": threads,
        "parameters": fitter.parameters,
        "psnr": round(psnr, 3),
        "step_ms": round(1e3 * whole / STEPS, 2),
        "kernels_ms": {name: round(ms, 3) for name, ms in kernels.items()},
        "bounds_ms": {name: round(1e3 * seconds, 3) for name, seconds in found.items()},
        "bandwidth_gb_s": round(bandwidth / 1e9, 2),
        **counts,
    }


def report_of(work: Path, threads: list[int], scratch: Path) -> dict:
    """Return the report: every capacity with every number of threads."""
    rows = []
    for count in threads:
        for capacity in CAPACITIES:
            rows.append(measure(work, capacity, count, scratch))
            print(json.dumps(rows[-1]), flush=True)
    return {
        "command": "python -m benchmarks.profile WORK OUT.json",
        "protocol": __doc__.split("Protocol: ")[1],
        **here_and_now(),
        "scene": work.name,
        "rows": rows,
    }


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        report = report_of(Path(sys.argv[1]), sorted({1, os.cpu_count() or 1}), Path(scratch))
    Path(sys.argv[2]).write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
