"""Rays through shapes that move: deformer, geometry, initialization and stylization beside the CPU's."""

import numpy as np
import pytest
import torch

from stylerf.fields.deformation import Deformation, displaced_occupancy
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import render_rays
from stylerf.training.backends import deform_backend
from stylerf.training.common.adam import NORM_STEPS
from stylerf.training.deform import deformer, fitter
from stylerf.training.deform.deformer import Deformer, PhotoError
from stylerf.training.deform.fitter import DeformationFitter, DeformSettings
from stylerf.training.stylize.geometry import FixedGeometry, MovingGeometry
from tests.stylerf.blends import MILD
from tests.stylerf.kernels.gpu.test_engine import thin_field
from tests.stylerf.small import displacement_grid, hash_color
from tests.stylerf.training.running import saved
from tests.stylerf.training.scenes import box_bank, dome

VERTICES, STEP = 6, 1 / 4  # a walk costs the interpreter by its steps


@pytest.fixture(autouse=True)
def few_rays_find_what_is_seen(monkeypatch):
    monkeypatch.setattr(deformer, "SIGHT_RAYS", 4096)
    monkeypatch.setattr(fitter, "FIXED_RAYS", 40)


def bent(seed: int = 0) -> Deformation:
    """A deformation that has begun to bend."""
    made = Deformation.create(np.random.default_rng(seed), frequencies=2, width=16)
    made.values[-51:] = np.random.default_rng(seed + 1).normal(scale=0.3, size=51)
    return made


def made_on(device, clip: float = 0.0) -> Deformer:
    return deform_backend(device)[0](thin_field(step=STEP), bent(), dome(3, 1), VERTICES, 0, 1, clip)


def pushed(made: Deformer, steps: int, weight: float = 0.3, smoothness: float = 0.5) -> list[float]:
    """Steps along given gradients of the grid; what they tell."""
    reported, count = [], 3 * VERTICES**3
    for step in range(steps):
        given = np.random.default_rng([5, step]).normal(size=count).astype(np.float32)
        made.gradients += torch.from_numpy(given).to(made.device) if made.gradients.ndim == 1 else given
        reported.append(made.step(1e-3, weight, smoothness))
    return reported


# -- the deformer ---------------------------------------------------------------------------------------------------


def test_a_clip_holds_the_network_here_as_there(device):
    (cpu, gpu), plain = (made_on(where, clip=0.5) for where in (None, device)), made_on(device)
    for made in (cpu, gpu, plain):
        made.adam.steps = NORM_STEPS  # from now on gradients are shortened
        pushed(made, 3)
    np.testing.assert_allclose(gpu.values(), cpu.values(), rtol=1e-3, atol=1e-5)
    assert not np.allclose(gpu.values(), plain.values(), rtol=1e-3, atol=1e-5)


def test_steps_of_the_network_are_the_cpus(device, monkeypatch):
    monkeypatch.setattr(deformer, "REFRESH_EVERY", 2)
    cpu, gpu = made_on(None), made_on(device)
    assert np.array_equal(gpu.field.displacement, cpu.field.displacement) or device.type == "cuda"
    expected, reported = pushed(cpu, 3), pushed(gpu, 3)
    before, stale = gpu.field.displacement.copy(), gpu.deformation.values.copy()
    gpu.collect()
    # What has been learned came back when it was asked for, not before.
    assert not np.array_equal(gpu.field.displacement, before) and not np.array_equal(gpu.deformation.values, stale)
    np.testing.assert_allclose(gpu.deformation.values, cpu.deformation.values, atol=2e-5)
    largest = np.abs(cpu.field.displacement).max()
    assert largest > 1e-3
    np.testing.assert_allclose(gpu.field.displacement, cpu.field.displacement, atol=1e-4 * largest)
    if device.type == "cpu":
        np.testing.assert_allclose(reported, expected, rtol=1e-4)
    # Looked at after two of the three steps: where the grid had brought it by then.
    assert np.array_equal(gpu.field.occupancy.distances, cpu.field.occupancy.distances)


def test_a_look_finds_what_is_occupied_now(device):
    gpu = made_on(device)
    gpu.rest.set_occupied(np.random.default_rng(3).random(gpu.rest.cells**3) < 0.05)
    gpu._at_rest = torch.from_numpy(gpu.rest.distances).to(device)
    gpu.device_field.displacement.copy_(torch.from_numpy(displacement_grid(3, VERTICES, 0.04).ravel()))
    gpu.look()
    gpu.collect()
    expected = displaced_occupancy(gpu.rest, gpu.field.displacement)
    assert np.array_equal(gpu.field.occupancy.distances, expected.distances)
    assert not np.array_equal(expected.distances, gpu.rest.distances)


@pytest.mark.parametrize("back", [False, True])
def test_a_checkpoint_of_one_goes_on_upon_the_other(back, device):
    whole, first, second = (made_on(where) for where in (None, *((device, None) if back else (None, device))))
    pushed(whole, 2)
    pushed(first, 2)
    second.restore({name: array.copy() for name, array in first.arrays().items()})
    assert second.taken == 2
    theirs, ours = first.arrays(), second.arrays()
    assert theirs.keys() == ours.keys() and theirs["adam.steps"][0] == ours["adam.steps"][0] == 2
    for name in set(theirs) - {"adam.steps"}:
        np.testing.assert_array_equal(ours[name], theirs[name], err_msg=name)
    np.testing.assert_allclose(second.field.displacement, whole.field.displacement, atol=1e-6)
    pushed(whole, 1)
    pushed(second, 1)
    np.testing.assert_allclose(second.values(), whole.values(), atol=1e-5)


# -- rays through it ------------------------------------------------------------------------------------------------


