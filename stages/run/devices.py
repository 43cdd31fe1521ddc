"""The device that a stage computes on, with a note if it is not the requested one."""

from typing import Any

import numpy as np

from schemas.errors import OutOfResources
from stages.run.progress import Context
from stylerf.kernels import triton_not_kept
from stylerf.kernels.gpu import unavailable


def gpu_of(context: Context, field: Any = None, moving: bool = False) -> str | None:
    """Return `cuda` if it is requested and supported, else None for the CPU.

    A requested GPU that is not used is explained in one line. Resets the peak of the GPU's memory.

    Args:
        context: holds the requested device.
        field: what is computed; its kinds must have GPU kernels.
        moving: the field's geometry is trained as well.

    Raises:
        OutOfResources: some, but not all, of the processes that train together can use their GPU.
    """
    if context.device != "cuda":
        return None
    why = unavailable()
    if why is None and field is not None:
        from stylerf.fields.gpu.field import unsupported

        why = unsupported(field, moving)
    # A process that fell back to the CPU on its own would wait for sums that the others compute on their GPUs.
    lacking = np.array([why is not None], np.float32)
    context.processes.add(lacking)
    if 0 < lacking[0] < context.processes.count:
        raise OutOfResources(
            f"{lacking[0]:.0f} of {context.processes.count} processes that train together cannot use their GPU "
            f"(process {context.processes.place} {f'cannot: {why}' if why else 'can'}); set their machines up alike "
            "(check with `stylerf doctor` on each), or run with --device cpu"
        )
    if why is None:
        import torch

        torch.cuda.reset_peak_memory_stats()
        if triton_not_kept:
            context.progress.say(f"compiling GPU kernels for this run only: {triton_not_kept}")
        return "cuda"
    context.progress.say(f"computing on the CPU: {why}")
    return None


def rays_on(device: str | None, field: Any, context: Context, moving: bool = False) -> str | None:
    """Return `device` if it has kernels for the field's kinds, else None with a note.

    For stages that use the device for more than rays.
    """
    if device is None:
        return None
    from stylerf.fields.gpu.field import unsupported

    if (why := unsupported(field, moving)) is None:
        return device
    context.progress.say(f"features and matching run on the GPU, rays on the CPU: {why}")
    return None


def gpu_figures(device: str | None) -> dict[str, int]:
    """Return the peak GPU memory since gpu_of, MB, as figures of a stage; nothing on the CPU."""
    if device is None:
        return {}
    import torch

    return {"gpu_memory_mb": round(torch.cuda.max_memory_allocated() / 1e6)}
