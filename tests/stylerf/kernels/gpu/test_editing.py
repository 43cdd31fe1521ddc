"""Learning an edit on the device: the palette module's answers, its gradients beside the CPU's, and going on across."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.fields.palette_edits import PaletteEdits
from stylerf.training.backends import edit_engine
from stylerf.training.edit.trainer import EditTrainer, start_module
from tests.stylerf.editing.region_pictures import view_of
from tests.stylerf.editing.test_palette_module import module, places
from tests.stylerf.small import close
from tests.stylerf.style.small_trunk import picture, small_trunk
from tests.stylerf.training.edit.test_trainer import SMALL
from tests.stylerf.training.running import saved

FEW = {"palette_steps": 2, "style_steps": 1, "pruned_steps": 1, "pruned_style_steps": 1, "pixels": 300, "colors": 4,
       "max_colors": 3}  # fmt: skip


def trainer(device=None, style: bool = False, **more) -> EditTrainer:
    settings = replace(SMALL, **FEW | more)
    views = [view_of(number, side=24) for number in range(2)]
    views[0].transition[:100] = 0.5
    views[0].edges[50:90] = 0.7
    painting, extractor = (picture(40, 40, 9), small_trunk().to(device or "cpu")) if style else (None, None)
    engine = edit_engine(None if device is None else str(device))
    return EditTrainer(views, start_module(views, settings, 0), settings, painting, extractor, 0, 1, engine)


@pytest.mark.parametrize("removed", [(), (0, 1, 3)])
def test_a_module_answers_as_on_the_cpu(removed, device):
    from stylerf.editing.palette_module_gpu import GpuPaletteModule

    made = module()
    there, (x, directions) = GpuPaletteModule(made, device), places(70)
    assert len(there.kept) == 4
    made.active[list(removed)] = False  # pruned or not, what is asked is what is active now
    expected, found = made.mixture(x, directions), there.mixture(x, directions)
    for name in ("weights", "offsets", "colors"):
        close(getattr(found, name), getattr(expected, name), 1e-5, name)
    np.testing.assert_allclose(there.palette, made.palette, atol=1e-7)
    edits, fading = PaletteEdits(colors={0: (0.0, 0.2, 0.9)}, scales={0: 2.0}), np.linspace(0, 1, 70)
    np.testing.assert_allclose(
        there.colors(x, directions, edits, fading), made.colors(x, directions, edits, fading), atol=1e-5
    )
    assert there.weights(x[:0]).shape == (0, 4 - len(removed))


def test_points_beyond_the_box_count_to_its_sides_and_learn_there(device):
    from stylerf.editing.palette_module_gpu import GpuPaletteModule

    made, x = module(), np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.4, 0.45, 0.45]], np.float32)
    there = GpuPaletteModule(made, device)
    to, local = torch.zeros_like(there.table), there.local(torch.from_numpy(x).to(device))
    np.testing.assert_array_equal(local.cpu(), made.local(x))
    phi = there.features(local, to)
    close(phi.detach().cpu(), made.encoding.forward(made.local(x), 1), 1e-6)
    towards = torch.randn(phi.shape, generator=torch.Generator().manual_seed(1))
    (phi * towards.to(device)).sum().backward()
    expected = np.zeros((1, len(made.encoding.values)), np.float32)
    made.encoding.backward(made.local(x), towards.numpy(), expected)
    close(to.cpu(), expected[0], 1e-6)
    assert expected.any()


def gradients_taken(made: EditTrainer) -> list[np.ndarray]:
    """Instead of steps of the optimizers: the gradients they would take."""
    found = []
    for adam in (made.engine.networks, made.engine.table):

        def step(rate: float, adam=adam) -> None:
            found.append(torch.as_tensor(adam.gradients).cpu().numpy().reshape(-1, len(adam.values)).sum(0))
            adam.gradients[:] = 0

        adam.step = step
    return found


@pytest.mark.parametrize("phase", ["palette", "style", "pruned"])
def test_a_step_learns_the_gradients_that_the_cpu_finds(phase, device):
    both = [trainer(where, style=True) for where in (None, device)]
    learned, reported = [gradients_taken(made) for made in both], []
    for made in both:
        made.state.phase = phase
        if phase == "pruned":
            made._module.active[1] = False
        made.step()
        reported.append(made.engine.settle())
    assert reported[0].keys() == reported[1].keys() and ("style" in reported[0]) == (phase != "palette")
    for name, value in reported[0].items():
        assert reported[1][name] == pytest.approx(value, rel=1e-4, abs=1e-7), name
    for theirs, ours in zip(*learned):
        assert np.abs(theirs).max() > 0
        if device.type == "cuda":
            # The two devices' convolutions round differently: where one closes a ReLU, the other may leave it open.
            assert np.linalg.norm(ours - theirs) < 5e-3 * np.linalg.norm(theirs)
        else:
            close(ours, theirs, 2e-4)


def agree(made: EditTrainer, expected: EditTrainer) -> None:
    """Numbers and colors, beside how far both have come. Where a gradient is all but nothing its sign is rounding's,
    and Adam's step is as long as for any."""
    begun, one, other = trainer().module, made.module, expected.module
    moved = np.abs(other.values - begun.values).mean()
    assert np.abs(one.values - other.values).mean() < 1e-2 * moved
    first, second, plain = (each.colors(*requested()) for each in (one, other, begun))
    assert np.abs(first - second).mean() < 1e-2 * np.abs(second - plain).mean()


def one_step(made: EditTrainer) -> EditTrainer:
    made.step()
    made.state.step += 1
    return made


def test_a_device_step_between_two_cpu_steps_equals_the_cpus(device):
    expected, begun = trainer(), one_step(trainer())
    for _ in range(3):
        one_step(expected)
    between = trainer(device)
    between.resume(*saved(begun))
    ended = trainer()
    ended.resume(*saved(one_step(between)))
    one_step(ended)
    assert ended.state.step == ended.engine.networks.steps == ended.engine.table.steps == 3
    agree(ended, expected)


@pytest.mark.slow
def test_an_edit_is_learned_to_its_end_on_a_device(device):
    expected, made = trainer(), trainer(device)
    for one in (expected, made):
        one.run()
        assert one.state.phase == "done" and one._module.active.sum() == 3
    agree(made, expected)
    figures = [one.figures() for one in (expected, made)]
    assert figures[0]["shares"] == pytest.approx(figures[1]["shares"], abs=2e-3)
    assert figures[0]["psnr"] == pytest.approx(figures[1]["psnr"], abs=0.05)
    # What the device has learned is in the module that is kept.
    np.testing.assert_allclose(made.module.colors(*requested()), made.evaluator.colors(*requested()), atol=1e-5)


def requested() -> tuple[np.ndarray, np.ndarray]:
    view = view_of(1, side=24)
    return view.x, view.directions


@pytest.mark.slow
def test_a_loss_that_is_no_number_is_reported_on_a_device_too(device):
    from stylerf.errors import Diverged

    made = trainer(device)
    made.views[0].target[:], made.views[1].target[:] = np.nan, np.nan
    with pytest.raises(Diverged, match="finite"):
        made.run()
