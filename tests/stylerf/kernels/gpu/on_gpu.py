"""Fields, rays and samples between the host and a device, as the tests of the GPU kernels want them."""

from types import SimpleNamespace

import numpy as np
import torch

from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.ray_samples import Samples
from tests.stylerf.small import Packed, float64, oracle_pixels


def device_rays(rays, device):
    from stylerf.kernels.gpu.ray_samples import GpuRays

    return GpuRays(*(torch.from_numpy(a).to(device) for a in (rays.origins, rays.directions, rays.jitter)))


def on_host(samples) -> Samples:
    """Device samples as the CPU kernels would hand them out."""
    parts = (samples.starts, samples.ends, samples.t, samples.deltas, samples.x, samples.sigma, samples.weights)
    return Samples(*(part.cpu().numpy() for part in parts))


def packed_on_device(rendered, rays, device):
    """What the CPU rendered as a GpuField would have: samples packed, the room filled."""
    from stylerf.fields.gpu.field import GpuRendered
    from stylerf.kernels.gpu.ray_samples import GpuSamples

    packed = Packed.of(rendered.samples)
    counts = torch.bincount(packed.rays, minlength=len(rays.origins))
    largest = torch.zeros(len(counts), dtype=torch.float64).scatter_reduce(0, packed.rays, packed.weights, "amax")
    ends, ray_of = counts.cumsum(0), packed.rays.int()
    own = [v.float() for v in (packed.t, packed.deltas, packed.x, packed.sigma, packed.weights)]
    made = (ends - counts, ends, counts.int(), largest.float(), ends[-1:], *own, ray_of)
    samples = GpuSamples(*(tensor.contiguous().to(device) for tensor in made))
    out, unmapped, colors = (torch.from_numpy(a) for a in (rendered.out, rendered.unmapped, rendered.colors))
    pixels = out.to(device), unmapped.to(device)
    return GpuRendered(*pixels, device_rays(rays, device), samples, colors[packed.at].to(device))


def by_oracle(field, rays, rendered, grid=None, near_scaling_distance: float = 0.0, gradients=None):
    """(pixels [rays, 5], gradients of the parts' values) in float64, at the samples that the device chose."""
    degree = getattr(field.color, "degree", 0)
    seen = SimpleNamespace(
        samples=on_host(rendered.samples),
        colors=rendered.colors.cpu().numpy(),
        basis=harmonics(rays.directions, degree),
    )
    values = [float64(part.values).requires_grad_() for part in (field.density, field.color)]
    pixels, _ = oracle_pixels(field, rays, seen, *values, grid)
    if gradients is None:
        return pixels.detach(), None
    (pixels * torch.from_numpy(gradients.astype(np.float64))).sum().backward()
    return pixels.detach(), [v.grad for v in values]


def gradients_of(made, rendered, gradients, near_scaling_distance: float = 0.0) -> list[torch.Tensor]:
    """What the device adds to flat buffers of the density and the color."""
    to = [torch.zeros_like(part.values) for part in (made.density, made.color)]
    made.backward(
        rendered, torch.from_numpy(gradients).to(made.device), *to, near_scaling_distance=near_scaling_distance
    )
    return [t.cpu() for t in to]


def packed_samples(points: np.ndarray, rays: np.ndarray, weights: np.ndarray, device, spare: int = 5):
    """GpuSamples at cube points [n, 3] of rays [n], ascending; `spare` more find room and are poisoned."""
    from stylerf.kernels.gpu.ray_samples import GpuSamples

    count, n = int(rays.max(initial=-1)) + 1, len(points)
    counts = np.bincount(rays, minlength=count)
    ends = np.cumsum(counts)
    largest = np.zeros(count, np.float32)
    np.maximum.at(largest, rays, weights)
    capacity = {"t": (), "deltas": (), "x": (3,), "sigma": (), "weights": ()}
    arrays = {name: torch.full((n + spare, *shape), float("nan"), device=device) for name, shape in capacity.items()}
    ray_of = torch.full((n + spare,), 1 << 20, dtype=torch.int32, device=device)
    for to, what in ((arrays["x"], points), (arrays["weights"], weights), (ray_of, rays)):
        to[:n] = torch.from_numpy(what).to(device)
    given = (ends - counts, ends, counts.astype(np.int32), largest, np.array([n]))
    return GpuSamples(*(torch.from_numpy(a).to(device) for a in given), **arrays, ray_of=ray_of)
