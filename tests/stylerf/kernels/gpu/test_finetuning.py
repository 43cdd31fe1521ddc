"""Fine-tuning on the device: its loss, its pixels, its steps beside the CPU's, and going on across devices."""

import numpy as np
import pytest
import torch

from stylerf.fields.color_map import ColorMap
from stylerf.fields.region_color import RegionColor
from stylerf.training.backends import finetune_engine
from stylerf.training.finetune.engine import FineTuneSettings
from stylerf.training.finetune.trainer import EditedPixels, FineTuner
from tests.stylerf.small import close, field_of, vm_color
from tests.stylerf.training.running import saved
from tests.stylerf.training.scenes import AROUND, box_bank


@pytest.fixture(scope="module")
def bank():
    return box_bank(4, 10)


def edited(depth: float = 1.7) -> EditedPixels:
    generator = np.random.default_rng(2)
    views, pixels = generator.integers(0, 4, 40), generator.integers(0, 100, 40)
    return EditedPixels(views[:25], pixels[:25], np.full(25, depth, np.float32), (views[25:], pixels[25:]))


def thin_field(patched: bool = True, mapped: bool = False):
    field = field_of(AROUND, 3, vm_color(4), 1 / 8)
    field.density.values[-1] = -4.0
    if patched:
        marked = np.zeros((6,) * 3, bool)
        marked[1:5, 1:5, 2:6] = True
        field.color = RegionColor.create(field.color, marked, 20.0, table=64)
        field.color.values[:] = 0.2 * np.random.default_rng(1).normal(size=len(field.color.values))
    if mapped:
        matrix = torch.tensor([[0.8, 0.1, 0.0], [0.0, 0.9, 0.05], [0.1, 0.0, 0.7]])
        field.color_map = ColorMap(matrix, torch.tensor([0.05, 0.02, 0.1]))
    return field


def tuner(bank, device=None, patched=True, mapped=False, **more) -> FineTuner:
    given = {
        "steps": 3,
        "rays": 24,
        "rate": 2e-2,
        "density_factor": 0.0,
        "depth_weight": 0.5,
        "smoothness": (1e-3, 1e-3),
        **more,
    }
    engine = finetune_engine(None if device is None else str(device))
    return FineTuner(thin_field(patched, mapped), bank, edited(), FineTuneSettings(**given), 0, 1, engine=engine)


def gradients_taken(made) -> list[np.ndarray]:
    """Instead of steps of the optimizers: the gradients they would take."""
    found = []
    for adam in (made.engine.color_adam, made.engine.density_adam):

        def step(rate: float, adam=adam) -> None:
            taken = torch.as_tensor(adam.gradients).cpu().numpy()
            found.append(taken.reshape(-1, len(adam.values)).sum(0))
            adam.gradients[:] = 0

        adam.step = step
    return found


def test_chosen_pixels_become_the_cpus_rays(bank, device):
    from stylerf.training.common.ray_dataset_gpu import GpuRayDataset

    made, generator = GpuRayDataset(bank, device), np.random.default_rng(0)
    views, pixels = generator.integers(0, 4, 30), generator.integers(0, 100, 30)
    views[:2], pixels[:2] = (0, 3), (0, 99)  # the very first and the very last
    numbers = torch.from_numpy(made.number_of(views, pixels)).to(device)
    rays, wanted = made.at(numbers, torch.zeros(30, device=device))
    for ours, expected in zip((rays.origins, rays.directions, wanted), bank.at(views, pixels)):
        np.testing.assert_allclose(ours.cpu(), expected, atol=1e-6)
    nothing, none = made.at(numbers[:0], numbers[:0].float())
    assert nothing.origins.shape == (0, 3) and none.shape == (0, 4)


