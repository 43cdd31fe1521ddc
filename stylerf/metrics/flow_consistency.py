"""View consistency as others measure it, along a flow: so that figures stand beside their tables, and as it should be.

Images are [h, w, 3] sRGB-encoded 0..1; a pair is a source (the earlier frame) and a target; flows: see optical_flow.py.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.metrics.consistency import PixelDistance
from stylerf.metrics.optical_flow import check_flow, filled, occluded, sampled, visible
from stylerf.metrics.splatting import photometric_importance, softmax_splat

ImageDistance = Callable[[np.ndarray, np.ndarray], float]  # two [h, w, 3] images in 0..1


@dataclass(frozen=True)
class FlowConsistency:
    """error, perceptual: None where nothing could be compared (or no distance was given). share: of all pixels asked.

    What the error is depends on the protocol: a mean squared one of a sum over RGB, or a root mean square.
    """

    error: float | None
    perceptual: float | None
    share: float


def laenerf_script(
    source: np.ndarray,
    target: np.ndarray,
    forward: np.ndarray,
    backward: np.ndarray,
    perceptual: ImageDistance | None = None,
) -> FlowConsistency:
    """What LAENeRF's released scripts/eval measures, faults and all.

    forward: flow from source to target, backward: from target to source. The source is read along the backward flow.
    Flagged are pixels where the FORWARD flow, read there, does not cancel with the FORWARD flow of the pixel itself
    (it should be the backward one: all that moves by half a pixel is flagged), or where the forward flow has a step.
    The error is the mean over FLAGGED pixels of the squared difference SUMMED over RGB, without a root.
    The perceptual distance is of the whole image and is given values of 0..1 where LPIPS expects -1..1. Images are
    rounded to eight bits as the script reads them.
    """
    _check(source, target, forward, backward)
    source, target = (np.round(image * 255) / 255 for image in (source, target))
    forward, backward = filled(forward), filled(backward)
    warped = sampled(source, backward)
    flagged = occluded(forward, sampled(forward, backward), forward)
    share = float(flagged.mean())
    error = float(((warped - target) ** 2).sum(axis=-1)[flagged].mean()) if flagged.any() else None
    # Our networks take 0..1 and scale by themselves: what LPIPS makes of x as -1..1, they make of (x + 1) / 2.
    halves = ((image.astype(np.float32) + 1) / 2 for image in (warped, target))
    return FlowConsistency(error, float(perceptual(*halves)) if perceptual is not None else None, share)


def stylerf_family(
    source: np.ndarray, target: np.ndarray, forward: np.ndarray, perceptual: PixelDistance | None = None
) -> FlowConsistency:
    """StyleRF's and its followers' protocol: the source is splatted along the forward flow by softmax splatting.

    Compared are the pixels that any source pixel lands on: root mean square over these and RGB, and mean of the
    distance map there, elsewhere both images being the target. What is hidden in the source and filled from beside it
    counts as an error: the protocol knows no occlusion.
    """
    _check(source, target, forward, forward)
    warped, landed = softmax_splat(source, forward, photometric_importance(source, target, forward))
    return _over(warped, target, landed, np.ones_like(landed), perceptual)


def flow_consistency(
    source: np.ndarray,
    target: np.ndarray,
    forward: np.ndarray,
    backward: np.ndarray,
    perceptual: PixelDistance | None = None,
    within: np.ndarray | None = None,
) -> FlowConsistency:
    """The measure of `pair_consistency` along flows: root mean square over the target's visible pixels and RGB.

    Visible by `flow.visible`. within: bool [h, w], the pixels of the target that are asked about (None: all).
    """
    _check(source, target, forward, backward)
    asked = np.ones(target.shape[:2], bool) if within is None else within
    return _over(sampled(source, backward), target, visible(forward, backward) & asked, asked, perceptual)


def _over(
    warped: np.ndarray, target: np.ndarray, compared: np.ndarray, asked: np.ndarray, perceptual: PixelDistance | None
) -> FlowConsistency:
    if not compared.any():
        return FlowConsistency(None, None, 0.0)
    distance = None
    if perceptual is not None:
        patched = np.where(compared[..., None], warped, target).astype(np.float32)
        distance = float(perceptual(patched, target.astype(np.float32))[compared].mean())
    error = float(np.sqrt(((warped - target)[compared] ** 2).mean()))
    return FlowConsistency(error, distance, float(compared.sum() / asked.sum()))


def _check(source: np.ndarray, target: np.ndarray, forward: np.ndarray, backward: np.ndarray) -> None:
    if source.shape != target.shape or source.ndim != 3:
        raise InvalidValue(f"two images of one size were expected, got {source.shape} and {target.shape}")
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise InvalidValue("an image holds values that are not finite")
    for flow in (forward, backward):
        check_flow(flow, target.shape[:2])
