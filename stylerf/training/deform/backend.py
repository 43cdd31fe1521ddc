"""Chooses the CPU or the GPU implementation of a deformer."""

import torch

from stylerf.training.deform.deformer import Deformer


def deformer_on(device: str | torch.device | None, *given) -> Deformer:
    """Return a Deformer on `device`, or on the CPU for None."""
    if device is None:
        return Deformer(*given)
    from stylerf.training.deform.deformer_gpu import GpuDeformer

    return GpuDeformer(torch.device(device), *given)
