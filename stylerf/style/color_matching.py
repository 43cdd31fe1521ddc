"""Exact color matching: the affine map that gives one set of colors the mean and covariance of another.

    A = V_s^(1/2) V_c^(-1/2),  b = mu_s - A mu_c,  x' = A x + b        (ARF; symmetric square roots)

with mu, V the weighted mean and covariance (1/N) of the content colors c and the style colors s. It is a map of
colors as they are seen (sRGB-encoded, [0, 1]); spherical-harmonic coefficients are not colors.
"""

from collections.abc import Iterable

import torch
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.fields.color_map import ColorMap
from stylerf.srgb import LUMA

VARIANCE_FLOOR = 1e-8  # eigenvalues of a covariance below this are raised to it (ARF clamps its singular values so)
NOISE = (2 / 255) ** 2  # variance of content below which it is no color but the noise of a photo in eight bits


def color_statistics(colors: Tensor, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Weighted mean [3] and covariance [3, 3] (divided by the sum of weights) of colors [n, 3], in float64."""
    if colors.dim() != 2 or colors.shape[1] != 3 or colors.shape[0] == 0:
        raise InvalidValue(f"expected colors [n, 3] with n > 0, found {tuple(colors.shape)}")
    colors = colors.double()
    weights = torch.ones_like(colors[:, 0]) if weights is None else weights.double()
    total = weights.sum()
    if not (float(total) > 0 and torch.isfinite(colors).all()):
        raise InvalidValue("colors to match must be finite and their weights must not all be 0")
    mean = (weights[:, None] * colors).sum(dim=0) / total
    centerd = colors - mean
    return mean, (weights[:, None] * centerd).T @ centerd / total


def symmetric_power(covariance: Tensor, exponent: float, least: float = VARIANCE_FLOOR) -> Tensor:
    """V^exponent of a symmetric matrix through its eigenvalues, each raised to at least `least` first."""
    values, vectors = torch.linalg.eigh(covariance)
    return (vectors * values.clamp_min(least).pow(exponent)) @ vectors.T


def match_colors(
    content: Tensor,  # [n, 3] sRGB
    style: Tensor,  # [m, 3] sRGB
    content_weights: Tensor | None = None,  # [n], for example alpha
    style_weights: Tensor | None = None,  # [m]
) -> ColorMap:
    """The map after which the content's weighted mean and covariance are the style's (exactly, before clamping).

    Float64 inside and out, on the CPU. A content with less spread in some direction than NOISE (a gray picture) gains
    only in proportion there: exactly matched, its noise would become colors.
    """
    mean_c, covariance_c = color_statistics(content.cpu(), _on_cpu(content_weights))
    mean_s, covariance_s = color_statistics(style.cpu(), _on_cpu(style_weights))
    matrix = symmetric_power(covariance_s, 0.5) @ symmetric_power(covariance_c, -0.5, NOISE)
    return ColorMap(matrix, mean_s - matrix @ mean_c)


def spread_at_least(painting: Tensor, least: float) -> Tensor:
    """A painting [3, h, w] to take colors from, whose luma has a standard deviation of at least `least` (0..0.25).

    Exact matching to a painting of one color takes all light and shade from a scene. One with less spread than asked
    for is given the rest in gray: d is added to every other pixel and taken from those between, which keeps its mean
    and adds d^2 to every entry of its covariance. Where 0..1 leaves no room for that, colors move inwards first.
    """
    if least <= 0:
        return painting
    weights = torch.tensor(LUMA, dtype=torch.float64)
    flat = painting.double().flatten(1)
    missing = least**2 - float((weights @ (flat - flat.mean(1, keepdim=True))).square().mean())
    if missing <= 0:
        return painting
    step = missing**0.5
    signs = torch.ones(flat.shape[1], dtype=torch.float64)
    signs[1::2] = -1
    inside = flat.clamp(step, 1 - step)
    return (inside + step * signs).reshape(painting.shape).to(painting.dtype)


def spread_at_most(
    painting: Tensor,  # [3, h, w] sRGB
    content: Tensor,  # [n, 3] sRGB
    most: float,
    content_weights: Tensor | None = None,  # [n]
) -> Tensor:
    """A painting [3, h, w] to take colors from, for which no spread of the content grows more than `most` times.

    Exact matching to it then stretches no principal axis of the content's colors further; 0: any stretch. Along those
    along which the painting spreads more, its colors are drawn in towards their mean, which they keep: with E the
    content's axes, l_k its variances and V the painting's covariance, by E D E^T, D_k = min(1, most sqrt(l_k / (E^T V
    E)_kk)). It may lie a little beyond 0..1: it is for its mean and covariance, not to be looked at.
    """
    if most <= 0:
        return painting
    spread, axes = torch.linalg.eigh(color_statistics(content.cpu(), _on_cpu(content_weights))[1])
    mean, covariance = color_statistics(painting.cpu().flatten(1).T)
    wanted = (axes.T @ covariance @ axes).diagonal().clamp_min(VARIANCE_FLOOR)
    drawn = (most * (spread.clamp_min(VARIANCE_FLOOR) / wanted).sqrt()).clamp_max(1.0)
    if bool((drawn == 1).all()):
        return painting
    matrix = (axes * drawn) @ axes.T
    colors = (painting.cpu().double().flatten(1).T - mean) @ matrix.T + mean
    return colors.T.reshape(painting.shape).to(painting)


def strokes_in(painting: Tensor, least: float) -> float:
    """0..1: what there is of strokes in a painting [3, h, w], its colors' spread (rms over channels) over `least`.

    Features of a blank one are alike everywhere: a scene that is taught them loses its own and gains noise.
    """
    if least <= 0:
        return 1.0
    flat = painting.double().flatten(1)
    spread = float((flat - flat.mean(1, keepdim=True)).square().mean()) ** 0.5
    return min(1.0, spread / least)


def pixels_of(
    images: Iterable[
        Tensor
    ],  # each [3 or 4, h, w], looked at once and let go; a fourth channel is straight alpha and becomes the weight
    most: int = 200_000,
    seed: int = 0,
    count: int | None = None,  # pixels of all; needed where images are made one at a time
) -> tuple[Tensor, Tensor]:
    """Colors [n, 3] and weights [n] of a set of images, a seeded sample of at most about `most` pixels.

    Every image gives the same share of its pixels, so that large ones count for more, as in the whole set.
    """
    if count is None:
        count = sum(image.shape[1] * image.shape[2] for image in images)
    generator = torch.Generator().manual_seed(seed)
    colors, weights = [], []
    for image in images:
        flat = image.flatten(1).T.cpu()
        if count > most:
            take = max(1, round(flat.shape[0] * most / count))
            flat = flat[torch.randint(flat.shape[0], (take,), generator=generator)]
        colors.append(flat[:, :3])
        weights.append(flat[:, 3] if flat.shape[1] == 4 else torch.ones_like(flat[:, 0]))
    return torch.cat(colors), torch.cat(weights)


def _on_cpu(values: Tensor | None) -> Tensor | None:
    return None if values is None else values.cpu()
