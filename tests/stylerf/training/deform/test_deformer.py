"""Learning a deformation: gradients through the grid, init on photos, what a stylization does to shapes."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.fields.deformation import Deformation
from stylerf.fields.radiance_field import RadianceField
from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.deform.deformer import Deformer, PhotoError
from stylerf.training.deform.fitter import DeformationFitter, DeformSettings
from tests.stylerf.blends import MILD
from tests.stylerf.training.running import saved
from tests.stylerf.training.scenes import box_bank, box_fitter, box_photo, dome

SETTINGS = DeformSettings(steps=60, rays=256, vertices=8, rate=3e-3, smoothness=0.01, patience=0.0)


@pytest.fixture(scope="module")
def fitted() -> dict:
    fitter = box_fitter(150)
    fitter.run()
    return fitter._now()


@pytest.fixture
def scene(fitted):
    """Makes a fitted box, each time a copy of its own."""
    return lambda: RadianceField.restore(fitted.field, {k: v.copy() for k, v in fitted.arrays.items()})


def shifted_bank() -> RayDataset:
    """Photos of the box as if it stood 0.08 further along -x: each taken by a camera so much further along +x."""
    images = []
    for camera in dome(10, 1):
        pose = camera.world_from_camera.copy()
        pose[0, 3] += 0.08
        images.append(box_photo(replace(camera, world_from_camera=pose)))
    return RayDataset(dome(10, 1), images)


def deformation() -> Deformation:
    return Deformation.create(np.random.default_rng(0), frequencies=2, width=16)


def test_a_step_goes_down_the_gradient_that_the_grid_was_given(scene):
    """Every vertex is asked to move along +x: it does, and along nothing else; a weight on |D| holds it back."""
    moved = []
    for weight in (0.0, 10.0):
        deformer = Deformer(scene(), deformation(), dome(4, 1), 8, 0, 2)
        for _ in range(20):
            deformer.gradients.reshape(2, -1, 3)[0, :, 0] = -1e-3
            deformer.step(1e-3, weight)
        moved.append(deformer.field.displacement.reshape(-1, 3).mean(0))
    assert moved[0][0] > 1e-4 and np.abs(moved[0][1:]).max() < 0.2 * moved[0][0]
    assert moved[1][0] < 0.5 * moved[0][0]


def test_a_field_that_is_deformed_already_is_moved_from_where_it_rests(scene):
    """Moved by some cells and taken up again, as a stylization does: occupied is what was, not what is moved twice."""
    first = Deformer(scene(), deformation(), dome(4, 1), 8, 0, 1)
    values = first.values()
    values[-3:] = 2.0, 0.0, -2.0  # the last layer's biases: everything by 0.034 of the cube
    first.take(values)
    moved = first.field.occupancy
    assert (moved.distances != first.rest.distances).any()
    again = Deformation.restore(deformation().describe(), values)
    second = Deformer(first.field, again, dome(4, 1), 8, 0, 1)
    np.testing.assert_array_equal(second.rest.distances, first.rest.distances)
    np.testing.assert_array_equal(second.field.occupancy.distances, moved.distances)


def test_where_it_has_left_the_numbers_nothing_is_looked_for(scene):
    deformer = Deformer(scene(), deformation(), dome(4, 1), 8, 0, 1)
    before = deformer.field.occupancy.distances.copy()
    deformer._set(np.full_like(deformer.values(), np.nan))
    deformer.look()
    np.testing.assert_array_equal(deformer.field.occupancy.distances, before)


def test_gradient_reaches_the_network_exactly(scene):
    deformer = Deformer(scene(), deformation(), dome(4, 1), 6, 0, 1)
    random = np.random.default_rng(3)
    deformer.deformation.values[-40:] = random.normal(scale=0.1, size=40)
    deformer.bake()
    given = random.normal(size=6**3 * 3).astype(np.float32)
    values = torch.from_numpy(deformer.deformation.values).double().requires_grad_()
    live = deformer.deformation.network(deformer._encoded.double(), values)
    loss = (deformer._extension.spread(live).flatten() * torch.from_numpy(given).double()).sum()
    loss = loss + 0.3 * (2 * live).square().sum(1).mean().sqrt()
    (wanted,) = torch.autograd.grad(loss, values)
    deformer.gradients[0] = given
    seen = {}
    deformer.adam.step = lambda rate: seen.update(found=deformer.adam.gradients[0].copy())
    deformer.step(1e-3, 0.3)
    np.testing.assert_allclose(seen["found"], wanted, rtol=1e-3, atol=1e-4)


def test_photos_pull_at_shapes_through_the_fields_color_map(scene):
    field = scene()
    field.color_map = MILD
    deformer = Deformer(field, deformation(), dome(4, 1), 6, 0, 1)
    error, drawn = PhotoError(deformer, 1.0, 0.0, 1), box_bank(4, 1).draw(256, np.random.default_rng(1), 4)[:3]
    way = np.random.default_rng(2).normal(size=deformer.grid.shape).astype(np.float32)
    error.learn(*drawn, np.full(256, 0.5, np.float32))
    errors = []
    for step in (1e-3, -1e-3):
        deformer.grid[:] = step * way
        errors.append(error.of(*drawn))
    assert float(deformer.gradients[0] @ way.ravel()) == pytest.approx((errors[0] - errors[1]) / 2e-3, rel=0.05)


def test_slopes_are_held_back_however_hard_the_loss_pulls(scene):
    """A loss that pulls both halves of the cube towards the middle, through each other."""
    steepest = {}
    for max_slope in (0.0, 0.4):
        deformer = Deformer(scene(), deformation(), dome(4, 1), 24, 0, 1)
        pull = np.zeros((24, 24, 24, 3), np.float32)
        pull[:12, ..., 0], pull[12:, ..., 0] = -1, 1  # dL/dD: D grows against it
        for step in range(200):
            deformer.gradients[0] = pull.ravel()
            deformer.step(2e-2 * 0.1 ** (step / 200), 0.0, max_slope=max_slope)
        close = deformer._extension.close.numpy()
        slopes = np.abs(np.diff(deformer.grid[..., 0], axis=0)) * 23
        steepest[max_slope] = slopes[close[1:] & close[:-1]].max()
    assert steepest[0.0] > 1.5 and 0.3 < steepest[0.4] < 0.9, steepest


def test_an_anchored_scene_that_is_pulled_as_a_whole_stays_where_it_is(scene):
    moved = {}
    for anchored in (False, True):
        deformer = Deformer(scene(), deformation(), dome(4, 1), 8, 0, 1, anchored=anchored)
        for _ in range(100):
            deformer.gradients[0] = -1.0
            deformer.step(1e-2, 0.0)
        moved[anchored] = float(deformer._moved.detach().mean(0).abs().max())
    assert moved[False] > 0.035 and moved[True] < 0.2 * moved[False]  # not 0: a hyperbolic tangent bounds D


def test_an_anchored_scene_bends_and_keeps_hidden_layers_in_place(scene):
    """Its halves are pulled apart, and both along x, which would slide it."""
    deformer = Deformer(scene(), deformation(), dome(4, 1), 8, 0, 1, anchored=True)
    before, hidden = deformer.values(), len(deformer.deformation.values) - deformer.deformation.last
    pull = np.full((8, 8, 8, 3), -1.0, np.float32)
    pull[:4, ..., 1], pull[4:, ..., 1] = 1, -1
    for _ in range(20):
        deformer.gradients[0] = pull.ravel()
        deformer.step(1e-2, 0.0)
    np.testing.assert_array_equal(deformer.values()[:hidden], before[:hidden])
    moved = deformer._moved.detach().numpy()
    assert np.ptp(moved[:, 1]) > 0.02 and np.abs(moved.mean(0)).max() < 0.05 * np.ptp(moved[:, 1])


def test_an_anchored_scene_is_resumed_where_it_was(scene):
    """After a checkpoint is restored, biases follow the weights from where they were."""
    pull = np.random.default_rng(5).normal(size=8**3 * 3).astype(np.float32)

    def taught(deformer: Deformer) -> Deformer:
        for _ in range(5):
            deformer.gradients[0] = pull
            deformer.step(1e-2, 0.0)
        return deformer

    first = taught(Deformer(scene(), deformation(), dome(4, 1), 8, 0, 1, anchored=True))
    again = Deformer(scene(), deformation(), dome(4, 1), 8, 0, 1, anchored=True)
    again.restore({name: np.array(values, copy=True) for name, values in first.arrays().items()})
    np.testing.assert_array_equal(taught(again).grid, taught(first).grid)


def test_init_finds_a_shift_between_field_and_photos(scene):
    """The field cannot move, so the deformation has to."""
    fitter = DeformationFitter(scene(), deformation(), shifted_bank(), SETTINGS, 0, 2)
    fitter.run()
    assert fitter.state.best > fitter.state.before + 1.0
    assert fitter.quality() == pytest.approx(fitter.state.best, abs=1e-3)


def test_init_that_gains_nothing_stops_early_and_ends_no_worse(scene):
    settings = DeformSettings(steps=1000, rays=64, vertices=6, patience=10.0)
    fitter = DeformationFitter(scene(), deformation(), box_bank(), settings, 0, 2)
    fitter.run()
    assert fitter.state.step == 200
    assert fitter.quality() >= fitter.state.before - 1e-6


def test_a_deformation_that_views_kept_aside_do_not_ask_for_is_dropped(scene):
    """Without a shift there is nothing to gain; with one, three views kept aside gain about a decibel."""
    for bank, gone in ((box_bank(), True), (shifted_bank(), False)):
        given = deformation()
        fitter = DeformationFitter(scene(), given, bank, replace(SETTINGS, gate=0.8), 0, 2, 3)
        rest = given.values.copy()
        assert fitter.among == len(bank.cameras) - 3
        fitter.run()
        assert fitter.dropped == gone and np.array_equal(given.values, rest) == gone
        assert (np.abs(fitter.field.displacement).max() == 0) == gone
        expected = fitter.state.before if gone else fitter.state.best
        assert fitter.quality() == pytest.approx(expected, abs=1e-3)


def test_init_resumes_to_the_same_bits(scene):
    bank = shifted_bank()

    def fitter() -> DeformationFitter:
        return DeformationFitter(scene(), deformation(), bank, SETTINGS, 0, 2)

    whole, cut, again = fitter(), fitter(), fitter()
    whole.run()
    for _ in range(23):
        cut.step()
    again.resume(*saved(cut))
    again.run()
    np.testing.assert_array_equal(whole.deformer.deformation.values, again.deformer.deformation.values)
