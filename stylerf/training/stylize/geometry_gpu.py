"""Rendering a scene during stylization on a GPU; like geometry.py, with all arrays on the device."""

import numpy as np
import torch
from torch import Tensor

from stylerf.fields.gpu.field import GpuField, GpuRendered, mapped
from stylerf.fields.gpu.memory import free_on, in_parts
from stylerf.fields.gpu.parts import COLOR_KINDS, GpuColor
from stylerf.fields.hash_grid import HashColor
from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.fields.packed_surface import PackedSurface
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.gpu import launch
from stylerf.kernels.gpu.ray_samples import GpuSamples
from stylerf.rendering.view_gpu import rays_of
from stylerf.training.common.adam_gpu import GpuAdam
from stylerf.training.common.async_readback import sent
from stylerf.training.deform.deformer_gpu import GpuDeformer
from stylerf.training.stylize.geometry import OPAQUE, RayGeometry

RAYS_AT_ONCE = 1 << 17
MEMORY_BYTES = 8e9  # for cached surfaces, if the device is not a GPU


class GpuFixedGeometry:
    """Surfaces on `device`: numpy in and out, everything in between on the device.

    new_adam() copies field.color for training; collect() copies it back. Surfaces are cached in up to half of the
    device's free memory; `threads` and `memory` are for the CPU and unused.
    """

    def __init__(
        self,
        field: RadianceField,
        cameras: list[Camera],
        weight_threshold: float,
        threads: int,
        memory: float,
        *,
        device: str | torch.device,
    ) -> None:
        self.field, self.cameras, self.weight_threshold = field, cameras, weight_threshold
        self.device = torch.device(device)
        self._marched = GpuField(field, self.device)
        self.memory_bytes = free_on(self.device, 2 * MEMORY_BYTES) / 2
        self._kept: dict[int, tuple[Tensor, Tensor, Tensor]] = {}
        self._last: tuple[int, tuple[Tensor, Tensor, Tensor]] | None = None
        self._alphas: dict[int, np.ndarray] = {}
        self._color: GpuColor | None = None

    def new_adam(self, gradient_clip: float = 0.0) -> GpuAdam:
        self._color = COLOR_KINDS[self.field.color.kind](self.field.color, self.device)
        return GpuAdam.of(self.color, gradient_clip)

    @property
    def color(self) -> GpuColor:
        """The trained color on the device; valid after new_adam()."""
        assert self._color is not None
        return self._color

    def collect(self) -> None:
        if self._color is not None:
            self.field.color.values[:] = self._color.values.cpu().numpy()

    def _samples(self, view: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return a view's (offsets [pixels + 1], x [n, 3], weights [n]), weights scaled to keep each ray's alpha."""
        found = self._kept.get(view)
        if found is None and self._last is not None and self._last[0] == view:
            return self._last[1]
        if found is None:
            self._last = None
            found = self._march(self.cameras[view])
            self._last = view, found
            held = sum(sum(t.nbytes for t in kept) for kept in self._kept.values())
            if held + sum(t.nbytes for t in found) <= self.memory_bytes:
                self._kept[view] = found
        return found

    def _march(self, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
        def part(begin: int, end: int) -> tuple[Tensor, Tensor, Tensor]:
            rays = rays_of(camera, torch.arange(begin, end, device=self.device))
            s = self._marched.march(rays, SAMPLES_PER_RAY, 1e-3, None)
            ray, n = s.ray_of.long(), len(rays.origins)
            shown = (s.weights > 0) & (s.weights >= self.weight_threshold * s.largest[ray])
            sums = torch.zeros((2, n), device=self.device)  # weights of all samples, and of the kept ones
            sums[0].index_add_(0, ray, s.weights)
            sums[1].index_add_(0, ray[shown], s.weights[shown])
            scale = torch.where(sums[1] > 0, sums[0] / sums[1].clamp(min=1e-30), 0.0)
            counts = torch.zeros(n, dtype=torch.int64, device=self.device).index_add_(0, ray, shown.long())
            return counts, s.x[shown], s.weights[shown] * scale[ray[shown]]

        pixels = camera.width * camera.height
        counts, xs, weights = zip(*in_parts(pixels, RAYS_AT_ONCE, part))
        offsets = torch.zeros(pixels + 1, dtype=torch.int64, device=self.device)
        torch.cumsum(torch.cat(counts), 0, out=offsets[1:])
        return offsets, torch.cat(xs), torch.cat(weights)

    def surface(self, view: int) -> PackedSurface:
        offsets, x, weights = (t.cpu().numpy() for t in self._samples(view))
        return PackedSurface(offsets, (x * 65535 + 0.5).astype(np.uint16), weights, self.alpha(view))

    def alpha(self, view: int) -> np.ndarray:
        if view not in self._alphas:
            camera, (offsets, _, weights) = self.cameras[view], self._samples(view)
            # A ray's sum is a difference of cumulative sums over the view, which loses too many digits in float32.
            sums = torch.zeros(len(weights) + 1, dtype=torch.float64, device=self.device)
            torch.cumsum(weights.double(), 0, out=sums[1:])
            alpha = (sums[offsets[1:]] - sums[offsets[:-1]]).clamp(0, 1).float()
            self._alphas[view] = alpha.view(camera.height, camera.width).cpu().numpy()
        return self._alphas[view]

    def paint(self, view: int, pixels: np.ndarray) -> tuple[np.ndarray, tuple[GpuSamples, Tensor]]:
        offsets, x, weights = self._samples(view)
        chosen = torch.from_numpy(np.ascontiguousarray(pixels)).to(self.device)
        counts = offsets[chosen + 1] - offsets[chosen]
        ends = torch.cumsum(counts, 0)
        starts, n = ends - counts, int(ends[-1]) if len(pixels) else 0
        ray = torch.repeat_interleave(counts, output_size=n)
        # Gather the chosen rays' runs of samples: n is their total, `starts` their positions in the new order.
        place = torch.arange(n, device=self.device) + (offsets[chosen] - starts)[ray]
        # Placeholder for all fields that compositing does not read, such as distances; must not be written to.
        zero = torch.zeros(max(n, len(pixels)), device=self.device)
        own = weights[place].contiguous()
        samples = GpuSamples(
            starts, ends, counts.int(), zero[: len(pixels)], torch.full((1,), n, dtype=torch.int64, device=self.device),
            zero[:n], zero[:n], x[place].contiguous(), zero[:n], own, ray.int(),
        )  # fmt: skip
        plain = isinstance(self.field.color, HashColor)
        directions = None if plain else rays_of(self.cameras[view], chosen).directions
        colors = self.color.visible_colors(samples, directions, 0.0)
        out = mapped(launch.composite(samples, colors), self._marched.color_map)
        return out[:, :3].cpu().numpy(), (samples, colors)

    def learn(self, record: tuple[GpuSamples, Tensor], gradients: np.ndarray, color_to: Tensor) -> None:
        samples, colors = record
        towards = torch.from_numpy(np.ascontiguousarray(gradients, np.float32)).to(self.device)
        if self._marched.color_map is not None:
            towards = (towards @ self._marched.color_map[0]).contiguous()
        to_colors = launch.shade_backward(samples, towards)
        self.color.backward(samples, None, colors, to_colors, color_to)


class GpuMovingGeometry(RayGeometry[GpuRendered, Tensor]):
    """Rays on the device of `deformer`; pixels and their gradients are numpy. Trains the colors of `fixed`."""

    deformer: GpuDeformer
    fixed: GpuFixedGeometry
    rays_at_once = RAYS_AT_ONCE

    def _rendered(self, camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, GpuRendered]:
        field = self.deformer.device_field
        field.color = self.fixed.color  # every phase has its own copy
        rays = rays_of(camera, sent(pixels, field.device))
        rendered = field.render_rays(rays, min_transmittance=OPAQUE, weight_threshold=self.weight_threshold)
        return rendered.out.cpu().numpy(), rendered

    def _backward(self, rendered: GpuRendered, gradients: np.ndarray, color_to: Tensor) -> None:
        field = self.deformer.device_field
        field.backward(rendered, sent(gradients, field.device), None, color_to, self.deformer.gradients)
