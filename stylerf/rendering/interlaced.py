"""Progressive rendering: rays on a coarse grid first, then those in between, each pixel once."""

from collections.abc import Callable, Iterator

import numpy as np

from stylerf.fields.marching import ScratchArena
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import alpha_inside, render_rays, with_surface_distance


def render_pixels(
    field: RadianceField,
    camera: Camera,
    pixels: np.ndarray,
    *,
    threads: int,
    min_transmittance: float = 1e-3,
    marked: np.ndarray | None = None,
    arena: ScratchArena | None = None,
    distances: bool = True,
) -> np.ndarray:
    """Render some pixels of a view, bit-identical to render_view().

    Args:
        pixels: [n] row-major indices.
        min_transmittance: transmittance below which a ray terminates.
        marked: cells [s, s, s] bool of a region; None: no region.
        arena: allocates the samples; reset here.
        distances: whether to compute surface distances; 0 if not.

    Returns:
        [n, 6] float32: premultiplied rgb (sRGB-encoded), alpha, surface distance (scene units), the part of alpha
        contributed by marked cells.
    """
    rendered = render_rays(
        field,
        Rays.of(*camera.rays(pixels), field.space.view_start(camera.center)),
        threads=threads,
        min_transmittance=min_transmittance,
        weight_threshold=field.weight_threshold,
        arena=arena.reset() if arena else None,
    )
    out = np.zeros((len(pixels), 6), np.float32)
    if distances:
        out[:, :5] = with_surface_distance(rendered, threads)
    else:
        out[:, :4] = rendered.out[:, :4]
    if marked is not None:
        out[:, 5] = alpha_inside(marked, rendered.samples, threads)
    return out


def interlaced(width: int, height: int, coarsest: int) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (stride, row-major pixels) for each pass; together the passes cover each pixel once.

    Args:
        coarsest: stride of the first pass, a power of two. Each pass halves the stride and covers the pixels of its
            grid that no earlier pass covered.
    """
    rows, columns = np.divmod(np.arange(width * height), width)
    stride = coarsest
    while stride >= 1:
        on = (rows % stride == 0) & (columns % stride == 0)
        if stride < coarsest:
            on &= (rows % (2 * stride) != 0) | (columns % (2 * stride) != 0)
        yield stride, np.flatnonzero(on)
        stride //= 2


def spread_out(grid: np.ndarray, stride: int) -> np.ndarray:
    """Fill an image [h, w, ...] from its pixels on a grid of the given stride; each copies the next one up and left."""
    if stride == 1:
        return grid
    height, width = grid.shape[:2]
    return grid[::stride, ::stride].repeat(stride, 0)[:height].repeat(stride, 1)[:, :width]


def coarsest_within(count: int, most: float, strides: tuple[int, ...] = (1, 2, 4, 8)) -> int:
    """Return the smallest stride that leaves at most `most` of `count` pixels, or the last one if none does."""
    return next((stride for stride in strides if count / stride**2 <= most), strides[-1])


def in_batches(pixels: np.ndarray, size: int, stopped: Callable[[], bool]) -> Iterator[np.ndarray]:
    """Yield batches of at most `size` pixels until stopped() returns true."""
    for at in range(0, len(pixels), size):
        if stopped():
            return
        yield pixels[at : at + size]
