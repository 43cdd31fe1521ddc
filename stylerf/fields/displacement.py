"""Gradients of a field's displacement grid, from those of its densities and colours."""

import numpy as np

from stylerf.fields.samples import Rays, Samples
from stylerf.geometry.space import Space
from stylerf.kernels.cpu.deform import displacement_backward


def position_gradients(density, colour, samples: Samples, sigma_gradients, colours, colour_gradients, chunks: int):
    """dL/dx' [n, 3] of displaced positions; density or colour may be None, to take its part as fixed in space.

    Only what lies in samples.starts:ends is set.
    """
    out = np.zeros(samples.x.shape, np.float32)  # zeros_like would touch the room between chunks
    if density is not None:
        density.add_position_gradients(samples, sigma_gradients, out, chunks)
    if colour is not None:
        colour.add_position_gradients(samples, colours, colour_gradients, out, chunks)
    return out


def displacement_gradient(
    space: Space, rays: Rays, samples: Samples, gradients: np.ndarray, cells: int, to: np.ndarray
) -> None:
    """Add dL/dD to the chunks' buffers `to` [chunks, 3 cells^3], from dL/dx' [n, 3]; D is [cells, cells, cells, 3]."""
    displacement_backward(
        space.code,
        space.packed(),
        rays.origins,
        rays.directions,
        samples.t,
        samples.optical,
        samples.x,
        samples.starts,
        samples.ends,
        gradients,
        cells,
        len(to),
        to,
    )
