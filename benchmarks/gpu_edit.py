"""Additional kernels of a local edit, for the `kernels` part of benchmarks/gpu.py; imported only if Triton exists."""

import numpy as np
import torch

from stylerf.fields.gpu.parts import GpuRegionColor
from stylerf.fields.hash_grid import HashColor
from stylerf.fields.region_color import RegionColor
from stylerf.kernels.gpu import launch


def launches(rendered, of_colors: torch.Tensor, wanted: torch.Tensor) -> dict:
    """Return {kernel: (its launch, minimum bytes moved)} for rendered random rays; half of the cells are edited."""
    generator, cells = np.random.default_rng(2), 128
    base = HashColor.create(generator)
    part = GpuRegionColor(
        RegionColor.create(base, generator.random((cells,) * 3) < 0.5, 256.0, table=1 << 15), wanted.device
    )
    s, n, rays, ways = rendered.samples, rendered.samples.capacity, len(rendered.out), rendered.rays.directions
    colors, marked, table = part.visible_colors(s, ways, 0.0), part.marked, 4 * len(part.values)
    to, depth, sums = torch.zeros_like(part.values), torch.ones(rays // 2, device=wanted.device), wanted.new_zeros(5)
    of_sigma = torch.randn_like(s.sigma)
    rows = launch.rows(part.table, part.layout, part.levels, s.x)
    return {
        "patch color": (lambda: part.add_logits(s, colors), n * 36 + cells**3 + table),
        "patch color backward": (
            lambda: part.backward(s, ways, colors, of_colors, to), n * 36 + cells**3 + 3 * table,
        ),
        "keep inside": (lambda: launch.zero_outside(marked, cells, s, of_sigma), n * 16 + cells**3),
        "ends of rays": (lambda: launch.ends_inside(marked, cells, s), n * 20 + rays * 40 + cells**3),
        "tuning loss": (
            lambda: launch.tuning_loss(rendered.out, wanted, depth, s, 1.0, 1.0, 1.0, sums), rays * 78,
        ),
        "hash rows": (
            lambda: launch.rows(part.table, part.layout, part.levels, s.x), n * (12 + 16 * part.levels) + table,
        ),
        "hash rows backward": (
            lambda: launch.rows_backward(part.layout, part.levels, s.x, rows, to),
            n * (12 + 16 * part.levels) + 3 * table,
        ),
    }  # fmt: skip
