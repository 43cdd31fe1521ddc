"""Render whole views of a field on a GPU."""

from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor

from stylerf.fields.gpu.field import GpuField, GpuRendered
from stylerf.fields.gpu.memory import in_parts
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.lens_camera import LensCamera
from stylerf.kernels.gpu.ray_samples import GpuRays
from stylerf.rendering.view import RenderedView, view_of

RAYS_AT_ONCE = 1 << 18
# Half a step of an 8-bit image: the largest change of a pixel allowed by half precision.
TOLERANCE = 0.5 / 255
TRIED_RAYS = 4096


def rays_of(camera: Camera, number: Tensor) -> GpuRays:
    """Return rays through the centers of pixels [n] (row-major indices), computed on the pixels' device."""
    count, device = len(number), number.device
    if isinstance(camera, LensCamera):  # its inverse has no closed form; the CPU caches it for all frames of a lens
        return GpuRays.of(*camera.rays(number.cpu().numpy()), device)
    x = ((number % camera.width).float() + 0.5 - camera.cx) / camera.fx
    y = ((number // camera.width).float() + 0.5 - camera.cy) / camera.fy
    local = torch.stack([x, y, torch.ones_like(x)], 1)
    pose = torch.from_numpy(camera.world_from_camera[:3].astype(np.float32)).to(device)
    ways = local[:, :1] * pose[:, 0] + local[:, 1:2] * pose[:, 1] + local[:, 2:] * pose[:, 2]
    ways = ways / torch.linalg.vector_norm(ways, dim=1, keepdim=True)
    origins = pose[:, 3].expand(count, 3).contiguous()
    return GpuRays(origins, ways.contiguous(), torch.full((count,), 0.5, device=device))


class GpuRenderer:
    """Renders a field on a GPU.

    precision: of the tables; auto: half precision if that changes no tested pixel of the first view by more than
    TOLERANCE. `half` holds the choice, None before the first view.
    """

    def __init__(
        self,
        field: RadianceField,
        device: torch.device | str,
        precision: str = "auto",
        rays_at_once: int = RAYS_AT_ONCE,
    ) -> None:
        self.device, self.rays_at_once = torch.device(device), rays_at_once
        self.half = None if precision == "auto" else precision == "float16"
        tried = (False, True) if self.half is None else (self.half,)
        self._fields = {half: GpuField(field, self.device, half) for half in tried}

    @property
    def field(self) -> GpuField:
        """The copy of the field to render."""
        return self._fields[bool(self.half)]

    def choose(self, camera: Camera) -> None:
        """Choose the precision on this view, unless already chosen."""
        if self.half is not None:
            return
        count = camera.width * camera.height
        pixels = np.linspace(0, count - 1, min(count, TRIED_RAYS)).astype(np.int64)
        rays = GpuRays.of(*camera.rays(pixels), self.device)
        near = self.field.space.view_start(camera.center)
        exact, rounded = (
            field.render_rays(rays, weight_threshold=field.weight_threshold, near=near).out[:, :4]
            for field in (self._fields[half] for half in (False, True))
        )
        self.half = bool((exact - rounded).abs().max() <= TOLERANCE)
        del self._fields[not self.half]  # frees the other copy's memory

    def pixels(
        self,
        camera: Camera,
        *,
        min_transmittance: float = 1e-3,
        regions: Mapping[str, Tensor] | None = None,
        on_rays: Callable[[int], None] = lambda done: None,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Render every pixel of a camera; see render_view() in rendering/view.py.

        Returns:
            ([pixels, 5]: premultiplied rgb, alpha, surface distance; [pixels] by region: alpha inside), on the device.
        """
        self.choose(camera)
        marked = regions or {}
        near = self.field.space.view_start(camera.center)

        def part(begin: int, end: int) -> list[Tensor]:
            rays = rays_of(camera, torch.arange(begin, end, device=self.device))
            rendered = self.field.render_rays(
                rays,
                min_transmittance=min_transmittance,
                weight_threshold=self.field.weight_threshold,
                near=near,
            )
            found = [rendered.with_surface_distance(), *(alpha_inside(cells, rendered) for cells in marked.values())]
            on_rays(end)
            return found

        parts = in_parts(camera.width * camera.height, self.rays_at_once, part)
        seen, *inside = (torch.cat(found) for found in zip(*parts))
        return seen, dict(zip(marked, inside))

    def view(
        self,
        camera: Camera,
        *,
        min_transmittance: float = 1e-3,
        regions: Mapping[str, np.ndarray] | None = None,
        on_rays: Callable[[int], None] = lambda done: None,
    ) -> RenderedView:
        """Render a view; see render_view() in rendering/view.py."""
        marked = {
            name: torch.from_numpy(np.ascontiguousarray(cells)).to(self.device)
            for name, cells in (regions or {}).items()
        }
        out, inside = self.pixels(camera, min_transmittance=min_transmittance, regions=marked, on_rays=on_rays)
        return view_of(camera, out.cpu().numpy(), {name: mask.cpu().numpy() for name, mask in inside.items()})


def alpha_inside(marked: Tensor, rendered: GpuRendered) -> Tensor:
    """Return the sum of each ray's weights over samples in marked cells [s, s, s] bool, [rays]."""
    s, cells = rendered.samples, marked.shape[0]
    place = (s.x * cells).long().clamp(0, cells - 1)
    own = marked[place[:, 0], place[:, 1], place[:, 2]]
    out = torch.zeros(len(s.starts), device=s.weights.device)
    return out.index_add_(0, s.ray_of.long(), torch.where(own, s.weights, 0.0))
