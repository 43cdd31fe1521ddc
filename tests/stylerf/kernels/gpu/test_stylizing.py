"""A stylisation whose fixed shapes are painted on the device learns what the CPU's does."""

import numpy as np
import pytest
import torch

from tests.stylerf.training import test_stylize as on_cpu

ASKED = {"steps": 1, "refit_steps": 1, "refit_pixels": 12, "match": "both"}


def gradients_taken(made) -> list[np.ndarray]:
    """Instead of steps of the optimiser: the gradients it would take."""
    found = []

    def step(rate: float) -> None:
        taken = torch.as_tensor(made.adam.gradients).cpu().numpy()
        found.append(taken.reshape(-1, len(made.field.colour.values)).sum(0))
        made.adam.gradients[:] = 0

    made.adam.step = step
    return found


@pytest.mark.slow
def test_a_stylisation_on_a_device_learns_the_cpus_gradients(device, monkeypatch):
    """From the same colours: after a step or two a match that rounding turns leads them apart, on the CPU as well."""
    expected, made_by = on_cpu.stylizer(**ASKED), on_cpu.Stylizer

    def placed(*arguments):
        return made_by(*arguments[:5], arguments[5].to(device), *arguments[6:], device=str(device))

    monkeypatch.setattr(on_cpu, "Stylizer", placed)
    found = on_cpu.stylizer(**ASKED)
    assert type(found.geometry).__name__ == "DeviceFixedGeometry"
    for ours, theirs in zip(found.photos, expected.photos):
        np.testing.assert_allclose(ours, theirs, atol=1e-5)  # brought to the painting's colours by way of alpha
    learnt = [gradients_taken(made) for made in (expected, found)]
    for made in (expected, found):
        made.refit_step()
        made.state.phase = "style"
        made.style_step()
    rounding = 2e-3 if device.type == "cpu" else 3e-2  # the CPU keeps positions in sixteen bits; a GPU, features
    for theirs, ours in zip(*learnt):
        assert np.linalg.norm(theirs) > 0
        assert np.linalg.norm(ours - theirs) < rounding * np.linalg.norm(theirs)


@pytest.mark.slow
def test_a_stylisation_runs_to_its_end_on_a_device(device, monkeypatch):
    made_by = on_cpu.Stylizer
    monkeypatch.setattr(on_cpu, "Stylizer", lambda *a: made_by(*a[:5], a[5].to(device), *a[6:], device=str(device)))
    made = on_cpu.stylizer(**ASKED)
    before, phases = made.field.colour.values.copy(), []
    made.run(lambda now: phases.append(now.state.phase))
    assert phases == ["refit", "style"] and made.state.phase == "done" and made.field.colour_map is not None
    # What the device has learnt is in the field that is kept, and in a checkpoint.
    assert np.abs(made.field.colour.values - before).max() > 5e-3
    assert np.array_equal(made.checkpoint()[1]["colour"], made.field.colour.values)
