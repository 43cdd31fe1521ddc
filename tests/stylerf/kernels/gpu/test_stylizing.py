"""A stylization that follows its rays on the device, shapes held or bending, learns what the CPU's does."""

import numpy as np
import pytest
import torch

from stylerf.training.backends import style_backend
from stylerf.training.deform import deformer
from stylerf.training.stylize import scene
from tests.stylerf.training.running import saved
from tests.stylerf.training.stylize import test_arf as on_cpu

ASKED = {"steps": 1, "refit_steps": 1, "refit_pixels": 12, "match": "both"}


def stylizer_on(device, **given):
    """The stylization of the CPU's tests, on a device."""
    return on_cpu.stylizer(backend=style_backend(str(device)), to=str(device), **given)


def gradients_taken(made) -> list[np.ndarray]:
    """Instead of steps of the optimizer: the gradients it would take."""
    found = []

    def step(rate: float) -> None:
        adam = made.scene.adam
        taken = torch.as_tensor(adam.gradients).cpu().numpy()
        found.append(taken.reshape(-1, len(made.scene.field.color.values)).sum(0))
        adam.gradients[:] = 0

    made.scene.adam.step = step
    return found


@pytest.mark.slow
def test_a_stylization_on_a_device_learns_the_cpus_gradients(device):
    """From the same colors: after a step or two a match that rounding turns leads them apart, on the CPU as well."""
    expected, found = on_cpu.stylizer(**ASKED), stylizer_on(device, **ASKED)
    assert type(found.scene.geometry).__name__ == "GpuFixedGeometry"
    for ours, theirs in zip(found.scene.photos, expected.scene.photos):
        np.testing.assert_allclose(ours, theirs, atol=1e-5)  # brought to the painting's colors by way of alpha
    learned = [gradients_taken(made) for made in (expected, found)]
    for made in (expected, found):
        made.scene.refit_step()
        made.state.phase = "style"
        made.method.step()
    rounding = 2e-3 if device.type == "cpu" else 3e-2  # the CPU keeps positions in sixteen bits; a GPU, features
    for theirs, ours in zip(*learned):
        assert np.linalg.norm(theirs) > 0
        assert np.linalg.norm(ours - theirs) < rounding * np.linalg.norm(theirs)


@pytest.mark.slow
def test_a_stylization_runs_to_its_end_on_a_device(device):
    made = stylizer_on(device, **ASKED)
    before, phases = made.scene.field.color.values.copy(), []
    made.run(lambda now: phases.append(now.state.phase))
    assert phases == ["refit", "style"] and made.state.phase == "done" and made.scene.field.color_map is not None
    # What the device has learned is in the field that is kept, and in a checkpoint.
    assert np.abs(made.scene.field.color.values - before).max() > 5e-3
    assert np.array_equal(made.checkpoint()[1]["color"], made.scene.field.color.values)


@pytest.fixture
def coarse_walks(monkeypatch):
    """The interpreter pays for a walk by its steps."""
    monkeypatch.setattr(scene, "COARSEST_STEP", 1 / 3)
    monkeypatch.setattr(deformer, "SIGHT_RAYS", 4096)


@pytest.mark.slow
def test_a_stylization_that_bends_learns_the_cpus_gradients_on_a_device(device, coarse_walks):
    """Of colors and of the grid, in the first step of the style phase."""
    requested = ASKED | {"match": "none", "strategy": "deferred"}
    expected, found = on_cpu.stylizer(deform=True, **requested), stylizer_on(device, deform=True, **requested)
    grids = []
    for made in (expected, found):
        made.next_phase()
        grids.append(made.scene.deformer)
    assert [type(made.scene.geometry).__name__ for made in (expected, found)] == ["MovingGeometry", "GpuMovingGeometry"]
    learned = [gradients_taken(made) for made in (expected, found)]
    moved = []
    for made, grid in zip((expected, found), grids):
        grid.step = lambda *rates, grid=grid: moved.append(torch.as_tensor(grid.gradients).cpu().numpy().ravel()) or 0.0
        made.method.step()
    rounding = 1e-3 if device.type == "cpu" else 3e-2  # features on a GPU are sixteen bits wide
    for theirs, ours in (*zip(*learned), moved):
        assert np.linalg.norm(theirs) > 0
        assert np.linalg.norm(ours - theirs) < rounding * np.linalg.norm(theirs)


@pytest.mark.slow
def test_a_bending_stylization_ends_on_a_device_and_resumes_on_the_cpu(
    device, coarse_walks, monkeypatch
):
    monkeypatch.setattr(deformer, "REFRESH_EVERY", 3)
    requested = ASKED | {"steps": 3, "strategy": "dilated", "remember": True, "deform_rate": 0.02}
    made, kept = stylizer_on(device, deform=True, **requested), []
    made.run(lambda now: kept.append(saved(now)) if len(kept) < 3 else None)
    assert made.state.phase == "done" and made.scene.field.color_map is not None and made.scene.deformer.taken == 3
    # The field that is kept has what the device has learned since the last checkpoint, and is occupied where the last
    # look has found it: a fog that fills its box is so all over, hence the question of which grid it is.
    before = kept[-1][1]
    assert np.abs(made.scene.field.color.values - before["color"]).max() > 1e-3
    assert np.abs(made.scene.problem.deformation.values - before["deform.values"]).max() > 1e-3
    assert made.scene.field.occupancy is made.scene.deformer.field.occupancy
    again = on_cpu.stylizer(deform=True, **requested)
    again.resume(*kept[2])
    again.run()
    assert again.scene.deformer.taken == 3 and again.state.step == 3
    # A step of Adam goes the same way wherever it is taken, but for elements whose gradient is next to nothing.
    apart = np.abs(again.scene.field.displacement - made.scene.field.displacement)
    assert np.median(apart) < 0.02 * np.abs(made.scene.field.displacement).max()
