"""Errors of a rendered depth against the true one."""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue


@dataclass(frozen=True)
class DepthErrors:
    """Errors over the compared pixels; None where there was none to compare.

    abs_rel: mean |z - z*| / z*. rmse: sqrt(mean (z - z*)^2), scene units. delta: share of pixels with
    max(z/z*, z*/z) < 1.25. in_front: share of pixels whose depth falls short of the truth by more than a tenth of it
    (a haze or a floater before the surface). share: compared pixels over pixels that have a true depth.
    """

    abs_rel: float | None
    rmse: float | None
    delta: float | None
    in_front: float | None
    share: float
    pixels: int


def depth_errors(z: np.ndarray, alpha: np.ndarray, truth: np.ndarray, far: float = 1e9) -> DepthErrors:
    """Compare planar depth `z` with `truth`, both [h, w] scene units, where alpha > 0.5 and the truth is a surface.

    The truth is a surface where it is finite, positive and below `far` (a file's constant for "nothing there").
    Raises InvalidValue when a compared depth is not finite.
    """
    if not z.shape == alpha.shape == truth.shape:
        raise InvalidValue(f"depth {z.shape}, alpha {alpha.shape} and truth {truth.shape} are not of one size")
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
    ratio = np.maximum(ours, 1e-12) / true
    return DepthErrors(
        abs_rel=float((np.abs(difference) / true).mean()),
        rmse=float(np.sqrt((difference**2).mean())),
        delta=float((np.maximum(ratio, 1 / ratio) < 1.25).mean()),
        in_front=float((ratio < 0.9).mean()),
        share=share,
        pixels=count,
    )


def shape_change(z: np.ndarray, alpha: np.ndarray, z_base: np.ndarray, alpha_base: np.ndarray) -> float | None:
    """Mean |z - z_base| / z_base where both are opaque (alpha > 0.5): how far a stylized surface left its origin.

    None where the two share no opaque pixel.
    """
    both = (alpha > 0.5) & (alpha_base > 0.5) & (z_base > 0)
    if not both.any():
        return None
    base = z_base[both].astype(np.float64)
    return float((np.abs(z[both] - base) / base).mean())
