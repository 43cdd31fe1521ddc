"""Splats as USD's ParticleField3DGaussianSplat (OpenUSD 26.03): linear scales, opacities 0..1, y up."""

from pathlib import Path
from typing import Any

import numpy as np

from schemas.errors import UsageError
from stages.configs.export import ExportConfig
from stages.exporting import usd_stage
from stages.exporting.libraries import needed
from stylerf.kernels.cpu.splats import Gaussians

SPLATS = f"{usd_stage.ROOT}/splats"
REACH = 3.0  # standard deviations that the extent encloses


def write_usd(path: Path, splats: Gaussians, config: ExportConfig) -> None:
    """Write a stage with one prim of splats."""
    check_usd()
    stage = usd_stage.new_stage(path, config)
    add_splats(stage, splats)
    usd_stage.save(stage)


def check_usd() -> None:
    """Raise UsageError if the installed OpenUSD has no prim for splats."""
    volumes, usd = needed("pxr.UsdVol", "USD"), needed("pxr.Usd", "USD")
    if not hasattr(volumes, "ParticleField3DGaussianSplat"):
        year, month = usd.GetVersion()[1:]
        raise UsageError(
            f"USD splats need OpenUSD 26.03 or later, this is {year}.{month:02}; pip install -U usd-core, or choose "
            "another format"
        )


def add_splats(stage: Any, splats: Gaussians) -> None:
    """Add a prim of splats, which are in the coordinates of the stage."""
    volumes, vt = needed("pxr.UsdVol", "USD"), needed("pxr.Vt", "USD")
    prim = volumes.ParticleField3DGaussianSplat.Define(stage, SPLATS)

    def floats(values: np.ndarray, kind: str):
        return getattr(vt, kind).FromNumpy(np.ascontiguousarray(values, np.float32))

    scales = np.exp(splats.log_scales)
    reach = REACH * scales.max(1, keepdims=True)
    bands = splats.harmonics.shape[1]
    prim.CreatePositionsAttr(floats(splats.centers, "Vec3fArray"))
    prim.CreateScalesAttr(floats(scales, "Vec3fArray"))
    # A quaternion's array is read as x y z w.
    prim.CreateOrientationsAttr(floats(splats.quaternions[:, [1, 2, 3, 0]], "QuatfArray"))
    prim.CreateOpacitiesAttr(floats(1 / (1 + np.exp(-splats.logits)), "FloatArray"))
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(round(bands**0.5) - 1)
    # Particle by particle, as primvars with that many elements each are.
    prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(floats(splats.harmonics.reshape(-1, 3), "Vec3fArray"))
    low, high = (splats.centers - reach).min(0), (splats.centers + reach).max(0)
    prim.CreateExtentAttr(floats(np.stack([low, high]), "Vec3fArray"))
