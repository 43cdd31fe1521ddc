"""Compositing blended colors: each layer by itself, as its own field would show it, then added up."""

import numpy as np

from stylerf.fields.blended_color import EVERYWHERE, BlendedColor, Layer
from stylerf.fields.color_map import ColorMap
from stylerf.fields.marching import ScratchArena, empty_array
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.compositing import composite_share, keep_shared, visible_weights
from stylerf.kernels.cpu.ray_samples import Samples
from stylerf.kernels.cpu.regions import weights_inside


def composite_layers(
    color: BlendedColor, samples: Samples, directions: np.ndarray, threads: int, arena: ScratchArena | None = None
) -> np.ndarray:
    """Composite samples of a blend.

    Args:
        color: its layers, each with the color map and the threshold of its own field.
        samples: on rays.
        directions: [rays, 3], unit.
        threads: partitions of the rays.
        arena: where memory for samples comes from; None: new memory.

    Returns:
        [rays, 5]: premultiplied rgb (sRGB-encoded), alpha, sum of w t without the opaque background's share.
    """
    out = np.zeros((len(directions), 5), np.float32)
    points = samples.shading_points()
    for layer, shares in color.shares(points, threads, arena):
        part = _composited(layer, shares, samples, directions, threads, arena)
        out[:, :3] += mapped(part, layer.color_map)[:, :3]
        out[:, 4] = part[:, 4]  # the same of each
    alpha = np.empty(len(out), np.float32)
    weights_inside(EVERYWHERE.reshape(-1), 1, points, threads, alpha)
    out[:, 3] = alpha
    return out


def _composited(
    layer: Layer, shares: np.ndarray, samples: Samples, directions: np.ndarray, threads: int, arena: ScratchArena | None
) -> np.ndarray:
    """Return [rays, 5] of one layer, before its color map; its alpha is the share of the ray's that is the layer's."""
    visible, shown = empty_array(samples.weights.shape, arena), empty_array(samples.weights.shape, arena)
    visible_weights(samples, np.float32(layer.weight_threshold), threads, visible)
    keep_shared(visible, shares, samples.starts, samples.ends, threads, shown)
    basis = harmonics(directions, layer.color.degree)
    colors = layer.color.colors(samples.shading_points(shown), basis, threads, arena)
    out = np.empty((len(directions), 5), np.float32)
    composite_share(samples, visible, colors, shares, threads, out)
    return out


def mapped(out: np.ndarray, color_map: ColorMap | None) -> np.ndarray:
    """Return composited rays [rays, 5] with their colors mapped, and clamped to 0..alpha; unchanged without a map."""
    if color_map is None:
        return out
    import torch  # takes more than a second, which fields without a color map need not wait for

    # Premultiplied colors lie in 0..alpha.
    colors = color_map.premultiplied(torch.from_numpy(out[:, :3]), torch.from_numpy(out[:, 3]))
    return np.concatenate([np.clip(colors.numpy(), 0, out[:, 3:4]), out[:, 3:]], 1)
