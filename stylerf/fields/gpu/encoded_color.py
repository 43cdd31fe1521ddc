"""Colors as an encoder followed by a head (fields/encoded_color.py), on a GPU."""

from types import SimpleNamespace

import torch
from torch import Tensor

from stylerf.fields.color_heads import HIDDEN
from stylerf.fields.gpu.grids import GpuHashLevels, GpuVoxelGrid
from stylerf.geometry.spherical_harmonics import BANDS
from stylerf.kernels.gpu import launch, launch_heads
from stylerf.kernels.gpu.density import VM
from stylerf.kernels.gpu.launch import GpuSamples


class GpuPlanes:
    """VmFeatures of fields/encoders.py, as the kernels read them."""

    code, pieces, layout = VM.value, 3, None

    def __init__(self, features, device: torch.device) -> None:
        self.size, self.rank, self.length = [int(s) for s in features.size], features.rank, features.length

    def smooth(self, values: Tensor, strength: float, to: Tensor) -> None:
        """As VmFeatures.smooth; to [length or more]."""
        planes = SimpleNamespace(values=values, size=self.size, rank=self.rank)
        launch.smoothness(planes, strength / self.length, to)


ENCODERS = {
    "vm": GpuPlanes,
    "hash": lambda features, device: GpuHashLevels(features.levels, device),
    "voxel": lambda features, device: GpuVoxelGrid(features.grid, features.width, device),
}


class GpuEncodedColor:
    """EncodedColor of fields/encoded_color.py on a GPU. half: the table is read in half precision and cannot learn."""

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        self.values = torch.from_numpy(part.values).to(device, copy=True)
        self.groups = [group for group in part.groups() if group[0] < group[1]]
        encoder = ENCODERS[part.features.kind](part.features, device)
        self.encoder, self.code, self.pieces = encoder, encoder.code, encoder.pieces
        self.size, self.rank, self.layout = encoder.size, encoder.rank, encoder.layout
        self.head, self.bands = part.head.kind, BANDS[part.degree]
        self.hidden = HIDDEN if self.head == "mlp" else 0
        table = self.values[: part.features.length]
        self.table = table.half() if half else table
        # The harmonic head has no values, but the kernel needs a pointer.
        self.numbers = self.values[part.features.length :] if part.head.length else self.values

    def visible_colors(self, samples: GpuSamples, directions: Tensor, weight_threshold: float) -> Tensor:
        """See GpuVmColor.visible_colors."""
        return launch_heads.headed_colors(self, samples, directions, weight_threshold)

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        launch_heads.headed_colors_backward(self, samples, directions, colors, color_gradients, to)

    def smooth(self, strength: float, to: Tensor) -> None:
        """As EncodedColor.smooth."""
        self.encoder.smooth(self.values, strength, to)
