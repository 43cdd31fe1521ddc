"""Rendering rays of a field, and the gradients back: march, color, composite."""

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
    """Rendered rays, with what backward() needs of them.

    Attributes:
        out: [rays, 5]: premultiplied rgb (sRGB-encoded), alpha, sum of w t without the opaque background's share.
        unmapped: out before the field's color map.
        rays, samples: what was marched.
        basis: [rays, bands], spherical harmonics of the directions.
        colors: [n, 3] of the samples; -1 in the first channel where a sample has none; [0, 3] of a blend, which
            cannot learn.
        arena: where the samples' memory came from, and the gradients' comes from.
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
        threads: partitions of the rays; the result is the same to the bit for the same number.
        min_transmittance: a ray ends once its transmittance falls below this.
        weight_threshold: part of its ray's largest weight below which a sample takes the ray's mean color; the layers
            of a blend have their own.
        arena: memory of samples and colors, valid until its reset; None: new memory.

    Returns:
        Rendered, its `out` in the field's own colors on no background.
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
    """Return [rays, 5]: premultiplied rgb, alpha, distance of the visible surface (scene units, 0 where alpha is 0)."""
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
    """Add the parts' gradients to buffers [threads, parameters]; a buffer of None leaves its part out.

    The field's color map is not differentiated: `gradients` are those of the colors before it.

    Args:
        field, rendered: as render_rays took and returned them.
        gradients: dL/d(unmapped), [rays, 5].
        density_to, color_to: buffers of the parts' values.
        displacement_to: buffer of the displacement grid, [threads, 3 m^3].
        near_scaling_distance: scene units; gradients of nearer samples are scaled by the square of their distance
            relative to it. 0: no scaling.
        distortion: weight of the sum of the rays' distortions (distortion_backward).
        density_within: [s, s, s] bool, cells of the cube outside of which no density learns.
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
    """Return the sum of each ray's weights over samples in marked cells [s, s, s], [rays] float32."""
    out = np.zeros(len(samples.ends), np.float32)
    flat = np.ascontiguousarray(marked).reshape(-1)
    weights_inside(flat, marked.shape[0], samples.shading_points(), threads, out)
    return out


def composite_layers(
    color: BlendedColor, samples: Samples, directions: np.ndarray, threads: int, arena: ScratchArena | None = None
) -> np.ndarray:
    """Composite samples of a blend: each layer by itself, as its own field would show it, then added up.

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
