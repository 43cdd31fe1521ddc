"""A radiance field on a GPU: its parts, ray marching, and its occupancy grid, updated without synchronizing."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.fields.blended_color import BlendedColor
from stylerf.fields.gpu.blended_color import GpuBlendedColor
from stylerf.fields.gpu.parts import COLOR_KINDS, DENSITY_KINDS, GpuPart
from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.fields.occupancy_grid import DENSEST, MARK, OPAQUE_STEP, UNSEEN
from stylerf.fields.protocol import Part
from stylerf.fields.radiance_field import RadianceField, layers_of
from stylerf.kernels.cpu.march import OPTICAL_SCALE
from stylerf.kernels.gpu import launch
from stylerf.kernels.gpu.ray_samples import GpuMarchInputs, GpuRays, GpuSamples

FARTHEST = 32  # cells; larger occupancy distances are clamped to this: rays may skip less, but never too far


def unsupported(field: RadianceField, moving: bool = False) -> str | None:
    """Return why a field cannot be used on a GPU, or None. moving: whether it will learn a deformation."""
    parts: list[tuple[Part, Mapping[str, type[GpuPart]]]] = [(field.density, DENSITY_KINDS)]
    parts += [(color, COLOR_KINDS) for color in layers_of(field.color)]
    for part, kinds in parts:
        known = [name for name, kind in kinds.items() if kind.moves or not moving]
        if part.kind not in known:
            what = "kernel that moves it" if moving and part.kind in kinds else "kernel"
            return f"a field part of kind {part.kind} has no GPU {what} (there are {', '.join(sorted(known))})"
    return None


@dataclass
class GpuRendered:
    """Rendered rays; see Rendered in rendering/rays.py."""

    out: Tensor
    unmapped: Tensor
    rays: GpuRays
    samples: GpuSamples
    colors: Tensor

    def with_surface_distance(self) -> Tensor:
        """Return [rays, 5]; see with_surface_distance() in rendering/rays.py."""
        return torch.cat([self.out[:, :4], launch.surface_distance(self.samples)[:, None]], 1)


class GpuField:
    """A copy of `field` on a GPU. half: read tables in half precision (rendering only)."""

    def __init__(self, field: RadianceField, device: torch.device | str, half: bool = False) -> None:
        if (why := unsupported(field)) is not None:
            raise InvalidValue(why)
        self.device = torch.device(device)
        self.space = field.space
        self.density = DENSITY_KINDS[field.density.kind](field.density, self.device, half)
        self.blend: GpuBlendedColor | None = None
        if isinstance(field.color, BlendedColor):  # renders, but does not learn
            self.blend = GpuBlendedColor(field.color, self.device, half)
        else:
            self.color = COLOR_KINDS[field.color.kind](field.color, self.device, half)
        self.cells, self.step = field.occupancy.cells, field.step
        self.weight_threshold, self.opaque_background = field.weight_threshold, field.opaque_background
        self.distances = torch.from_numpy(field.occupancy.distances).to(self.device, copy=True)
        clear = field.occupancy.clear
        self.clear = None if clear is None else torch.from_numpy(clear).to(self.device, copy=True)
        self.highest = torch.from_numpy(field.occupancy.highest).to(self.device, copy=True)
        self.displacement: Tensor | None = None
        self.vertices = 0
        if field.displacement is not None:
            self.displacement = torch.from_numpy(field.displacement.reshape(-1).copy()).to(self.device)
            self.vertices = field.displacement.shape[0]
        self.color_map: tuple[Tensor, Tensor] | None = None
        if field.color_map is not None:
            matrix, offset = field.color_map.matrix, field.color_map.offset
            self.color_map = matrix.to(self.device, torch.float32), offset.to(self.device, torch.float32)
        self._space = torch.from_numpy(field.space.packed()).to(self.device)

    def march_inputs(self, samples_per_ray: int, min_transmittance: float, near: float | None = None) -> GpuMarchInputs:
        """Return the inputs of ray marching other than rays and density; near: see render_rays()."""
        return GpuMarchInputs(
            self.space.code, self._space, self.space.near if near is None else near, self.space.far, self.step,
            self.distances, self.cells, self.opaque_background, self.displacement, self.vertices, samples_per_ray,
            min_transmittance,
        )  # fmt: skip

    def march(
        self,
        rays: GpuRays,
        samples_per_ray: int,
        min_transmittance: float,
        capacity: int | None,
        near: float | None = None,
    ) -> GpuSamples:
        """March rays to samples with density and weights.

        capacity: maximum number of samples; None: no limit (synchronizes). near: see render_rays().
        """
        inputs = self.march_inputs(samples_per_ray, min_transmittance, near)
        return launch.march_density(inputs, self.density, rays, capacity)

    def render_rays(
        self,
        rays: GpuRays,
        *,
        capacity: int | None = None,
        min_transmittance: float = 1e-3,
        weight_threshold: float = 2e-2,
        samples_per_ray: int = SAMPLES_PER_RAY,
        near: float | None = None,
    ) -> GpuRendered:
        """Render rays; see render_rays() in rendering/rays.py.

        Args:
            capacity: see march().
            near: distance at which marching starts, scene units; None: the space's own.
        """
        samples = self.march(rays, samples_per_ray, min_transmittance, capacity, near)
        if self.blend is None:
            colors = self.color.visible_colors(samples, rays.directions, weight_threshold)
            unmapped = launch.composite(samples, colors)
        else:
            colors = torch.empty((0, 3), device=self.device)  # each layer has its own
            unmapped = self.blend.composited(samples, rays.directions)
        return GpuRendered(mapped(unmapped, self.color_map), unmapped, rays, samples, colors)

    def backward(
        self, rendered: GpuRendered, gradients: Tensor, density_to: Tensor | None, color_to: Tensor | None,
        displacement_to: Tensor | None = None,
        *, near_scaling_distance: float = 0.0, distortion: float = 0.0,
        density_within: tuple[Tensor, int] | None = None,
    ) -> None:  # fmt: skip
        """Add the parts' gradients to flat buffers, from dL/d(unmapped) [rays, 5]; see backward() in rendering/rays.py.

        displacement_to: [3 vertices^3]. density_within: (marked cells uint8 [s^3], s).
        """
        r = rendered
        of_sigma, of_colors = launch.composite_backward(
            r.samples, r.colors, r.unmapped, gradients, near_scaling_distance
        )
        if distortion > 0:
            launch.distortion_backward(r.samples, distortion, self.space.middle, of_sigma)
        if color_to is not None:
            self.color.backward(r.samples, r.rays.directions, r.colors, of_colors, color_to)
        if density_to is not None:
            if density_within is not None:
                launch.zero_outside(*density_within, r.samples, of_sigma)
            self.density.backward(r.samples, of_sigma, density_to)
        if displacement_to is not None:
            moved, s, rays = torch.zeros_like(r.samples.x), r.samples, r.rays
            self.density.add_position_gradients(s, of_sigma, moved)
            self.color.add_position_gradients(s, rays.directions, r.colors, of_colors, moved)
            launch.displacement_backward(self.space.code, self._space, rays, s, moved, self.vertices, displacement_to)

    def write_to(self, field: RadianceField) -> None:
        """Copy learned values back into `field` and recompute its occupancy with exact distances."""
        field.density.values[:] = self.density.values.cpu().numpy()
        field.color.values[:] = self.color.values.cpu().numpy()
        field.occupancy.highest[:] = self.highest.cpu().numpy()
        field.occupancy.set_occupied(self.distances.cpu().numpy() == 0)


def mapped(out: Tensor, color_map: tuple[Tensor, Tensor] | None) -> Tensor:
    """Map the colors of composited rays [rays, 5] by (matrix, offset); see mapped() in rendering/rays.py."""
    if color_map is None:
        return out
    matrix, offset = color_map
    # Premultiplied: the offset is scaled by alpha, and no channel exceeds alpha (decision 0006).
    rgb = out[:, :3] @ matrix.T + out[:, 3:4] * offset
    return torch.cat([torch.minimum(rgb.clamp(min=0), out[:, 3:4]), out[:, 3:]], 1)


# -- occupancy ---------------------------------------------------------------------------------------------------------


def refresh(field: GpuField, seed: int, stride: int, decay: float) -> None:
    """Evaluate a field's density in every stride-th cell, then update which cells are occupied."""
    device, cells = field.device, field.cells
    generator = torch.Generator(device).manual_seed(seed)
    start = int(np.random.default_rng(seed).integers(stride))  # `seed % stride` might never vary
    index = torch.arange(start, cells**3, stride, device=device)
    corner = torch.stack([index // cells**2, index // cells % cells, index % cells], 1)
    points = (corner + torch.rand(corner.shape, generator=generator, device=device)) / cells
    seen = field.density.sigma(points.contiguous()).clamp(max=DENSEST)
    old = field.highest[index]
    # UNSEEN is infinite and would survive any decay.
    field.highest[index] = torch.maximum(torch.where(old == UNSEEN, 0.0, old * decay), seen)
    if field.clear is not None:
        field.highest.masked_fill_(field.clear, 0.0)
    decide(field)


def decide(field: GpuField) -> None:
    """Recompute a field's occupancy distances from the densities seen in its cells."""
    cells = field.cells
    threshold = -math.log1p(-OPAQUE_STEP) / (float(OPTICAL_SCALE) * field.step)
    occupied = field.highest > field.highest.clamp(max=MARK).mean().clamp(max=threshold)
    if field.clear is not None:
        occupied &= ~field.clear
    field.distances = distances_to(occupied.view(cells, cells, cells)).flatten()


def distances_to(occupied: Tensor, farthest: int = FARTHEST) -> Tensor:
    """Return the Chebyshev distance of each cell of [m, m, m] bool to the nearest True, at most `farthest`; uint8.

    Separable, a dozen launches in all: along each axis, a cell's distance is the minimum, over the cells of its line,
    of the larger of the offset to that cell and that cell's distance so far.
    """
    farthest = min(farthest, len(occupied))
    distance = torch.full_like(occupied, farthest, dtype=torch.uint8).masked_fill_(occupied, 0)
    ways = torch.arange(1 - farthest, farthest, device=occupied.device).abs().to(torch.uint8)
    for axis in range(3):
        # F.pad expects the last axis first.
        margins = [farthest - 1 if a == axis else 0 for a in (2, 1, 0) for _ in range(2)]
        # [m, m, m, 2 farthest - 1], a view; the maximum below materializes it, one byte per element.
        lines = F.pad(distance, margins, value=farthest).unfold(axis, len(ways), 1)
        distance = torch.maximum(lines, ways).amin(-1)
    return distance
