"""One launch of every GPU kernel in every form that the product uses, on small CPU tensors."""

import torch

from stylerf.editing.palette_module_gpu import GpuPaletteModule
from stylerf.fields.gpu.field import GpuField, unsupported
from stylerf.kernels.cpu.adam import AdamRates
from stylerf.kernels.gpu import launch
from stylerf.kernels.gpu.ray_samples import GpuAdamState
from stylerf.training.edit.trainer import EditSettings, start_module
from tests.stylerf.editing.region_pictures import view_of
from tests.stylerf.fields.test_region_color import CELLS, patch
from tests.stylerf.kernels.gpu.on_gpu import device_rays
from tests.stylerf.small import (
    SPACES,
    SPARSE,
    density,
    displacement_grid,
    field_of,
    hash_color,
    hash_density,
    headed,
    rays_into,
    vm_color,
    voxel_density,
)


def learn_deformation(made: GpuField, rendered, gradients: torch.Tensor) -> None:
    """Of a field that need not be displaced: the kernels are the same."""
    made.vertices = made.vertices or 5
    made.backward(rendered, gradients, None, None, torch.zeros(3 * made.vertices**3))


def everything() -> None:
    for kind, density_of, color, displaced, half in (
        ("box", density, vm_color(1, degree=1), False, False),
        ("box", density, vm_color(1, degree=1), False, True),
        ("contraction", density, vm_color(1, degree=2), False, False),
        ("frustum", density, hash_color(1), True, False),
        ("box", hash_density, headed(1, "hash", "linear"), False, False),
        ("contraction", hash_density, headed(1, "hash", "mlp"), True, True),
        ("box", voxel_density, headed(1, "voxel", "linear", 2, SPARSE), False, True),
        ("frustum", voxel_density, headed(1, "voxel", "mlp", 1, SPARSE), False, False),
        ("box", density, headed(1, "vm", "mlp"), False, False),
        ("box", density, patch(), False, False),
        ("box", density, patch(), False, True),
    ):
        field = field_of(SPACES[kind], 3, color, 1 / 8, displacement_grid(6) if displaced else None)
        field.density = density_of(3)
        made, rays = GpuField(field, "cpu", half), device_rays(rays_into(SPACES[kind], 8, 4), torch.device("cpu"))
        rendered = made.render_rays(rays, capacity=64)
        rendered.with_surface_distance()
        to = [torch.zeros_like(part.values) for part in (made.density, made.color)]
        sums = torch.zeros(3)
        wanted, background = torch.zeros(8, 4), torch.zeros(8, 3)
        gradients = launch.photometric_loss(rendered.out, wanted, background, rendered.samples, 0.1, sums)
        made.backward(rendered, gradients, *to, density_within=(torch.zeros(CELLS**3, dtype=torch.uint8), CELLS))
        if not half and unsupported(field, moving=True) is None:
            learn_deformation(made, rendered, gradients)
        made.density.smooth(0.1, to[0])
        made.color.smooth(0.1, to[1])
        made.density.sigma(torch.zeros(5, 3))
        moments = [torch.zeros_like(to[0]) for _ in range(2)]
        state = GpuAdamState(made.density.values, to[0], *moments)
        launch.adam(state, AdamRates(0.1, 0.9, 0.99, 1e-15, 0.1, 0.01), 0, len(to[0]))
    launch.shade_backward(rendered.samples, torch.zeros(8, 3))
    launch.displaced_cells(made.distances, made.cells, 2, torch.zeros(3 * 5**3), 5)
    from stylerf.training.common.ray_dataset_gpu import GpuRayDataset
    from tests.stylerf.training.scenes import box_bank

    bank = GpuRayDataset(box_bank(3, 8), torch.device("cpu"))
    for background in (None, 1.0):
        bank.draw(1, 0, 16, 16, 3, 0.9, background)
    local_edits(rendered, bank)


def local_edits(rendered, bank) -> None:
    """What learning an edit and fine-tuning launch beside the field's own kernels."""
    launch.ends_inside(torch.zeros(CELLS**3, dtype=torch.uint8), CELLS, rendered.samples)
    launch.tuning_loss(rendered.out, torch.zeros(8, 4), torch.zeros(3), rendered.samples, 1.0, 0.1, 0.1, torch.zeros(5))
    bank.at(torch.zeros(16, dtype=torch.int64), torch.zeros(16))
    module = GpuPaletteModule(start_module([view_of(0)], EditSettings(), 0), "cpu")
    to = torch.zeros_like(module.table)
    module.features(torch.zeros(7, 3), to).sum().backward()
