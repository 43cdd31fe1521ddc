"""Which device a stage computes on, and what it says where that is another than was asked for."""

import numpy as np

from schemas.errors import OutOfResources
from stages.run.progress import Context
from stylerf.kernels import triton_not_kept
from stylerf.kernels.gpu import unavailable


def gpu_of(context: Context, field=None, moving: bool = False) -> str | None:
    """`cuda` where the context asks for it and the kernels (and the field's kinds) are there; None: the CPU.

    moving: the field's shapes are to learn to move. Says in one line why a GPU that was asked for is not used;
    processes that train together must all find it so. From here on the peak of the GPU's memory is this stage's.
    """
    if context.device != "cuda":
        return None
    why = unavailable()
    if why is None and field is not None:
        from stylerf.fields.gpu.field import unsupported

        why = unsupported(field, moving)
    lacking = np.array([why is not None], np.float32)
    context.ranks.add(lacking)
    if 0 < lacking[0] < context.ranks.count:
        raise OutOfResources(
            f"{lacking[0]:.0f} of {context.ranks.count} processes that train together cannot compute on their GPU "
            f"(process {context.ranks.place} {f'cannot: {why}' if why else 'can'}); bring their machines to the same "
            "state (`stylerf doctor` on each), or run with --device cpu"
        )
    if why is None:
        import torch

        torch.cuda.reset_peak_memory_stats()
        if triton_not_kept:
            context.progress.say(f"compiling the GPU's kernels for this run alone: {triton_not_kept}")
        return "cuda"
    context.progress.say(f"computing on the CPU: {why}")
    return None


def rays_on(device: str | None, field, context: Context, moving: bool = False) -> str | None:
    """`device`, where its kernels know the field's kinds; else None, and a line that says why.

    For stages that use the device for more than rays.
    """
    if device is None:
        return None
    from stylerf.fields.gpu.field import unsupported

    if (why := unsupported(field, moving)) is None:
        return device
    context.progress.say(f"features and matching run on the GPU, rays on the CPU: {why}")
    return None


def gpu_figures(device: str | None) -> dict:
    """The most memory held on the GPU since gpu_of, MB, for a stage's figures; nothing on the CPU."""
    if device is None:
        return {}
    import torch

    return {"gpu_memory_mb": round(torch.cuda.max_memory_allocated() / 1e6)}
