"""View consistency along optical flow, by the protocols of published tables and a corrected one.

Images are [h, w, 3] sRGB 0..1. A pair is a source, the earlier frame, and a target. For flows, see optical_flow.py.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.metrics.consistency import PixelDistance, differences
from stylerf.metrics.optical_flow import check_flow, filled, occluded, sampled, visible

IMPORTANCE = -20.0  # factor of the photometric error, from the authors' example


def softmax_splat(image: np.ndarray, flow: np.ndarray, importance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Splat an image along a flow.

    Args:
        image: [h, w, c].
        flow: [h, w, 2]; pixels with unknown flow, and those that leave the image, are dropped.
        importance: Z, [h, w].

    Returns:
        The warped image [h, w, c], 0 where no pixel lands, and a mask of pixels where one does, [h, w] bool.
    """
    height, width, channels = image.shape
    check_flow(flow, (height, width))
    if importance.shape != (height, width):
        raise InvalidValue(f"importance {importance.shape} does not fit an image of {image.shape}")
    known = np.isfinite(flow).all(axis=-1).reshape(-1)
    rows, columns = np.divmod(np.flatnonzero(known), width)
    move = flow.reshape(-1, 2)[known]
    # Clipped to positions whose four neighbors are all outside: larger floats may not fit in int64.
    x, y = np.clip(columns + move[:, 0], -2, width + 1), np.clip(rows + move[:, 1], -2, height + 1)
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    colors = np.asarray(image, np.float64).reshape(-1, channels)[known]
    strength = np.asarray(importance, np.float64).reshape(-1)[known]
    weight = np.exp(strength - strength.max(initial=-np.inf))  # the maximum cancels out
    total, found = np.zeros(height * width), np.zeros((height * width, channels))
    landed = np.zeros(height * width, bool)
    for down in (0, 1):
        for right in (0, 1):
            i, j = top + down, left + right
            share = (1 - np.abs(x - j)) * (1 - np.abs(y - i))
            lands = (i >= 0) & (i < height) & (j >= 0) & (j < width) & (share > 0)
            place, part = i[lands] * width + j[lands], share[lands] * weight[lands]
            landed[place] = True
            total += np.bincount(place, part, height * width)
            for channel in range(channels):
                found[:, channel] += np.bincount(place, part * colors[lands, channel], height * width)
    # exp underflows to 0 where importance is far below the image's largest.
    landed &= total > 0
    warped = found / np.where(landed, total, 1)[:, None]
    return warped.reshape(height, width, channels), landed.reshape(height, width)


def photometric_importance(source: np.ndarray, target: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return Z [h, w]: IMPORTANCE times |source - target sampled along the flow|, averaged over RGB."""
    return np.asarray(IMPORTANCE * np.abs(np.asarray(source, np.float64) - sampled(target, flow)).mean(axis=-1))


ImageDistance = Callable[[np.ndarray, np.ndarray], float]  # two [h, w, 3] images in 0..1


@dataclass(frozen=True)
class FlowConsistency:
    """Consistency of a pair of frames.

    Attributes:
        error: By protocol, a mean of squares summed over RGB or a root mean square; None if nothing was compared.
        perceptual: Perceptual distance; None if nothing was compared or without a distance.
        share: Compared pixels divided by all selected ones.
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
    """Measure the same as LAENeRF's released scripts/eval, including its bugs.

    The source is warped by the backward flow. The script flags pixels where the FORWARD flow, sampled along the
    backward flow, does not cancel the FORWARD flow of the pixel itself (it should be the backward flow; everything that
    moves by half a pixel is flagged), or where the forward flow has an edge. The error is the mean over FLAGGED pixels
    of squared differences SUMMED over RGB, without a root. The perceptual distance covers the whole image, and LPIPS
    gets 0..1 instead of -1..1. Images are rounded to 8 bits, as in the script.

    Args:
        forward: Flow from source to target.
        backward: Flow from target to source.
    """
    _check(source, target, forward, backward)
    source, target = (np.round(image * 255) / 255 for image in (source, target))
    forward, backward = filled(forward), filled(backward)
    warped = sampled(source, backward)
    flagged = occluded(forward, sampled(forward, backward), forward)
    share = float(flagged.mean())
    error = float(((warped - target) ** 2).sum(axis=-1)[flagged].mean()) if flagged.any() else None
    # Our networks expect 0..1 and scale to -1..1, so (x + 1) / 2 reproduces LPIPS on unscaled x.
    halves = ((image.astype(np.float32) + 1) / 2 for image in (warped, target))
    return FlowConsistency(error, float(perceptual(*halves)) if perceptual is not None else None, share)


def stylerf_family(
    source: np.ndarray, target: np.ndarray, forward: np.ndarray, perceptual: PixelDistance | None = None
) -> FlowConsistency:
    """Measure consistency by the protocol of StyleRF and its followers: softmax splatting along the forward flow.

    All pixels on which a source pixel lands are compared: root mean square over them and RGB, and the mean of the
    distance map. The protocol ignores occlusion, so disoccluded pixels count as errors.
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
    """Measure the same as pair_consistency(), along flows: root mean square over visible target pixels and RGB.

    Visibility: see optical_flow.visible(). within: [h, w] bool, pixels of the target to compare; None for all.
    """
    _check(source, target, forward, backward)
    selected = np.ones(target.shape[:2], bool) if within is None else within
    return _over(sampled(source, backward), target, visible(forward, backward) & selected, selected, perceptual)


def _over(
    warped: np.ndarray, target: np.ndarray, compared: np.ndarray, selected: np.ndarray, perceptual: PixelDistance | None
) -> FlowConsistency:
    if not compared.any():
        return FlowConsistency(None, None, 0.0)
    error, distance = differences(warped, target, compared, perceptual)
    return FlowConsistency(error, distance, float(compared.sum() / selected.sum()))


def _check(source: np.ndarray, target: np.ndarray, forward: np.ndarray, backward: np.ndarray) -> None:
    if source.shape != target.shape or source.ndim != 3:
        raise InvalidValue(f"expected two images of one size, got {source.shape} and {target.shape}")
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise InvalidValue("an image holds values that are not finite")
    for flow in (forward, backward):
        check_flow(flow, target.shape[:2])
