"""Device, threads and memory of this process."""

import os
import sys
from collections.abc import Callable
from typing import Any

from schemas.errors import UsageError
from schemas.safe_reading import set_allowance
from stages.pipeline.distributed import launched
from stages.run import memory
from stages.run.memory import available_bytes


def claim(threads: int | None, memory: int) -> None:
    """Limit the process.

    Args:
        threads: for OpenMP, BLAS, numba and torch; None keeps the libraries' defaults (torch uses one thread per
            physical core, which is right).
        memory: bytes that the process may use; 0 for most of what is free.
    """
    set_allowance(lambda: available_bytes(memory))
    if threads is not None:
        _use_threads(threads)


def resolved_device(requested: str, say: Callable[[str], None] = lambda text: None) -> str:
    """Resolve `auto`, `cpu` or `cuda` to the device to compute on, `cpu` or `cuda`.

    Args:
        say: receives one line if `auto` finds GPUs, but fewer than there are processes here.

    Raises:
        UsageError: `cuda` was requested and torch finds no GPU, or fewer than there are processes here.
    """
    if requested == "cpu" or (requested == "auto" and not _may_have_gpu()):
        return "cpu"
    import torch

    if torch.cuda.is_available():
        here, gpus = int(os.environ.get("LOCAL_WORLD_SIZE", "1")) if launched() > 1 else 1, torch.cuda.device_count()
        if here <= gpus:
            return _full_precision(torch)
        few = f"{here} processes on this machine need a GPU each, but there are {gpus}"
        if requested == "cuda":
            raise UsageError(f"--device cuda: {few}; start {gpus} processes here, or run with --device cpu")
        say(f"computing on the CPU: {few}")
        return "cpu"
    if requested == "cuda":
        raise UsageError("--device cuda: torch finds no usable GPU; run with --device cpu, or see `stylerf doctor`")
    return "cpu"


def _full_precision(torch: Any) -> str:
    """Turn off TF32 and reduced-precision sums, which round more than float32 and float16 do; return `cuda`."""
    torch.backends.cudnn.allow_tf32 = False
    torch.backends.cuda.matmul.allow_fp16_reduced_precision_reduction = False
    return "cuda"


def _may_have_gpu() -> bool:
    """Whether the system has a device node of CUDA or ROCm; importing torch to find out would take seconds."""
    return any(os.path.exists(path) for path in ("/dev/nvidiactl", "/dev/nvidia0", "/dev/dxg", "/dev/kfd"))


def _use_threads(count: int) -> None:
    # OpenMP, BLAS and numba read their variable on import, so set both it and whatever is already imported.
    variables = {"OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"}
    if "numba" in sys.modules:
        # numba refuses to compile once this variable differs from the number of threads it launched.
        variables.remove("NUMBA_NUM_THREADS")
        numba = sys.modules["numba"]
        numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    for variable in variables:
        os.environ[variable] = str(count)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(count)


def usable_threads() -> int:
    """Return the number of cores this process may use, divided among the processes launched side by side."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    cores = max(1, int(min(allowed, memory.cores())))
    return max(1, cores // int(os.environ.get("LOCAL_WORLD_SIZE", "1")))
