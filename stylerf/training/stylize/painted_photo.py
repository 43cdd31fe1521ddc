"""Stylize a photo in 2D with the loss used for views in 3D: what the loss can achieve without the limits of a field."""

from functools import partial

import numpy as np
import torch
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.style.color_matching import in_brightness_of, in_colors_of, match_colors, spread_at_most
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.image_stylization import ImageOptimization
from stylerf.style.style_loss import Content, StyleObjective
from stylerf.training.stylize.arf import OBJECTIVES
from stylerf.training.stylize.settings import ImageStyleSettings
from stylerf.training.stylize.silhouettes import mirror_pixels, object_colors, over

RATE = 0.03  # Adam's learning rate for pixels, as for SNeRF's images


def painted_photo(
    photo: np.ndarray,
    mask: np.ndarray | None,
    background: float,
    style_image: Tensor,
    settings: ImageStyleSettings,
    extractor: FeatureExtractor,
    steps: int,
    seed: int = 0,
) -> np.ndarray:
    """Optimize the pixels of a photo, with the settings' color matching and coarse first steps.

    Args:
        photo: [h, w, 3] sRGB 0..1, over the background.
        mask: The object, [h, w] bool; the rest keeps its color. None for the whole photo.
        background: Gray level behind the object, 0..1.
        style_image: [3, h', w'] sRGB 0..1.
        settings: Weights, loss, scales, color matching. Strokes have a single size, settings.stroke.
        extractor: Computes the features that the loss compares.
        steps: Adam steps, with a learning rate that decays linearly to 0; strokes show from about 60.
        seed: For the choice of style features.

    Returns:
        [h, w, 3] float32, 0..1.

    Raises:
        InvalidValue: `steps` is less than 1, or the mask is empty.
    """
    if steps < 1 or (mask is not None and not mask.any()):
        raise InvalidValue(f"expected at least one step and an object to paint, got {steps} steps")
    device = extractor.input_scale.device
    plain = torch.from_numpy(np.ascontiguousarray(photo, np.float32)).permute(2, 0, 1).contiguous()
    alpha = None if mask is None else torch.from_numpy(np.ascontiguousarray(mask, np.float32))
    weights = None if alpha is None else alpha.flatten()
    start, style_colors = plain, style_image
    if settings.keep_colors:
        style_colors = in_colors_of(style_image, plain.flatten(1).T, weights)
        style_image = in_brightness_of(style_image, plain.flatten(1).T, weights)
    else:
        style_colors = spread_at_most(style_image, plain.flatten(1).T, settings.max_gain, weights)
        if settings.match in ("both", "before"):
            start = _recolored(plain, style_colors, alpha)
    start, alpha = start.to(device), None if alpha is None else alpha.to(device)
    made = ImageOptimization(start, alpha, background, RATE)
    mirror = None if mask is None else torch.from_numpy(mirror_pixels(mask)).to(device)

    def shown(image: Tensor) -> Tensor:
        if alpha is None or mirror is None:
            return image
        return over(image, alpha, background, object_colors(image, alpha, mirror, background))

    def loss(objective: StyleObjective, content: Content | None, image: Tensor) -> tuple[Tensor, dict[str, float]]:
        return objective(shown(image), content, alpha)

    scale = 0.0
    for at in range(steps):
        wanted, layers = settings.features_at(at / steps)
        if wanted != scale:
            scale = wanted
            objective = OBJECTIVES[settings.loss](
                extractor.only(layers), style_image, (photo.shape[0], photo.shape[1]), settings.weights, scale,
                settings.style_rows, settings.style_basis, settings.style_scale, seed, settings.variation, 0,
                settings.diversity, (settings.stroke,), settings.rotations, settings.keep_colors,
            )  # fmt: skip
            content = objective.content_of(shown(start)) if settings.weights.need_photo else None
        objective.draw = at
        made.step(partial(loss, objective, content), 1 - at / steps)
    painted = made.seen().cpu()
    if settings.match in ("both", "after"):
        painted = _recolored(painted, style_colors, None if alpha is None else alpha.cpu())
    return np.ascontiguousarray(painted.permute(1, 2, 0).numpy())


def _recolored(image: Tensor, style_colors: Tensor, alpha: Tensor | None) -> Tensor:
    """Match the object's colors to those of a style image; its surroundings are unchanged."""
    weights = None if alpha is None else alpha.flatten()
    found = match_colors(image.flatten(1).T, style_colors.flatten(1).T, weights).image(image).float().clamp(0, 1)
    return found if alpha is None else torch.where(alpha > 0, found, image)
