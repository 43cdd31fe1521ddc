"""Render a radiance field with the mathematics alone, without files or stages.

    python examples/render_field.py ball.png

The field is a Gaussian ball in the cube [-1, 1]^3: a voxel grid holds the logarithm of its density, a hash grid of one
level its color. Any other density and color parts combine in the same way (stylerf/fields/protocol.py).
"""

import sys

import numpy as np
from PIL import Image

from stylerf.fields.hash_grid import HashColor
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.protocol import Capacity
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.voxel import Grid, VoxelDensity
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.rendering.view import RenderedView, render_view


def gaussian_ball(radius: float = 0.3, peak: float = 0.1) -> RadianceField:
    """Return a ball of raw density peak * exp(-r^2 / (2 radius^2)), colored by position."""
    grid = Grid.of(Capacity(size=np.full(3, 64), resolution=64))
    squares = np.square(2 * grid.vertices() - 1).sum(1)  # vertices are in the unit cube, r in world units
    exponents = np.append(-squares / (2 * radius**2), np.log(peak)).astype(np.float32)
    logits = np.zeros((33, 33, 33, 4), np.float32)
    logits[..., :3] = np.stack(np.meshgrid(*[np.linspace(-4, 4, 33)] * 3, indexing="ij"), -1)
    return RadianceField(
        space=SpaceWarp.box([-1, -1, -1], [1, 1, 1]),
        density=VoxelDensity(grid, exponents),
        color=HashColor(levels=1, base=32, finest=32, table=1 << 16, values=logits.ravel()),
        occupancy=OccupancyGrid(32),  # nothing is known to be empty: every cell is sampled
        step=1 / 128,
    )


def render(width: int = 200, height: int = 150) -> RenderedView:
    """Return a view of the ball from (0, 0, -3) along +z: rgb [h, w, 3] premultiplied sRGB, alpha, distances."""
    pose = np.eye(4)
    pose[2, 3] = -3.0
    camera = Camera("front", width, height, 1.5 * width, 1.5 * width, width / 2, height / 2, pose)
    return render_view(gaussian_ball(), camera, threads=2)


if __name__ == "__main__":
    view = render()
    on_white = view.rgb + (1 - view.alpha[..., None])
    Image.fromarray((255 * on_white.clip(0, 1) + 0.5).astype(np.uint8)).save(sys.argv[1])
