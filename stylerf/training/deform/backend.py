"""Picks where a deformation learns: on the CPU or on a GPU."""

import torch

from stylerf.training.deform.deformer import Deformer


def deformer_on(device: str | torch.device | None, *given) -> Deformer:
    """A Deformer of what it is given, that works on `device`; None: by the CPU's kernels."""
    if device is None:
        return Deformer(*given)
    from stylerf.training.deform.deformer_gpu import GpuDeformer

    return GpuDeformer(torch.device(device), *given)
