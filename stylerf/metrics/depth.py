"""Errors of rendered depth against ground truth."""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue


@dataclass(frozen=True)
class DepthErrors:
    """Errors over the compared pixels; None if there are none.

    Attributes:
        abs_rel: Mean |z - z*| / z*.
        rmse: sqrt(mean (z - z*)^2), scene units.
        delta: Fraction of pixels with max(z/z*, z*/z) < 1.25.
        in_front: Fraction of pixels with z < 0.9 z*: haze or floaters in front of the surface.
        share: Compared pixels divided by pixels with ground truth.
        pixels: Number of compared pixels.
    """

    abs_rel: float | None
    rmse: float | None
    delta: float | None
    in_front: float | None
    share: float
    pixels: int


def depth_errors(z: np.ndarray, alpha: np.ndarray, truth: np.ndarray, far: float = 1e9) -> DepthErrors:
    """Compare planar depth `z` to `truth`, both [h, w] in scene units, where alpha > 0.5 and the truth is a surface.

    The truth is a surface where it is finite, positive and below `far`, which files use for empty pixels.

    Raises:
        InvalidValue: Sizes differ or a compared depth is not finite.
    """
    if not z.shape == alpha.shape == truth.shape:
        raise InvalidValue(f"depth {z.shape}, alpha {alpha.shape} and truth {truth.shape} differ in size")
    known = np.isfinite(truth) & (truth > 0) & (truth < far)
    compared = known & (alpha > 0.5)
    count, total = int(compared.sum()), int(known.sum())
    share = count / total if total else 0.0
    if count == 0:
        return DepthErrors(None, None, None, None, share, 0)
    ours, true = z[compared].astype(np.float64), truth[compared].astype(np.float64)
    if not np.isfinite(ours).all():
        raise InvalidValue(f"{int((~np.isfinite(ours)).sum())} of {count} depths are not finite")
    difference = ours - true
    ratio = np.maximum(ours, 1e-12) / true  # 1 / ratio must not be infinite
    return DepthErrors(
        abs_rel=float((np.abs(difference) / true).mean()),
        rmse=float(np.sqrt((difference**2).mean())),
        delta=float((np.maximum(ratio, 1 / ratio) < 1.25).mean()),
        in_front=float((ratio < 0.9).mean()),
        share=share,
        pixels=count,
    )


def shape_change(z: np.ndarray, alpha: np.ndarray, z_base: np.ndarray, alpha_base: np.ndarray) -> float | None:
    """Return the mean |z - z_base| / z_base where both are opaque (alpha > 0.5): how much stylization moved surfaces.

    None if they share no opaque pixel.
    """
    both = (alpha > 0.5) & (alpha_base > 0.5) & (z_base > 0)
    if not both.any():
        return None
    base = z_base[both].astype(np.float64)
    return float((np.abs(z[both] - base) / base).mean())
