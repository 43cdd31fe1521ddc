"""Differentiable rendering of a field's rays: march, color, composite, and the backward pass."""

from dataclasses import dataclass

import numpy as np

from stylerf.fields.blended_color import EVERYWHERE, BlendedColor, Layer
from stylerf.fields.color_map import ColorMap
from stylerf.fields.deformation import displacement_gradient, position_gradients
from stylerf.fields.marching import SAMPLES_PER_RAY, ScratchArena, empty_array
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.compositing import (
    composite,
    composite_backward,
    composite_share,
    distortion_backward,
    keep_shared,
    scale_near_gradients,
    surface_distance,
    visible_weights,
)
from stylerf.kernels.cpu.ray_samples import Rays, Samples
from stylerf.kernels.cpu.regions import weights_inside, zero_outside


@dataclass
class Rendered:
    """Rendered rays, with everything that backward() needs.

    Attributes:
        out: [rays, 5]: premultiplied rgb (sRGB-encoded), alpha, sum of w t without the opaque background's share.
        unmapped: `out` before the field's color map.
        rays, samples: the marched rays and their samples.
        basis: [rays, bands], spherical harmonics of the directions.
        colors: [n, 3], the samples' colors; -1 in the first channel of uncolored samples; [0, 3] for a blend, which
            cannot learn.
        arena: allocates samples and gradients.
    """

    out: np.ndarray
    unmapped: np.ndarray
    rays: Rays
    samples: Samples
    basis: np.ndarray
    colors: np.ndarray
    arena: ScratchArena | None = None


def render_rays(
    field: RadianceField,
    rays: Rays,
    *,
    threads: int,
    min_transmittance: float = 1e-3,
    weight_threshold: float = 2e-2,
    arena: ScratchArena | None = None,
) -> Rendered:
    """Render rays.

    Args:
        threads: partitions of the rays; results are bit-identical for the same number.
        min_transmittance: transmittance below which a ray terminates.
        weight_threshold: fraction of its ray's largest weight below which a sample gets the ray's mean color; the
            layers of a blend have their own.
        arena: allocates samples and colors, which are valid until its reset; None: new memory.

    Returns:
        Rendered, with `out` without a background.
    """
    samples = field.march(rays, SAMPLES_PER_RAY, min_transmittance, threads, arena)
    basis = harmonics(rays.directions, getattr(field.color, "degree", 0))
    if isinstance(field.color, BlendedColor):
        unmapped = composite_layers(field.color, samples, rays.directions, threads, arena)
        colors = np.empty((0, 3), np.float32)  # each layer has its own
    else:
        visible = empty_array(samples.weights.shape, arena)
        visible_weights(samples, np.float32(weight_threshold), threads, visible)
        colors = field.color.colors(samples.shading_points(visible), basis, threads, arena)
        unmapped = np.empty((len(rays.origins), 5), np.float32)
        composite(samples, colors, threads, unmapped)
    return Rendered(mapped(unmapped, field.color_map), unmapped, rays, samples, basis, colors, arena)


def with_surface_distance(rendered: Rendered, threads: int) -> np.ndarray:
    """Return [rays, 5]: premultiplied rgb, alpha, distance to the visible surface (scene units, 0 where alpha is 0)."""
    out = rendered.out.copy()
    surface_distance(rendered.samples, threads, out)
    return out


