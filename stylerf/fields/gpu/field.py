"""A radiance field on a GPU: the parts' values as tensors, the Triton kernels behind them."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.fields.gpu.encoded_color import GpuEncodedColor
from stylerf.fields.gpu.grids import GpuHashDensity, GpuVoxelDensity
from stylerf.fields.radiance_field import RadianceField, layers_of
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.geometry.spherical_harmonics import BANDS
from stylerf.kernels.gpu import launch, launch_deform, launch_edit
from stylerf.kernels.gpu.density import VM
from stylerf.kernels.gpu.launch import GpuMarchInputs, GpuSamples


def _table(values: Tensor, length: int, half: bool) -> Tensor:
    """Return the table's own memory, or a read-only copy in half precision."""
    return values[:length].half() if half else values[:length]


class GpuVmDensity:
    """VmDensity of fields/vm.py on a GPU. half: the table is read in half precision and cannot learn."""

    code, layout = VM.value, None

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        self.values = torch.from_numpy(part.values).to(device, copy=True)
        self.size, self.rank, self.groups = [int(s) for s in part.size], part.rank, part.groups()
        self.width = launch.width_of(self.rank)
        self.table, self.shift = _table(self.values, len(self.values) - 1, half), self.values[-1:]

    def sigma(self, points: Tensor) -> Tensor:
        """Raw density [n] of cube points [n, 3]."""
        return launch.vm_density(self, points)

    def backward(self, samples: GpuSamples, sigma_gradients: Tensor, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        launch.vm_density_backward(self, samples, sigma_gradients, to)

    def add_position_gradients(self, samples: GpuSamples, sigma_gradients: Tensor, out: Tensor) -> None:
        """Add dL/dx to out [room, 3], x the samples' positions in the cube."""
        launch_deform.add_density_slopes(self, samples, sigma_gradients, out)

    def smooth(self, strength: float, to: Tensor) -> None:
        """See VmDensity.smooth."""
        launch.smoothness(self, strength / len(self.values), to)


class GpuVmColor:
    """VmColor of fields/vm.py on a GPU."""

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        self.values = torch.from_numpy(part.values).to(device, copy=True)
        self.size, self.rank, self.groups = [int(s) for s in part.size], part.rank, part.groups()
        self.bands = BANDS[part.degree]
        self.table = _table(self.values, len(part.table), half)
        self.head, self.bias = self.values[len(part.table) : -3], self.values[-3:]

    def visible_colors(self, samples: GpuSamples, directions: Tensor, weight_threshold: float) -> Tensor:
        """Color the samples of at least weight_threshold times their ray's largest weight.

        Returns:
            [room, 3] in 0..1; -1 in the first channel of all other samples.
        """
        return launch.vm_colors(self, samples, directions, weight_threshold)

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        launch.vm_colors_backward(self, samples, directions, colors, color_gradients, to)

    def add_position_gradients(self, samples: GpuSamples, directions, colors, color_gradients, out) -> None:
        """Add dL/dx to out [room, 3]."""
        launch_deform.add_vm_color_slopes(self, samples, directions, colors, color_gradients, out)

    def smooth(self, strength: float, to: Tensor) -> None:
        """See VmColor.smooth."""
        launch.smoothness(self, strength / len(self.table), to)


class GpuHashColor:
    """HashColor of fields/hash_color.py on a GPU."""

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        self.values = torch.from_numpy(part.values).to(device, copy=True)
        self.levels, self.groups = part.levels, part.groups()
        self.layout = torch.from_numpy(part.layout).to(device)
        self.table = _table(self.values, len(self.values), half)

    def visible_colors(self, samples: GpuSamples, directions: Tensor | None, weight_threshold: float) -> Tensor:
        """See GpuVmColor.visible_colors; directions are not used."""
        return launch.hash_colors(self, samples, weight_threshold)

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        launch.hash_colors_backward(self, samples, colors, color_gradients, to)

    def add_position_gradients(self, samples: GpuSamples, directions, colors, color_gradients, out) -> None:
        """Add dL/dx to out [room, 3]."""
        launch_deform.add_hash_color_slopes(self, samples, colors, color_gradients, out)

    def smooth(self, strength: float, to: Tensor) -> None:
        """See HashColor.smooth."""
        to.add_(self.values, alpha=strength / len(self.values))


class GpuRegionColor:
    """RegionColor of fields/region_color.py, over a base of any kind. values: the region's own."""

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        self.base = COLOR_KINDS[part.base.kind](part.base, device, half)
        self._own = GpuHashColor(part.own, device, half)
        self.values, self.table, self.groups = self._own.values, self._own.table, self._own.groups
        self.layout, self.levels = self._own.layout, self._own.levels
        self.marked, self.cells = marked_cells(part.marked, device), part.cells
        box = np.array([*part.low, 1 / part.side], np.float32)
        self.box = torch.from_numpy(box).to(device)

    def visible_colors(self, samples: GpuSamples, directions: Tensor, weight_threshold: float) -> Tensor:
        """See GpuVmColor.visible_colors."""
        out = self.base.visible_colors(samples, directions, weight_threshold)
        launch_edit.patch_colors(self, samples, out)
        return out

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        launch_edit.patch_colors_backward(self, samples, colors, color_gradients, to)

    def smooth(self, strength: float, to: Tensor) -> None:
        """See RegionColor.smooth."""
        self._own.smooth(strength, to)


DENSITY_KINDS = {"vm": GpuVmDensity, "hash": GpuHashDensity, "voxel": GpuVoxelDensity}
COLOR_KINDS = {
    "vm": GpuVmColor,
    "hash": GpuHashColor,
    "headed": GpuEncodedColor,
    "patch": GpuRegionColor,
}


def marked_cells(marked: np.ndarray, device: torch.device) -> Tensor:
    """Return cells [s, s, s] bool as the kernels read them: uint8 [s^3]."""
    return torch.from_numpy(np.ascontiguousarray(marked).reshape(-1).astype(np.uint8)).to(device)


def unsupported(field: RadianceField, moving: bool = False) -> str | None:
    """Return why a field cannot be used on a GPU, or None. moving: it is to learn a deformation."""
    colors = [(part, COLOR_KINDS) for part in layers_of(field.color)]
    for part, kinds in ((field.density, DENSITY_KINDS), *colors):
        known = [name for name, kind in kinds.items() if not moving or hasattr(kind, "add_position_gradients")]
        if part.kind not in known:
            what = "kernel that moves it" if moving and part.kind in kinds else "kernel"
            return f"a field part of kind {part.kind} has no GPU {what} (there are {', '.join(sorted(known))})"
    return None


@dataclass
class GpuRays:
    """origins, directions (unit) [n, 3]; jitter [n] in 0..1 of a step: float32 on the device."""

    origins: Tensor
    directions: Tensor
    jitter: Tensor

    @staticmethod
    def of(origins: np.ndarray, directions: np.ndarray, device: torch.device) -> "GpuRays":
        """Copy rays to a device, to be marched from the middle of their first step."""
        moved = [torch.from_numpy(np.ascontiguousarray(a, np.float32)).to(device) for a in (origins, directions)]
        return GpuRays(*moved, torch.full((len(origins),), 0.5, device=device))


@dataclass
class GpuRendered:
    """Rendered rays; see Rendered in rendering/rays.py."""

    out: Tensor
    unmapped: Tensor
    rays: GpuRays
    samples: GpuSamples
    colors: Tensor

    def with_surface_distance(self) -> Tensor:
        """Return [rays, 5] as with_surface_distance() in rendering/rays.py does."""
        return torch.cat([self.out[:, :4], launch.surface_distance(self.samples)[:, None]], 1)


class GpuField:
    """A copy of `field` on a GPU. half: tables are read in half precision (rendering only)."""

    def __init__(self, field: RadianceField, device: torch.device | str, half: bool = False) -> None:
        if (why := unsupported(field)) is not None:
            raise InvalidValue(why)
        self.device = torch.device(device)
        self.space: SpaceWarp = field.space
        self.density = DENSITY_KINDS[field.density.kind](field.density, self.device, half)
        self.color = COLOR_KINDS[field.color.kind](field.color, self.device, half)
        self.cells, self.step = field.occupancy.cells, field.step
        self.weight_threshold, self.opaque_background = field.weight_threshold, field.opaque_background
        self.distances = torch.from_numpy(field.occupancy.distances).to(self.device, copy=True)
        clear = field.occupancy.clear
        self.clear = None if clear is None else torch.from_numpy(clear).to(self.device, copy=True)
        self.highest = torch.from_numpy(field.occupancy.highest).to(self.device, copy=True)
        self.displacement, self.vertices = None, 0
        if field.displacement is not None:
            self.displacement = torch.from_numpy(field.displacement.reshape(-1).copy()).to(self.device)
            self.vertices = field.displacement.shape[0]
        self.color_map = None
        if field.color_map is not None:
            matrix, offset = field.color_map.matrix, field.color_map.offset
            self.color_map = matrix.to(self.device, torch.float32), offset.to(self.device, torch.float32)
        self._space = torch.from_numpy(field.space.packed()).to(self.device)

    def march_inputs(self, samples_per_ray: int, min_transmittance: float) -> GpuMarchInputs:
        """Return what a march through the field reads beside rays and density."""
        return GpuMarchInputs(
            self.space.code, self._space, self.space.near, self.space.far, self.step, self.distances, self.cells,
            self.opaque_background, self.displacement, self.vertices, samples_per_ray, min_transmittance,
        )  # fmt: skip

    def march(self, rays: GpuRays, samples_per_ray: int, min_transmittance: float, room: int | None) -> GpuSamples:
        """March rays to samples with density and weights; room: most samples, None: as many as there are (waits)."""
        inputs = self.march_inputs(samples_per_ray, min_transmittance)
        return launch.march_density(inputs, self.density, rays.origins, rays.directions, rays.jitter, room)

    def render_rays(
        self,
        rays: GpuRays,
        *,
        room: int | None = None,
        min_transmittance: float = 1e-3,
        weight_threshold: float = 2e-2,
        samples_per_ray: int = 512,
    ) -> GpuRendered:
        """Render rays as render_rays() in rendering/rays.py does; room: as march() takes it."""
        samples = self.march(rays, samples_per_ray, min_transmittance, room)
        colors = self.color.visible_colors(samples, rays.directions, weight_threshold)
        unmapped = launch.composite(samples, colors)
        out = unmapped
        if self.color_map is not None:
            matrix, offset = self.color_map
            rgb = out[:, :3] @ matrix.T + out[:, 3:4] * offset
            out = torch.cat([torch.minimum(rgb.clamp(min=0), out[:, 3:4]), out[:, 3:]], 1)
        return GpuRendered(out, unmapped, rays, samples, colors)

    def backward(
        self, rendered: GpuRendered, gradients: Tensor, density_to: Tensor | None, color_to: Tensor | None,
        displacement_to: Tensor | None = None,
        *, near_scaling_distance: float = 0.0, density_within: tuple[Tensor, int] | None = None,
    ) -> None:  # fmt: skip
        """Add the parts' gradients to flat buffers, from dL/d(unmapped) [rays, 5]; see backward() in rendering/rays.py.

        displacement_to: [3 vertices^3]. density_within: (marked cells uint8 [s^3], s).
        """
        r = rendered
        of_sigma, of_colors = launch.composite_backward(
            r.samples, r.colors, r.unmapped, gradients, near_scaling_distance
        )
        if color_to is not None:
            self.color.backward(r.samples, r.rays.directions, r.colors, of_colors, color_to)
        if density_to is not None:
            if density_within is not None:
                launch_edit.keep_inside(*density_within, r.samples, of_sigma)
            self.density.backward(r.samples, of_sigma, density_to)
        if displacement_to is not None:
            moved, s, rays = torch.zeros_like(r.samples.x), r.samples, r.rays
            self.density.add_position_gradients(s, of_sigma, moved)
            self.color.add_position_gradients(s, rays.directions, r.colors, of_colors, moved)
            launch_deform.displacement_backward(
                self.space.code, self._space, rays.origins, rays.directions, s, moved, self.vertices, displacement_to
            )

    def write_to(self, field: RadianceField) -> None:
        """Copy learned values back into `field`, and recompute its occupancy with exact distances."""
        field.density.values[:] = self.density.values.cpu().numpy()
        field.color.values[:] = self.color.values.cpu().numpy()
        field.occupancy.highest[:] = self.highest.cpu().numpy()
        field.occupancy.set_occupied(self.distances.cpu().numpy() == 0)
