"""Rays through a field to pixels, and gradients back: march, density, color, composite."""

from dataclasses import dataclass

import numpy as np
import torch

from stylerf.fields.displacement_grid import displacement_gradient, position_gradients
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.ray_samples import Rays, Samples
from stylerf.fields.scratch_arena import room
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.compositing import composite, composite_backward, scale_near, significant, surface_distance
from stylerf.kernels.cpu.regions import keep_inside

SAMPLE_LIMIT = 512


@dataclass
class Rendered:
    """What rays came back with. out [rays, 5]: premultiplied rgb, alpha, sum of w t without a backdrop's.

    The rest serves the backward. unmapped: out before the field's color map.
    """

    out: np.ndarray
    unmapped: np.ndarray
    rays: Rays
    samples: Samples
    basis: np.ndarray
    colors: np.ndarray


def render_rays(field: RadianceField, rays: Rays, *, chunks: int, opaque=1e-3, share=2e-2) -> Rendered:
    """Render rays. opaque: transmittance at which a ray ends.

    share: part of its ray's largest weight under which a sample gets no color of its own, but the ray's mean.
    """
    samples = field.march(rays, SAMPLE_LIMIT, opaque, chunks)
    basis = harmonics(rays.directions, getattr(field.color, "degree", 0))
    shown = room(samples.weights.shape)
    significant(samples.weights, samples.starts, samples.ends, np.float32(share), chunks, shown)
    colors = field.color.colors(samples.x, basis, samples.starts, samples.ends, shown, 0.0, chunks)
    unmapped = np.empty((len(rays.origins), 5), np.float32)
    composite(samples.weights, samples.optical, colors, samples.t, samples.starts, samples.ends, chunks, unmapped)
    out = unmapped
    if field.color_map is not None:
        mapped = field.color_map.premultiplied(torch.from_numpy(out[:, :3]), torch.from_numpy(out[:, 3]))
        out = np.concatenate([np.clip(mapped.numpy(), 0, out[:, 3:4]), out[:, 3:]], 1)
    return Rendered(out, unmapped, rays, samples, basis, colors)


def seen(rendered: Rendered, chunks: int) -> np.ndarray:
    """[rays, 5]: premultiplied rgb, alpha, and surface distance (compositing.py)."""
    s, out = rendered.samples, rendered.out.copy()
    surface_distance(s.weights, s.t, s.starts, s.ends, chunks, out)
    return out


def backward(
    field: RadianceField,
    rendered: Rendered,
    gradients: np.ndarray,
    density_to,
    color_to,
    displacement_to=None,
    *,
    even_from: float = 0.0,
    density_within: np.ndarray | None = None,
) -> None:
    """From dL/d(out) [rays, 5] to gradient buffers [chunks, parameters] of the parts; None leaves a part out.

    displacement_to: for the displacement grid, [chunks, 3 m^3]. even_from: distance, scene units, below which samples
    learn by the square of their distance (0: all alike). density_within: cells [s, s, s] of the cube outside of which
    no density learns.

    A field's color_map is for its pictures: the gradient is that of the colors before it.
    """
    s = rendered.samples
    sigma_gradients = room(s.sigma.shape)
    color_gradients = room(rendered.colors.shape)
    chunks = len(next(to for to in (color_to, density_to, displacement_to) if to is not None))
    composite_backward(
        s.sigma,
        s.weights,
        s.optical,
        rendered.colors,
        s.t,
        s.starts,
        s.ends,
        rendered.unmapped,
        gradients,
        chunks,
        sigma_gradients,
        color_gradients,
    )
    if even_from > 0:
        scale_near(s.t, s.starts, s.ends, np.float32(even_from), chunks, sigma_gradients, color_gradients)
    if color_to is not None:
        field.color.backward(s.x, rendered.basis, s.starts, s.ends, rendered.colors, color_gradients, color_to)
    if density_to is not None:
        if density_within is not None:
            flat, cells = density_within.reshape(-1), density_within.shape[0]
            keep_inside(flat, cells, s.x, s.starts, s.ends, chunks, sigma_gradients)
        field.density.backward(s.x, s.starts, s.ends, s.sigma, sigma_gradients, density_to)
    if displacement_to is not None:
        at_positions = position_gradients(
            field.density, field.color, s, rendered.basis, sigma_gradients, rendered.colors, color_gradients, chunks
        )
        cells = field.displacement.shape[0]
        displacement_gradient(field.space, rendered.rays, s, at_positions, cells, displacement_to)
