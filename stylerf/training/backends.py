"""The single place that selects the CPU or GPU implementation of each training.

`device` is a torch device for the GPU kernels, or None for the CPU. Trainers take the selected implementation as an
argument, by default the CPU's. Implementations are imported on selection, since the GPU's need Triton.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    import torch

    from stylerf.editing.palette_module import PaletteEvaluator, PaletteModule
    from stylerf.fields.radiance_field import RadianceField
    from stylerf.geometry.cameras import Camera
    from stylerf.training.deform.fitter import DeformBackend
    from stylerf.training.edit.trainer import EditEngine
    from stylerf.training.finetune.trainer import FineTuneEngine
    from stylerf.training.fit.fitter import Engine
    from stylerf.training.stylize.scene import StyleBackend

Device: TypeAlias = "str | torch.device | None"


def fit_engine(device: Device, samples: int, gradient_clip: float = 0.0) -> Callable[..., Engine]:
    """Return the constructor of a fit's engine; see Fitter. samples: target number of density samples per step."""
    if device is None:
        from stylerf.training.fit.engine import CpuEngine

        return functools.partial(CpuEngine, gradient_clip=gradient_clip)
    from stylerf.training.fit.engine_gpu import GpuEngine

    return functools.partial(GpuEngine, device=device, samples=samples, gradient_clip=gradient_clip)


def edit_engine(device: Device) -> Callable[..., EditEngine]:
    """Return the constructor of a local edit's engine; see EditTrainer."""
    if device is None:
        from stylerf.training.edit.engine import CpuEditEngine

        return CpuEditEngine
    from stylerf.training.edit.engine_gpu import GpuEditEngine

    return functools.partial(GpuEditEngine, device=device)


def palette_module(device: Device, module: PaletteModule) -> PaletteEvaluator:
    """Return an evaluator of a trained palette module on the device."""
    if device is None:
        return module
    from stylerf.editing.palette_module_gpu import GpuPaletteModule

    return GpuPaletteModule(module, device)


def ray_ends(device: Device, field: RadianceField) -> Callable[[Camera, list[np.ndarray]], list[np.ndarray]] | None:
    """Return a function that finds ray ends on a GPU, or None, for which seen_of_view uses its own kernels."""
    if device is None:
        return None
    from stylerf.editing.extraction_gpu import GpuRayEnds

    return GpuRayEnds(field, device)


def finetune_engine(device: Device) -> Callable[..., FineTuneEngine]:
    """Return the constructor of a fine-tuning engine; see FineTuner."""
    if device is None:
        from stylerf.training.finetune.engine import CpuFineTuneEngine

        return CpuFineTuneEngine
    from stylerf.training.finetune.engine_gpu import GpuFineTuneEngine

    return functools.partial(GpuFineTuneEngine, device=device)


def deform_backend(device: Device) -> DeformBackend:
    """Return the constructors of the deformer and the photo error; see DeformationFitter."""
    if device is None:
        from stylerf.training.deform.deformer import Deformer, PhotoError

        return Deformer, PhotoError
    import torch

    from stylerf.training.deform.deformer_gpu import GpuDeformer, GpuPhotoError

    return functools.partial(GpuDeformer, device=torch.device(device)), GpuPhotoError


def style_backend(device: Device) -> StyleBackend:
    """Return the constructors of a stylization's deformer and geometries; see StyledScene."""
    from stylerf.training.stylize.scene import CPU, StyleBackend

    if device is None:
        return CPU
    import torch

    from stylerf.training.deform.deformer_gpu import GpuDeformer
    from stylerf.training.stylize.geometry_gpu import GpuFixedGeometry, GpuMovingGeometry

    return StyleBackend(
        functools.partial(GpuDeformer, device=torch.device(device)),
        functools.partial(GpuFixedGeometry, device=device),
        GpuMovingGeometry,
    )
