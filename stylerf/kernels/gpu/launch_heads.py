"""How colors that are an encoder and a head are launched."""

import torch
from torch import Tensor

from stylerf.kernels.gpu import color_heads, mlp_head
from stylerf.kernels.gpu.launch import SAMPLES, STAGES, GpuSamples, outputs_of, persistent_grid, width_of

# With four, the network's backward on hash features keeps 4.6 KB a thread in local memory, with eight 0.2 KB (compiled
# for capability 9.0).
WARPS = 8
KERNELS = {
    "linear": (color_heads.linear_kernel, color_heads.linear_backward_kernel),
    "harmonic": (color_heads.harmonic_kernel, color_heads.harmonic_backward_kernel),
    "mlp": (mlp_head.mlp_kernel, mlp_head.mlp_backward_kernel),
}


def _constants(color) -> dict:
    return {
        "ENCODER": color.code, "PIECES": color.pieces, "RANK": color.rank, "WIDTH": width_of(color.rank),
        "BANDS": color.bands, "UNITS": color.hidden or outputs_of(color.bands), "BLOCK": SAMPLES,
        "num_warps": WARPS, "num_stages": STAGES,
    }  # fmt: skip


def headed_colors(color, samples: GpuSamples, directions: Tensor, weight_threshold: float) -> Tensor:
    """Return [room, 3] colors; -1 in channel 0 below weight_threshold times the ray's largest weight.

    color: has table, layout, numbers, size, code, pieces, rank, bands, head (its kind) and hidden (0: no such layer).
    """
    out = torch.empty((samples.room, 3), device=directions.device)
    layout = samples.counts if color.layout is None else color.layout
    KERNELS[color.head][0][persistent_grid(out.device, samples.room, SAMPLES)](
        color.table, layout, color.numbers, samples.x, directions, samples.ray_of, samples.weights, samples.largest,
        float(weight_threshold), samples.total, out, *color.size, **_constants(color),
    )  # fmt: skip
    return out


def headed_colors_backward(color, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
    """Add dL/d(values) to `to` [len(values)]: the features' table, the head's numbers."""
    layout = samples.counts if color.layout is None else color.layout
    KERNELS[color.head][1][persistent_grid(to.device, samples.room, SAMPLES)](
        color.table, layout, color.numbers, samples.x, directions, samples.ray_of, colors, color_gradients,
        samples.total, to, to[len(color.table) :], *color.size, **_constants(color),
    )  # fmt: skip