def test_a_moving_view_is_painted_and_learned_as_on_the_cpu(device):
    from stylerf.training.stylize.geometry_gpu import GpuFixedGeometry, GpuMovingGeometry

    cameras, pixels = dome(2, 3, 6), np.array([3, 30, 17, 8, 14, 21, 22])
    towards = np.random.default_rng(0).normal(size=(len(pixels), 3)).astype(np.float32)
    seen = []
    for where in (None, device):
        made = made_on(where)
        # As a stylization does: a new color, taught through the fixed shapes first.
        if where is None:
            still = FixedGeometry(made.field, cameras, 0.1, 1)
            made.field.color = hash_color(6)
            moving, color_to = MovingGeometry, np.zeros((1, len(made.field.color.values)), np.float32)
        else:
            still = GpuFixedGeometry(made.field, cameras, 0.1, 1, 0, device=where)
            made.field.color = hash_color(6)
            moving, color_to = GpuMovingGeometry, still.new_adam().gradients
        geometry = moving(made.field, cameras, 0.1, 1, np.float32([0.6, 0.75, 0.9]), made, still)
        np.testing.assert_allclose(geometry.alpha(1), still.alpha(1))
        rgb, kept = geometry.paint(1, pixels)
        geometry.learn(kept, towards, color_to)
        of_grid = torch.as_tensor(made.gradients).cpu().numpy().reshape(-1)
        seen.append((rgb, geometry.alpha(1), torch.as_tensor(color_to).cpu().numpy().reshape(-1), of_grid))
    for expected, found in zip(*seen):
        largest = np.abs(expected).max()
        assert largest > 0
        np.testing.assert_allclose(found, expected, atol=5e-5 * largest)


# -- the initialization on the photos -------------------------------------------------------------------------------


def fitter_on(where, steps: int = 3) -> DeformationFitter:
    settings = DeformSettings(steps, rays=24, vertices=VERTICES, rate=3e-3, smoothness=0.1, patience=0.0)
    return DeformationFitter(
        thin_field(step=STEP), bent(), box_bank(4, 10), settings, 0, 1, backend=deform_backend(where)
    )


def test_the_initialization_is_the_cpus(device):
    """Three steps of the same rays: errors, sizes, quality, the grid; and what is kept at the end."""
    cpu, gpu = fitter_on(None), fitter_on(device)
    assert gpu.state.before == pytest.approx(cpu.state.before, abs=1e-3)
    rest = cpu.field.displacement.copy()
    reported = [(cpu.step(), gpu.step()) for _ in range(2)]
    if device.type == "cpu":
        np.testing.assert_allclose([b for _, b in reported], [a for a, _ in reported], rtol=2e-4)
    data, arrays = saved(gpu)
    moved = np.abs(cpu.field.displacement - rest).max()
    assert moved > 1e-4
    np.testing.assert_allclose(gpu.field.displacement, cpu.field.displacement, atol=5e-3 * moved)
    # The other device goes on from there; both end where their photos are explained best.
    again = fitter_on(None)
    again.resume(data, arrays)
    for made in (again, cpu):
        made.run()
    assert again.state.step == 3 and again.state.best == pytest.approx(cpu.state.best, abs=1e-3)
    np.testing.assert_allclose(again.field.displacement, cpu.field.displacement, atol=1e-2 * moved)


def test_photos_pull_through_a_color_map_as_on_the_cpu(device):
    drawn, found = box_bank(4, 10).draw(24, np.random.default_rng(0), 4)[:3], []
    for where in (None, device):
        deformer_of, error_of = deform_backend(where)
        field = thin_field(step=STEP)
        field.color_map = MILD
        made = deformer_of(field, bent(), dome(3, 1), VERTICES, 0, 1)
        error_of(made, 1.0, 0.05, 1).learn(*drawn, np.full(24, 0.5, np.float32))
        found.append(torch.as_tensor(made.gradients).cpu().numpy().reshape(-1))
    np.testing.assert_allclose(found[1], found[0], atol=1e-4 * np.abs(found[0]).max())


@pytest.mark.slow
def test_what_is_best_is_in_the_field_at_the_end(device):
    gpu = fitter_on(device, steps=1)
    gpu.run()
    assert gpu.state.step == 1 and len(gpu.state.curve) == 1
    drawn = gpu._fixed
    assert gpu.quality() == pytest.approx(gpu.state.best, abs=1e-4)
    assert np.array_equal(gpu.deformer.deformation.values, gpu._best)
    # The host's field is that field: its own kernels see the same.
    cpu = PhotoError(gpu.deformer, 1.0, gpu.settings.weight_threshold, 1)
    assert cpu.of(*drawn) == pytest.approx(gpu._error.of(*drawn), rel=1e-3)


def test_rays_that_find_no_room_teach_nothing(device, monkeypatch):
    from stylerf.training.deform import deformer_gpu

    gpu = fitter_on(device)
    drawn = gpu.dataset.draw(24, np.random.default_rng(0), 4)[:3]
    jitter = np.full(24, 0.5, np.float32)
    samples = render_rays(gpu.field, Rays.of(*drawn[:2], 0.0), threads=1).samples
    lengths = samples.ends - samples.starts
    monkeypatch.setattr(deformer_gpu, "MOST_SAMPLES", int(lengths.sum()) - 1)
    inside = (np.cumsum(lengths) < lengths.sum()) | (lengths == 0)  # a ray without samples needs no room
    assert 0 < inside.sum() < 24
    found = gpu._error.learn(*drawn, jitter)
    error = PhotoError(gpu.deformer, 1.0, gpu.settings.weight_threshold, 1).of(*(a[inside] for a in drawn))
    if device.type == "cpu":
        assert found == pytest.approx(error, rel=1e-4)
    assert bool(torch.isfinite(gpu.deformer.gradients).all()) and gpu.deformer.gradients.any()