@pytest.mark.parametrize(("edited_rays", "depth_scale"), [(5, 0.3), (5, 0.0), (0, 0.3), (9, 0.3)])
def test_the_loss_and_its_gradient_equal_autograds(edited_rays, depth_scale, device):
    from stylerf.kernels.gpu import launch
    from stylerf.kernels.gpu.ray_samples import GpuSamples

    generator, level = torch.Generator().manual_seed(1), 0.7
    out, wanted = (torch.rand(9, n, generator=generator) for n in (5, 4))
    depth = torch.rand(edited_rays, generator=generator) + 0.5
    depth[1:2] = 0  # ends in the background: not held
    counts = torch.full((9,), 3, dtype=torch.int32)
    starts = 3 * torch.arange(9)
    ends = starts + 3
    lost = torch.zeros(9, dtype=torch.bool)
    lost[[2, 7]] = True
    ends[lost] = starts[lost]  # these found no room
    nothing = torch.zeros(0)
    samples = GpuSamples(
        *(t.to(device) for t in (starts, ends, counts)), nothing, torch.zeros(1), *[nothing] * 6
    )  # fmt: skip
    sums = torch.zeros(5, device=device)
    found = launch.tuning_loss(
        out.to(device), wanted.to(device), depth.to(device), samples, level, 0.2, depth_scale, sums
    )
    exact = out.double().requires_grad_()
    shown = exact[:, :3] + (1 - exact[:, 3:4]) * level
    expected_colors = wanted[:, :3] * wanted[:, 3:] + (1 - wanted[:, 3:]) * level
    squares = (shown - expected_colors).square().sum(1) * ~lost
    held = (depth > 0) & ~lost[:edited_rays]
    off = (exact[:edited_rays, 4] / depth.clamp(min=1e-6) - 1) * held
    off = off.square().sum() if depth_scale > 0 else off.sum() * 0
    (0.1 * squares.sum() + 0.5 * depth_scale * off).backward()
    close(found.cpu(), exact.grad, 1e-6)
    inside = torch.arange(9) < edited_rays
    expected = [squares[~inside].sum(), squares[inside].sum(), off, (lost & ~inside).sum(), (lost & inside).sum()]
    np.testing.assert_allclose(sums.cpu(), [float(e.detach()) for e in expected], rtol=1e-5, atol=1e-7)


CASES = {
    "a patch, shapes held": {},
    "a patch beside which density learns": {"density_factor": 0.5},
    "the field's colors and density, mapped": {"patched": False, "density_factor": 0.5, "mapped": True},
}


@pytest.mark.parametrize("case", [pytest.param(c, marks=[] if "density" in c else pytest.mark.slow) for c in CASES])
def test_a_step_learns_the_gradient_that_the_cpu_finds(case, bank, device):
    both = [tuner(bank, where, **CASES[case]) for where in (None, device)]
    learned = [gradients_taken(made) for made in both]
    losses = [(made.step(), made.engine.settle())[1] for made in both]
    assert len(learned[0]) == len(learned[1]) == (2 if "density" in case else 1)
    for theirs, ours in zip(*learned):
        assert np.abs(theirs).max() > 0
        close(ours, theirs, 5e-5)
    assert losses[0].keys() == losses[1].keys() == {"outside", "inside", "depth"}
    for name, value in losses[0].items():
        assert losses[1][name] == pytest.approx(value, rel=1e-4)
    assert (losses[0]["depth"] > 0) == ("density" in case)


def agree(values: np.ndarray, expected: np.ndarray) -> None:
    """Learned values of the patch. Where a gradient is all but nothing its sign is rounding's, and Adam's step as long
    as for any."""
    apart, moved = np.abs(values - expected), np.abs(expected - thin_field().color.values)
    assert moved.max() > 1e-2 and np.quantile(apart, 0.99) < 1e-4 and apart.mean() < 1e-3 * moved.mean()


def after(made: FineTuner, begun: FineTuner) -> FineTuner:
    """A step of `made` from begun's checkpoint."""
    made.resume(*saved(begun))
    made.step()
    made.state.step += 1
    return made


def one_step(made: FineTuner) -> FineTuner:
    made.step()
    made.state.step = 1
    return made


def test_a_device_step_between_two_cpu_steps_equals_the_cpus(bank, device):
    expected = tuner(bank)
    expected.run()
    between = after(tuner(bank, device), one_step(tuner(bank)))
    ended = after(tuner(bank), between)
    assert ended.state.step == expected.state.step == ended.engine.color_adam.steps == 3
    agree(ended.field.color.values, expected.field.color.values)
    assert np.array_equal(between.field.density.values, thin_field().density.values)


@pytest.mark.slow
def test_a_run_on_the_device_comes_to_what_the_cpu_does(bank, device):
    expected, made = tuner(bank), tuner(bank, device)
    for one in (expected, made):
        one.run()
    agree(made.field.color.values, expected.field.color.values)
    begun = one_step(tuner(bank, device))
    agree(after(tuner(bank, device), after(tuner(bank), begun)).field.color.values, expected.field.color.values)
    assert np.array_equal(made.checkpoint()[1]["field.color"], made.field.color.values)
    assert made.state.step == 3 and set(made.engine.settle()) == {"outside", "inside", "depth"}