def backward(
    field: RadianceField,
    rendered: Rendered,
    gradients: np.ndarray,
    density_to: np.ndarray | None,
    color_to: np.ndarray | None,
    displacement_to: np.ndarray | None = None,
    *,
    near_scaling_distance: float = 0.0,
    distortion: float = 0.0,
    density_within: np.ndarray | None = None,
) -> None:
    """Add the parts' gradients to buffers [threads, parameters]; parts whose buffer is None are skipped.

    The field's color map is not differentiated: `gradients` are with respect to the colors before it.

    Args:
        field, rendered: argument and result of render_rays().
        gradients: dL/d(unmapped), [rays, 5].
        density_to, color_to: buffers for the parts' values.
        displacement_to: buffer for the displacement grid, [threads, 3 m^3].
        near_scaling_distance: scene units; gradients of nearer samples are scaled by (distance / this)^2. 0: no
            scaling.
        distortion: weight of the distortion loss, summed over rays (distortion_backward).
        density_within: [s, s, s] bool, the only cells of the cube whose density learns; None: all.
    """
    samples, colors, arena = rendered.samples, rendered.colors, rendered.arena
    sigma_gradients = empty_array(samples.sigma.shape, arena)
    color_gradients = empty_array(colors.shape, arena)
    threads = len(next(to for to in (color_to, density_to, displacement_to) if to is not None))
    composite_backward(samples, colors, rendered.unmapped, gradients, threads, sigma_gradients, color_gradients)
    # In place: density, color and displacement all learn from the scaled gradients.
    if near_scaling_distance > 0:
        scale_near_gradients(samples, np.float32(near_scaling_distance), threads, sigma_gradients, color_gradients)
    if distortion > 0:
        middle = np.float32(field.space.middle)
        distortion_backward(samples, np.float32(distortion), middle, threads, sigma_gradients)
    if color_to is not None:
        points = samples.shading_points()
        field.color.backward(points, rendered.basis, colors, color_gradients, color_to)
    if density_to is not None:
        if density_within is not None:
            zero_outside(density_within.reshape(-1), len(density_within), samples, threads, sigma_gradients)
        field.density.backward(samples, sigma_gradients, density_to)
    if displacement_to is not None and field.displacement is not None:
        at_positions = position_gradients(
            field.density, field.color, samples, rendered.basis, sigma_gradients, colors, color_gradients, threads
        )
        vertices = len(field.displacement)
        displacement_gradient(field.space, rendered.rays, samples, at_positions, vertices, displacement_to)


def alpha_inside(marked: np.ndarray, samples: Samples, threads: int) -> np.ndarray:
    """Return the sum of each ray's weights over samples in marked cells [s, s, s] bool, [rays] float32."""
    out = np.zeros(len(samples.ends), np.float32)
    flat = np.ascontiguousarray(marked).reshape(-1)
    weights_inside(flat, marked.shape[0], samples.shading_points(), threads, out)
    return out


def composite_layers(
    color: BlendedColor, samples: Samples, directions: np.ndarray, threads: int, arena: ScratchArena | None = None
) -> np.ndarray:
    """Composite the samples of a blend layer by layer, each as its own field would render it, and add them up.

    Args:
        color: the blend; each layer has the color map and the threshold of its own field.
        samples: of the rays.
        directions: [rays, 3], unit vectors.
        threads: partitions of the rays.
        arena: allocates per-sample arrays; None: new memory.

    Returns:
        [rays, 5]: premultiplied rgb (sRGB-encoded), alpha, sum of w t without the opaque background's share.
    """
    out = np.zeros((len(directions), 5), np.float32)
    points = samples.shading_points()
    for layer, shares in color.shares(points, threads, arena):
        part = _composited(layer, shares, samples, directions, threads, arena)
        out[:, :3] += mapped(part, layer.color_map)[:, :3]
        out[:, 4] = part[:, 4]  # the same for every layer
    alpha = np.empty(len(out), np.float32)
    weights_inside(EVERYWHERE.reshape(-1), 1, points, threads, alpha)
    out[:, 3] = alpha
    return out


def _composited(
    layer: Layer, shares: np.ndarray, samples: Samples, directions: np.ndarray, threads: int, arena: ScratchArena | None
) -> np.ndarray:
    """Composite one layer, [rays, 5], before its color map; alpha is the layer's share of the ray's alpha."""
    visible, shown = empty_array(samples.weights.shape, arena), empty_array(samples.weights.shape, arena)
    visible_weights(samples, np.float32(layer.weight_threshold), threads, visible)
    keep_shared(visible, shares, samples.starts, samples.ends, threads, shown)
    basis = harmonics(directions, layer.color.degree)
    colors = layer.color.colors(samples.shading_points(shown), basis, threads, arena)
    out = np.empty((len(directions), 5), np.float32)
    composite_share(samples, visible, colors, shares, threads, out)
    return out


def mapped(out: np.ndarray, color_map: ColorMap | None) -> np.ndarray:
    """Return composited rays [rays, 5] with colors mapped and clamped to 0..alpha; unchanged without a map."""
    if color_map is None:
        return out
    import torch  # takes more than a second to import, and only fields with a color map need it

    # Premultiplied colors are in 0..alpha.
    colors = color_map.premultiplied(torch.from_numpy(out[:, :3]), torch.from_numpy(out[:, 3]))
    return np.concatenate([np.clip(colors.numpy(), 0, out[:, 3:4]), out[:, 3:]], 1)
