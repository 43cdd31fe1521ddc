"""Learning a deformation: gradients through the grid, init on photos, what a stylisation does to shapes."""

import numpy as np
import pytest
import torch

from stylerf.fields.deformation import Deformation
from stylerf.training.deform import DeformationFitter, DeformSettings
from stylerf.training.deformer import Deformer
from stylerf.training.rays import RayBank
from tests.stylerf.training.tiny import box_cameras, box_field, box_images

SETTINGS = DeformSettings(steps=60, rays=256, vertices=8, rate=3e-3, smoothness=0.01, patience=0.0, background=1.0)


def deformation(seed=0) -> Deformation:
    return Deformation.create(np.random.default_rng(seed), frequencies=2, width=16)


def test_a_step_goes_down_the_gradient_that_the_grid_was_given():
    """Every vertex is asked to move along +x: it does, and along nothing else; a weight on |D| holds it back."""
    moved = []
    for weight in (0.0, 10.0):
        deformer = Deformer(box_field(), deformation(), box_cameras(), 8, 0, 2)
        for _ in range(20):
            deformer.gradients.reshape(2, -1, 3)[0, :, 0] = -1e-3
            deformer.step(1e-3, weight)
        moved.append(deformer.field.displacement.reshape(-1, 3).mean(0))
    assert moved[0][0] > 5e-4 and np.abs(moved[0][1:]).max() < 0.2 * moved[0][0]
    assert moved[1][0] < 0.5 * moved[0][0]


def test_gradient_reaches_the_network_exactly():
    deformer = Deformer(box_field(), deformation(), box_cameras(), 6, 0, 1)
    random = np.random.default_rng(3)
    deformer.deformation.values[-40:] = random.normal(scale=0.1, size=40)
    deformer.bake()
    given = random.normal(size=6**3 * 3).astype(np.float32)
    values = torch.from_numpy(deformer.deformation.values).double().requires_grad_()
    live = deformer.deformation.network(deformer._encoded.double(), values)
    loss = (live[deformer._nearest].flatten() * torch.from_numpy(given).double()).sum()
    loss = loss + 0.3 * (2 * live).square().sum(1).mean().sqrt()
    (wanted,) = torch.autograd.grad(loss, values)
    deformer.gradients[0] = given
    seen = {}
    deformer.adam.step = lambda rate: seen.update(found=deformer.adam.gradients[0].copy())
    deformer.step(1e-3, 0.3)
    np.testing.assert_allclose(seen["found"], wanted, rtol=1e-3, atol=1e-4)


def test_init_finds_a_shift_between_field_and_photos():
    """Photos of the box a little to one side: the field cannot move, so the deformation has to."""
    shifted = box_images(shift=0.04)
    bank = RayBank(box_cameras(), shifted)
    fitter = DeformationFitter(box_field(), deformation(), bank, SETTINGS, 0, 2)
    fitter.run()
    assert fitter.state.best > fitter.state.before + 0.5
    assert fitter.quality() == pytest.approx(fitter.state.best, abs=1e-3)


def test_init_that_gains_nothing_stops_early_and_ends_no_worse_than_it_began():
    bank = RayBank(box_cameras(), box_images())
    settings = DeformSettings(steps=1000, rays=64, vertices=6, patience=10.0)
    fitter = DeformationFitter(box_field(), deformation(), bank, settings, 0, 2)
    fitter.run()
    assert fitter.state.step == 200
    assert fitter.quality() >= fitter.state.before - 1e-6


def test_init_resumes_to_the_same_bits():
    bank = RayBank(box_cameras(), box_images(shift=0.04))

    def fitter():
        return DeformationFitter(box_field(), deformation(), bank, SETTINGS, 0, 2)

    whole, cut, again = fitter(), fitter(), fitter()
    whole.run()
    for _ in range(23):
        cut.step()
    again.resume(*cut.checkpoint())
    again.run()
    np.testing.assert_array_equal(whole.deformer.deformation.values, again.deformer.deformation.values)
