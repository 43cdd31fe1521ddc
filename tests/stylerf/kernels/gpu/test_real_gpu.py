"""What only a GPU can show: production sizes, no wait in a step, agreement of compiled kernels with the CPU's."""

import numpy as np
import pytest
import torch

from stylerf.rendering.rays import backward, render_rays
from tests.stylerf.small import SPACES, field_of, hash_colour, rays_into, vm_colour

pytestmark = pytest.mark.realgpu


@pytest.fixture
def gpu(device):
    if device.type != "cuda":
        pytest.skip("no GPU here")
    return device


@pytest.mark.parametrize("hashed", [False, True])
@pytest.mark.parametrize("kind", SPACES)
def test_thousands_of_rays_agree_with_the_cpu(kind, hashed, gpu):
    from stylerf.fields.device import DeviceField
    from tests.stylerf.kernels.gpu.on_device import device_rays, gradients_of

    field = field_of(SPACES[kind], 3, hash_colour(5) if hashed else vm_colour(4), 1 / 64)
    rays = rays_into(SPACES[kind], 5000, 4)
    cpu, made = render_rays(field, rays, chunks=2), DeviceField(field, gpu)
    found = made.render_rays(device_rays(rays, gpu))
    assert int(found.samples.total) == pytest.approx(cpu.samples.count, rel=1e-3)
    # Where rounding moves a sample across a cell's side or a threshold, a pixel differs by what that sample weighs.
    apart = np.abs(found.out.cpu().numpy() - cpu.out)[:, :4].max(1)
    assert np.quantile(apart, 0.99) < 1e-4 and apart.max() < 5e-2
    towards = np.random.default_rng(7).normal(size=(5000, 5)).astype(np.float32)
    towards[:, 4] = 0
    to = [np.zeros((2, len(part.values)), np.float32) for part in (field.density, field.colour)]
    backward(field, cpu, towards, *to)
    for ours, expected in zip(gradients_of(made, found, towards), to):
        whole = expected.sum(0)
        assert np.linalg.norm(ours - whole) < 5e-3 * np.linalg.norm(whole)


def test_a_step_never_waits_for_the_device(gpu):
    from stylerf.training.device_engine import DeviceEngine
    from tests.stylerf.kernels.gpu.test_engine import batch, thin_field
    from tests.stylerf.training.scenes import box_bank

    engine = DeviceEngine(box_bank(4, 10), 0, 1, thin_field(), device=gpu, samples=4000)
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
