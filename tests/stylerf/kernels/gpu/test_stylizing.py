"""A stylization that follows its rays on the device, shapes held or bending, learns what the CPU's does."""

import numpy as np
import pytest
import torch

from stylerf.training.deform import deformer
from tests.stylerf.training.running import saved
from tests.stylerf.training.stylize import test_arf as on_cpu

ASKED = {"steps": 1, "refit_steps": 1, "refit_pixels": 12, "match": "both"}


def gradients_taken(made) -> list[np.ndarray]:
    """Instead of steps of the optimizer: the gradients it would take."""
    found = []

    def step(rate: float) -> None:
        taken = torch.as_tensor(made.adam.gradients).cpu().numpy()
        found.append(taken.reshape(-1, len(made.field.color.values)).sum(0))
        made.adam.gradients[:] = 0

    made.adam.step = step
    return found


@pytest.mark.slow
def test_a_stylization_on_a_device_learns_the_cpus_gradients(device, monkeypatch):
    """From the same colors: after a step or two a match that rounding turns leads them apart, on the CPU as well."""
    expected, made_by = on_cpu.stylizer(**ASKED), on_cpu.ArfTrainer

    def placed(*arguments):
        return made_by(*arguments[:5], arguments[5].to(device), *arguments[6:], device=str(device))

    monkeypatch.setattr(on_cpu, "ArfTrainer", placed)
    found = on_cpu.stylizer(**ASKED)
    assert type(found.geometry).__name__ == "GpuFixedGeometry"
    for ours, theirs in zip(found.photos, expected.photos):
        np.testing.assert_allclose(ours, theirs, atol=1e-5)  # brought to the painting's colors by way of alpha
    learned = [gradients_taken(made) for made in (expected, found)]
    for made in (expected, found):
        made.refit_step()
        made.state.phase = "style"
        made.style_step()
    rounding = 2e-3 if device.type == "cpu" else 3e-2  # the CPU keeps positions in sixteen bits; a GPU, features
    for theirs, ours in zip(*learned):
        assert np.linalg.norm(theirs) > 0
        assert np.linalg.norm(ours - theirs) < rounding * np.linalg.norm(theirs)


@pytest.mark.slow
def test_a_stylization_runs_to_its_end_on_a_device(device, monkeypatch):
    made_by = on_cpu.ArfTrainer
    monkeypatch.setattr(on_cpu, "ArfTrainer", lambda *a: made_by(*a[:5], a[5].to(device), *a[6:], device=str(device)))
    made = on_cpu.stylizer(**ASKED)
    before, phases = made.field.color.values.copy(), []
    made.run(lambda now: phases.append(now.state.phase))
    assert phases == ["refit", "style"] and made.state.phase == "done" and made.field.color_map is not None
    # What the device has learned is in the field that is kept, and in a checkpoint.
    assert np.abs(made.field.color.values - before).max() > 5e-3
    assert np.array_equal(made.checkpoint()[1]["color"], made.field.color.values)


@pytest.fixture
def coarse_walks(monkeypatch):
    """The interpreter pays for a walk by its steps."""
    monkeypatch.setattr(on_cpu.module, "COARSEST_STEP", 1 / 3)
    monkeypatch.setattr(deformer, "SIGHT_RAYS", 4096)


def deforming_on(device, monkeypatch, **asked):
    """The DeSRF stylization of the CPU's tests, on the device."""
    made_by = on_cpu.ArfTrainer
    with monkeypatch.context() as placed:
        placed.setattr(on_cpu, "ArfTrainer", lambda *a: made_by(*a[:5], a[5].to(device), *a[6:], device=str(device)))
        return on_cpu.stylizer(deform=True, **asked)


@pytest.mark.slow
def test_a_stylization_that_bends_learns_the_cpus_gradients_on_a_device(device, coarse_walks, monkeypatch):
    """Of colors and of the grid, in the first step of the style phase."""
    asked = ASKED | {"match": "none", "strategy": "deferred"}
    expected, found = on_cpu.stylizer(deform=True, **asked), deforming_on(device, monkeypatch, **asked)
    grids = []
    for made in (expected, found):
        made._next_phase()
        grids.append(made.deformer)
    assert [type(made.geometry).__name__ for made in (expected, found)] == ["MovingGeometry", "GpuMovingGeometry"]
    learned = [gradients_taken(made) for made in (expected, found)]
    moved = []
    for made, grid in zip((expected, found), grids):
        grid.step = lambda *rates, grid=grid: moved.append(torch.as_tensor(grid.gradients).cpu().numpy().ravel()) or 0.0
        made.style_step()
    rounding = 1e-3 if device.type == "cpu" else 3e-2  # features on a GPU are sixteen bits wide
    for theirs, ours in (*zip(*learned), moved):
        assert np.linalg.norm(theirs) > 0
        assert np.linalg.norm(ours - theirs) < rounding * np.linalg.norm(theirs)


@pytest.mark.slow
def test_a_stylization_that_bends_runs_to_its_end_on_a_device_and_goes_on_upon_the_cpu(
    device, coarse_walks, monkeypatch
):
    monkeypatch.setattr(deformer, "REFRESH_EVERY", 3)
    asked = ASKED | {"steps": 3, "strategy": "dilated", "remember": True, "deform_rate": 0.02}
    made, kept = deforming_on(device, monkeypatch, **asked), []
    made.run(lambda now: kept.append(saved(now)) if len(kept) < 3 else None)
    assert made.state.phase == "done" and made.field.color_map is not None and made.deformer.taken == 3
    # The field that is kept has what the device has learned since the last checkpoint, and is occupied where the last
    # look has found it: a fog that fills its box is so all over, hence the question of which grid it is.
    before = kept[-1][1]
    assert np.abs(made.field.color.values - before["color"]).max() > 1e-3
    assert np.abs(made._deformation.values - before["deform.values"]).max() > 1e-3
    assert made.field.occupancy is made.deformer.field.occupancy
    again = on_cpu.stylizer(deform=True, **asked)
    again.resume(*kept[2])
    again.run()
    assert again.deformer.taken == 3 and again.state.step == 3
    # A step of Adam goes the same way wherever it is taken, but for elements whose gradient is next to nothing.
    apart = np.abs(again.field.displacement - made.field.displacement)
    assert np.median(apart) < 0.02 * np.abs(made.field.displacement).max()
