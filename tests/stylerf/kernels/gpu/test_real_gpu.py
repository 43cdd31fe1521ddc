"""What only a GPU can show: production sizes, no wait in a step, agreement of compiled kernels with the CPU's."""

import numpy as np
import pytest
import torch

from stylerf.rendering.rays import backward, render_rays
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

pytestmark = pytest.mark.realgpu


@pytest.fixture
def gpu(device):
    if device.type != "cuda":
        pytest.skip("no GPU here")
    return device


PARTS = {
    "vm": lambda: (density(3), vm_color(4)),
    "stylized": lambda: (density(3), hash_color(5)),
    "hash": lambda: (hash_density(3), headed(4, "hash", "linear")),
    "voxel": lambda: (voxel_density(3), headed(4, "voxel", "linear", 2, SPARSE)),
    "vm-mlp": lambda: (density(3), headed(4, "vm", "mlp")),
    "hash-mlp": lambda: (hash_density(3), headed(4, "hash", "mlp")),
    "voxel-mlp": lambda: (voxel_density(3), headed(4, "voxel", "mlp", 1, SPARSE)),
}


@pytest.mark.parametrize("parts", PARTS)
@pytest.mark.parametrize("kind", SPACES)
def test_thousands_of_rays_agree_with_the_cpu(kind, parts, gpu):
    from stylerf.fields.gpu.field import GpuField
    from tests.stylerf.kernels.gpu.on_gpu import device_rays, gradients_of

    field = field_of(SPACES[kind], 3, None, 1 / 64)
    field.density, field.color = PARTS[parts]()
    rays = rays_into(SPACES[kind], 5000, 4)
    cpu, made = render_rays(field, rays, threads=2), GpuField(field, gpu)
    found = made.render_rays(device_rays(rays, gpu))
    assert int(found.samples.total) == pytest.approx(cpu.samples.total, rel=1e-3)
    # Where rounding moves a sample across a cell's side or a threshold, a pixel differs by what that sample weighs.
    apart = np.abs(found.out.cpu().numpy() - cpu.out)[:, :4].max(1)
    assert np.quantile(apart, 0.99) < 1e-4 and apart.max() < 5e-2
    towards = np.random.default_rng(7).normal(size=(5000, 5)).astype(np.float32)
    towards[:, 4] = 0
    to = [np.zeros((2, len(part.values)), np.float32) for part in (field.density, field.color)]
    backward(field, cpu, towards, *to)
    for ours, expected in zip(gradients_of(made, found, towards), to):
        whole = expected.sum(0)
        assert np.linalg.norm(ours - whole) < 5e-3 * np.linalg.norm(whole)


@pytest.mark.parametrize("kinds", ["vm", "hash", "voxel", "vm+hash-mlp"])
def test_a_step_never_waits_for_the_device(kinds, gpu):
    from stylerf.training.fit.engine_gpu import GpuEngine
    from tests.stylerf.kernels.gpu.test_engine import FIELDS, batch
    from tests.stylerf.training.scenes import box_bank

    engine = GpuEngine(box_bank(4, 10), 0, 1, FIELDS[kinds](), device=gpu, samples=4000)
    engine.learn(batch())
    engine.refresh(0, 1)
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        for step in range(3):
            engine.learn(batch(step=step, rays=512, smoothness=(0.1, 0.1)))
            engine.refresh(step, 1)
    finally:
        torch.cuda.set_sync_debug_mode("default")


@pytest.mark.parametrize("kind", SPACES)
def test_thousands_of_rays_teach_a_deformation_what_they_do_on_the_cpu(kind, gpu):
    from stylerf.fields.gpu.field import GpuField
    from tests.stylerf.kernels.gpu.on_gpu import device_rays

    field = field_of(SPACES[kind], 3, hash_color(5), 1 / 64, displacement_grid(6, 9, 0.02))
    rays, towards = rays_into(SPACES[kind], 5000, 4), np.random.default_rng(7).normal(size=(5000, 5))
    towards = (towards * [1, 1, 1, 1, 0]).astype(np.float32)
    expected, to = np.zeros((2, field.displacement.size), np.float32), torch.zeros(field.displacement.size, device=gpu)
    backward(field, render_rays(field, rays, threads=2), towards, None, None, expected)
    made = GpuField(field, gpu)
    rendered = made.render_rays(device_rays(rays, gpu))
    made.backward(rendered, torch.from_numpy(towards).to(gpu), None, None, to)
    whole = expected.sum(0)
    # A sample that rounding moves across a cell's side has that cell's slope.
    assert np.linalg.norm(to.cpu().numpy() - whole) < 2e-2 * np.linalg.norm(whole)


def test_a_step_of_a_deformation_never_waits_for_the_device(gpu):
    from tests.stylerf.kernels.gpu.test_moving_geometry import fitter_on

    fitter = fitter_on(gpu, steps=100)
    fitter.step()
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        for _ in range(18):  # occupancy is looked at after sixteen
            fitter.step()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert fitter.deformer.taken == 19 and np.isfinite(fitter.quality())


def test_steps_of_a_local_edit_never_wait_for_the_device(gpu):
    from tests.stylerf.kernels.gpu import test_editing, test_finetuning
    from tests.stylerf.training.scenes import box_bank

    tuner = test_finetuning.tuner(box_bank(4, 10), gpu, density_factor=0.5)
    trainer = test_editing.trainer(gpu, style=True)
    trainer.state.phase = "style"
    for step in range(2):  # each view once: what is kept of it is sent then
        trainer.state.step = step
        trainer.step()
    tuner.step()
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        for step in range(3):
            tuner.state.step = trainer.state.step = step
            tuner.step()
            trainer.step()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert tuner.engine.settle()["inside"] > 0 and trainer.engine.settle()["style"] > 0
