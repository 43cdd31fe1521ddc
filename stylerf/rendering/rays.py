"""Rays through a field to pixels, and gradients back: march, density, colour, composite."""

from dataclasses import dataclass

import numpy as np

from stylerf.fields.field import RadianceField
from stylerf.geometry.harmonics import harmonics
from stylerf.kernels.cpu.composite import composite, composite_backward
from stylerf.kernels.cpu.march import count_samples, fill_samples

SAMPLE_LIMIT = 1024


@dataclass
class Samples:
    """Packed samples of a batch of rays. offsets [rays + 1]; t, optical [n]; x [n, 3] warped positions."""

    offsets: np.ndarray
    t: np.ndarray
    optical: np.ndarray
    x: np.ndarray


@dataclass
class Rendered:
    """What rays came back with. out [rays, 5]: premultiplied rgb, alpha, sum of w t; the rest serves the backward."""

    out: np.ndarray
    samples: Samples
    basis: np.ndarray
    ends: np.ndarray
    sigma: np.ndarray
    weights: np.ndarray
    colours: np.ndarray


def march(field: RadianceField, origins, directions, jitter, near, chunks: int) -> Samples:
    """Samples in occupied cells. origins, directions [rays, 3] float32 scene units; jitter [rays] in 0..1."""
    space, packed = field.space, field.space.packed()
    counts = np.empty(len(origins), np.int64)
    common = (
        space.code, packed, origins, directions, jitter, near, np.float32(space.far), np.float32(field.step),
        field.occupancy.distances, field.occupancy.cells, SAMPLE_LIMIT, chunks,
    )
    count_samples(*common, counts)
    offsets = np.zeros(len(origins) + 1, np.int64)
    np.cumsum(counts, out=offsets[1:])
    n = int(offsets[-1])
    t, optical, x = np.empty(n, np.float32), np.empty(n, np.float32), np.empty((n, 3), np.float32)
    fill_samples(*common, offsets, t, optical, x)
    return Samples(offsets, t, optical, x)


def render_rays(
    field: RadianceField, origins, directions, jitter=None, near=None, *, chunks: int, opaque=1e-3, least=1e-3
) -> Rendered:
    """Render rays. opaque: transmittance at which a ray ends; least: weight under which a sample gets no own colour."""
    n = len(origins)
    jitter = np.full(n, 0.5, np.float32) if jitter is None else jitter
    near = np.full(n, field.space.near, np.float32) if near is None else near
    samples = march(field, origins, directions, jitter, near, chunks)
    ends, sigma, weights = field.density.march(samples.x, samples.optical, samples.offsets, opaque, chunks)
    basis = harmonics(directions, getattr(field.colour, "degree", 0))
    colours = field.colour.colours(samples.x, basis, samples.offsets, ends, weights, least, chunks)
    out = np.empty((n, 5), np.float32)
    composite(weights, colours, samples.t, samples.offsets, ends, chunks, out)
    return Rendered(out, samples, basis, ends, sigma, weights, colours)


def backward(field: RadianceField, rendered: Rendered, gradients, density_to, colour_to) -> None:
    """From dL/d(out) [rays, 5] to gradient buffers [chunks, parameters] of the two parts; None leaves a part out."""
    samples = rendered.samples
    sigma_gradients = np.empty(len(samples.t), np.float32)
    colour_gradients = np.empty((len(samples.t), 3), np.float32)
    chunks = len(colour_to if colour_to is not None else density_to)
    composite_backward(
        rendered.sigma, rendered.weights, samples.optical, rendered.colours, samples.t, samples.offsets, rendered.ends,
        rendered.out, gradients, chunks, sigma_gradients, colour_gradients,
    )
    if colour_to is not None:
        field.colour.backward(
            samples.x, rendered.basis, samples.offsets, rendered.ends, rendered.colours, colour_gradients, colour_to
        )
    if density_to is not None:
        field.density.backward(
            samples.x, samples.offsets, rendered.ends, rendered.sigma, sigma_gradients, density_to
        )
