"""Blended colors on a GPU: layers as in fields/blended_color.py, composited as in rendering/rays.py."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from stylerf.fields.blended_color import BlendedColor, Layer
from stylerf.fields.gpu.parts import COLOR_KINDS, GpuColor
from stylerf.kernels.gpu import launch
from stylerf.kernels.gpu.ray_samples import GpuSamples


@dataclass(frozen=True)
class _Layer:
    color: "GpuColor | GpuBlendedColor"
    color_map: tuple[Tensor, Tensor] | None
    weight_threshold: float
    weight: float
    within: Tensor | None  # [s, s, s] bool


class GpuBlendedColor:
    """GPU counterpart of BlendedColor (fields/blended_color.py). half: read tables in half precision."""

    def __init__(self, part: BlendedColor, device: torch.device, half: bool = False) -> None:
        self.layers = [_on_device(layer, device, half) for layer in part.layers]
        self.values = torch.empty(0, device=device)

    def shares(self, samples: GpuSamples, of: Tensor) -> Iterator[tuple[_Layer, Tensor]]:
        """Yield each layer that is not a blend, with its share [capacity] of every sample; shares add up to `of`."""
        for number, layer in enumerate(self.layers):
            own = of * layer.weight
            if layer.within is not None:
                own = torch.where(_inside(layer.within, samples), own, 0.0)
            for over in self.layers[number + 1 :]:
                if over.within is not None:
                    own = torch.where(_inside(over.within, samples), own * (1 - over.weight), own)
            if isinstance(layer.color, GpuBlendedColor):
                yield from layer.color.shares(samples, own)
            else:
                yield layer, own

    def composited(self, samples: GpuSamples, directions: Tensor) -> Tensor:
        """Return [rays, 5]; see composite_layers() in rendering/rays.py."""
        out = torch.zeros((len(samples.starts), 5), device=samples.x.device)
        for layer, share in self.shares(samples, torch.ones_like(samples.weights)):
            assert isinstance(layer.color, GpuColor)
            colors = layer.color.visible_colors(samples, directions, layer.weight_threshold)
            colored = colors[:, :1] >= 0
            own = launch.composite(samples, torch.where(colored, colors * share[:, None], -1.0))
            out[:, 3:] = own[:, 3:]  # the same for every layer
            if layer.color_map is None:
                out[:, :3] += own[:, :3]
                continue
            # The layer's share of alpha is composited as a gray.
            alpha = launch.composite(samples, torch.where(colored, share[:, None].expand(-1, 3), -1.0))[:, :1]
            matrix, offset = layer.color_map
            out[:, :3] += torch.minimum((own[:, :3] @ matrix.T + alpha * offset).clamp(min=0), alpha)
        return out


def _on_device(layer: Layer, device: torch.device, half: bool) -> _Layer:
    color: GpuColor | GpuBlendedColor
    if isinstance(layer.color, BlendedColor):
        color = GpuBlendedColor(layer.color, device, half)
    else:
        color = COLOR_KINDS[layer.color.kind](layer.color, device, half)
    color_map = None
    if layer.color_map is not None:
        matrix, offset = layer.color_map.matrix, layer.color_map.offset
        color_map = matrix.to(device, torch.float32), offset.to(device, torch.float32)
    within = None if layer.within is None else torch.from_numpy(layer.within).to(device)
    return _Layer(color, color_map, layer.weight_threshold, layer.weight, within)


def _inside(within: Tensor, samples: GpuSamples) -> Tensor:
    """Return [capacity] bool: whether samples are in marked cells; undefined after the last sample."""
    cells = len(within)
    # nan_to_num: entries after the last sample are undefined and may be NaN.
    place = (samples.x.nan_to_num() * cells).clamp(0, cells - 1).long()
    return within[place[:, 0], place[:, 1], place[:, 2]]
