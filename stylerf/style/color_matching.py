"""Color matching: the affine map that transfers the mean and covariance of one set of colors to another.

    A = V_s^(1/2) V_c^(-1/2),  b = mu_s - A mu_c,  x' = A x + b        (ARF; symmetric square roots)

with mu, V the weighted mean and covariance (1/N) of the content colors c and the style colors s. It maps sRGB colors
0..1, not spherical-harmonic coefficients.
"""

from collections.abc import Iterable

import torch
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.fields.color_map import ColorMap
from stylerf.srgb import LUMA
from stylerf.style.transparency import shown_colors

VARIANCE_FLOOR = 1e-8  # smallest eigenvalue of a covariance (ARF clamps its singular values likewise)
SAMPLE = 200_000  # pixels that represent all
NOISE = (2 / 255) ** 2  # variance below which the content's variation is noise of 8-bit photos


def color_statistics(colors: Tensor, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Return weighted mean [3] and covariance [3, 3] (divided by the sum of weights) of colors [n, 3], in float64."""
    if colors.dim() != 2 or colors.shape[1] != 3 or colors.shape[0] == 0:
        raise InvalidValue(f"expected colors [n, 3] with n > 0, found {tuple(colors.shape)}")
    # float64, because the inverse square root of a covariance amplifies rounding along its weakest axis.
    colors = colors.double()
    weights = torch.ones_like(colors[:, 0]) if weights is None else weights.double()
    total = weights.sum()
    if not (float(total) > 0 and torch.isfinite(colors).all()):
        raise InvalidValue("colors must be finite, and their weights not all 0")
    mean = (weights[:, None] * colors).sum(dim=0) / total
    centered = colors - mean
    return mean, (weights[:, None] * centered).T @ centered / total


def symmetric_power(covariance: Tensor, exponent: float, floor: float = VARIANCE_FLOOR) -> Tensor:
    """Return V^exponent of a symmetric matrix, with eigenvalues clamped to at least `floor`."""
    values, vectors = torch.linalg.eigh(covariance)
    return (vectors * values.clamp_min(floor).pow(exponent)) @ vectors.T


def match_colors(
    content: Tensor,  # [n, 3] sRGB
    style: Tensor,  # [m, 3] sRGB
    content_weights: Tensor | None = None,  # [n], for example alpha
    style_weights: Tensor | None = None,  # [m]
) -> ColorMap:
    """Return the map that gives the content the style's weighted mean and covariance, before clamping; float64, CPU.

    Along directions in which the content varies less than NOISE, as in gray images, the match is only proportional;
    otherwise noise would turn into colors.
    """
    mean_c, covariance_c = color_statistics(content.cpu(), _on_cpu(content_weights))
    mean_s, covariance_s = color_statistics(style.cpu(), _on_cpu(style_weights))
    # A V_c A^T = V_s for A = V_s^(1/2) Q V_c^(-1/2) with any orthogonal Q; ARF takes the identity.
    matrix = symmetric_power(covariance_s, 0.5) @ symmetric_power(covariance_c, -0.5, NOISE)
    return ColorMap(matrix, mean_s - matrix @ mean_c)


def in_colors_of(style_image: Tensor, colors: Tensor, weights: Tensor | None = None) -> Tensor:
    """Return a style image [3 or 4, h, w] with the weighted mean and covariance of sRGB colors [n, 3].

    A fourth channel is alpha, which is unchanged; hidden pixels do not count.
    """
    matched = match_colors(shown_colors(style_image).flatten(1).T, colors, style_weights=weights).image(style_image[:3])
    return torch.cat([matched.float(), style_image[3:]])


def in_brightness_of(style_image: Tensor, colors: Tensor, weights: Tensor | None = None) -> Tensor:
    """Return a style image [3 or 4, h, w] in gray, with the mean and variance of the brightness of sRGB colors [n, 3].

    Brightness is the mean of the three channels, so that anything trained with it keeps its hue (Gatys et al. 2016,
    "Preserving color", luminance-only transfer). A fourth channel is alpha, which is unchanged; hidden pixels do not
    count.
    """
    gray = style_image[:3].mean(0, keepdim=True).expand(3, -1, -1)
    return in_colors_of(torch.cat([gray, style_image[3:]]), colors.mean(1, keepdim=True).expand(-1, 3), weights)


def spread_at_least(style_image: Tensor, least: float) -> Tensor:
    """Return the style image [3, h, w] with a standard deviation of luma of at least `least` (0..0.25).

    Exact matching to a uniform style image would remove all shading. The missing variance is added in gray: d is
    alternately added to and subtracted from pixels, which preserves the mean and adds d^2 to every entry of the
    covariance. Colors are first clamped so that the result stays in 0..1.
    """
    if least <= 0:
        return style_image
    weights = torch.tensor(LUMA, dtype=torch.float64)
    flat = style_image.double().flatten(1)
    missing = least**2 - float((weights @ (flat - flat.mean(1, keepdim=True))).square().mean())
    if missing <= 0:
        return style_image
    step = missing**0.5
    signs = torch.ones(flat.shape[1], dtype=torch.float64)
    signs[1::2] = -1
    inside = flat.clamp(step, 1 - step)  # least <= 0.25, so step < 1 - step
    return (inside + step * signs).reshape(style_image.shape).to(style_image.dtype)


def spread_at_most(
    style_image: Tensor,  # [3, h, w] sRGB
    content: Tensor,  # [n, 3] sRGB
    most: float,
    content_weights: Tensor | None = None,  # [n]
) -> Tensor:
    """Return the style image [3, h, w] with colors contracted so that matching stretches the content at most `most`x.

    Limits the gain along each principal axis of the content's colors; 0 for no limit. Where the style image varies
    more, its colors are contracted towards their mean by E D E^T, D_k = min(1, most sqrt(l_k / (E^T V E)_kk)), with E
    the content's axes, l_k its variances and V the style image's covariance. The result may slightly exceed 0..1; use
    only its mean and covariance.
    """
    if most <= 0:
        return style_image
    spread, axes = torch.linalg.eigh(color_statistics(content.cpu(), _on_cpu(content_weights))[1])
    mean, covariance = color_statistics(style_image.cpu().flatten(1).T)
    wanted = (axes.T @ covariance @ axes).diagonal().clamp_min(VARIANCE_FLOOR)
    drawn = (most * (spread.clamp_min(VARIANCE_FLOOR) / wanted).sqrt()).clamp_max(1.0)  # [3]; decision 0036
    if bool((drawn == 1).all()):
        return style_image
    matrix = (axes * drawn) @ axes.T
    colors = (style_image.cpu().double().flatten(1).T - mean) @ matrix.T + mean
    return colors.T.reshape(style_image.shape).to(style_image)


def strokes_in(style_image: Tensor, least: float) -> float:
    """Return how much texture a style image [3, h, w] has: its standard deviation, rms over channels, / `least`; 0..1.

    Features of a blank image are the same everywhere; matching them erases a scene's features and adds noise.
    """
    if least <= 0:
        return 1.0
    flat = style_image.double().flatten(1)
    spread = float((flat - flat.mean(1, keepdim=True)).square().mean()) ** 0.5
    return min(1.0, spread / least)


def pixels_of(
    images: Iterable[Tensor], most: int = SAMPLE, seed: int = 0, count: int | None = None
) -> tuple[Tensor, Tensor]:
    """Sample colors [n, 3] and weights [n] from a set of images: the same fraction of each one's counted pixels.

    Args:
        images: [3 or 4, h, w] each; a fourth channel is straight alpha, which becomes the weight. Pixels with alpha 0
            are not counted. Iterated over once if `count` is given, else twice.
        most: Approximate maximum size of the sample.
        seed: Of the sample.
        count: Total number of counted pixels in all images; required for an iterator.
    """
    if count is None:
        count = sum(len(_counting(image)) for image in images)
    generator = torch.Generator().manual_seed(seed)
    rows = []
    for image in images:
        flat = _counting(image)
        if count > most and len(flat):
            flat = _drawn(flat, max(1, round(len(flat) * most / count)), generator)
        rows.append(flat)
    sample = torch.cat(rows)
    return sample[:, :3], sample[:, 3]


def sample_of(image: Tensor, most: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Sample colors [n, 3] and weights [n], n <= most, from one image; weights add up to about those of all its pixels.

    Samples of several images can therefore be concatenated. Arguments as for pixels_of().
    """
    flat = _counting(image)
    sample = _drawn(flat, most, generator) if len(flat) > most else flat
    return sample[:, :3], sample[:, 3] * (len(flat) / max(len(sample), 1))


def _counting(image: Tensor) -> Tensor:
    """Return (color, weight) [n, 4] of an image's pixels with positive weight; see pixels_of()."""
    flat = image.flatten(1).T.cpu()
    if flat.shape[1] == 3:
        return torch.cat([flat, torch.ones_like(flat[:, :1])], 1)
    return flat[flat[:, 3] > 0]


def _drawn(rows: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Return `count` random rows, drawn with replacement."""
    return rows[torch.randint(len(rows), (count,), generator=generator)]


def _on_cpu(values: Tensor | None) -> Tensor | None:
    return None if values is None else values.cpu()
