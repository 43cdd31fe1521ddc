"""One launch of every GPU kernel in every form that the product uses, on small CPU tensors."""

import torch

from stylerf.editing.device_palette import DevicePalette
from stylerf.fields.device import DeviceField
from stylerf.kernels.gpu import edit_launch, launch
from stylerf.training.edit import EditSettings, start_module
from tests.stylerf.editing.region_pictures import view_of
from tests.stylerf.fields.test_patch import CELLS, patch
from tests.stylerf.kernels.gpu.on_device import device_rays
from tests.stylerf.small import SPACES, displacement_grid, field_of, hash_colour, rays_into, vm_colour


def everything() -> None:
    for kind, colour, displaced, half in (
        ("box", vm_colour(1, degree=1), False, False),
        ("box", vm_colour(1, degree=1), False, True),
        ("contraction", vm_colour(1, degree=2), False, False),
        ("frustum", hash_colour(1), True, False),
        ("box", patch(), False, False),
        ("box", patch(), False, True),
    ):
        field = field_of(SPACES[kind], 3, colour, 1 / 8, displacement_grid(6) if displaced else None)
        made, rays = DeviceField(field, "cpu", half), device_rays(rays_into(SPACES[kind], 8, 4), torch.device("cpu"))
        rendered = made.render_rays(rays, room=64)
        to = [torch.zeros_like(part.values) for part in (made.density, made.colour)]
        sums = torch.zeros(3)
        wanted, background = torch.zeros(8, 4), torch.zeros(8, 3)
        gradients = launch.photometric_loss(rendered.out, wanted, background, rendered.samples, 0.1, sums)
        made.backward(rendered, gradients, *to, density_within=(torch.zeros(CELLS**3, dtype=torch.uint8), CELLS))
        made.density.smooth(0.1, to[0])
        made.colour.smooth(0.1, to[1])
        made.density.sigma(torch.zeros(5, 3))
        moments = [torch.zeros_like(to[0]) for _ in range(2)]
        launch.adam(made.density.values, to[0], *moments, 0.1, (0.9, 0.99), 1e-15, (0.1, 0.01), 0, len(to[0]))
    launch.shade_backward(rendered.samples, torch.zeros(8, 3))
    from stylerf.training.device_rays import DeviceBank
    from tests.stylerf.training.scenes import box_bank

    bank = DeviceBank(box_bank(3, 8), torch.device("cpu"))
    for background in (None, 1.0):
        bank.draw(1, 0, 16, 16, 3, 0.9, background)
    local_edits(rendered, bank)


def local_edits(rendered, bank) -> None:
    """What learning an edit and fine-tuning launch beside the field's own kernels."""
    edit_launch.ends_inside(torch.zeros(CELLS**3, dtype=torch.uint8), CELLS, rendered.samples)
    edit_launch.tuning_loss(
        rendered.out, torch.zeros(8, 4), torch.zeros(3), rendered.samples, 1.0, 0.1, 0.1, torch.zeros(5)
    )
    bank.at(torch.zeros(16, dtype=torch.int64), torch.zeros(16))
    module = DevicePalette(start_module([view_of(0)], EditSettings(), 0), "cpu")
    to = torch.zeros_like(module.table)
    module.features(torch.zeros(7, 3), to).sum().backward()
