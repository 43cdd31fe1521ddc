"""The rasterizer against every pixel of every Gaussian written out, and its gradients against automatic ones."""

import numpy as np
import pytest
import torch

from stylerf.kernels.cpu.splats import Gaussians
from stylerf.splats.rasterizer import splat, splat_backward
from tests.stylerf.splats.reference import camera, random_gaussians, splatted


@pytest.mark.parametrize("bands", [1, 4, 9])
def test_picture_and_gradients_are_those_of_the_written_out_formula(bands):
    gaussians, view = random_gaussians(60, bands), camera()
    drawn = splat(gaussians, view, near=0.1, threads=2)
    parameters = [torch.tensor(values, dtype=torch.float64, requires_grad=True) for values in gaussians]
    expected = splatted(parameters, view, 0.1)
    assert 0.2 < drawn.image[..., 3].mean() < 0.9
    np.testing.assert_allclose(drawn.image, expected.detach().numpy(), atol=3e-6)
    weights = np.random.default_rng(1).normal(size=drawn.image.shape)
    (expected * torch.tensor(weights)).sum().backward()
    gradients = Gaussians(*map(np.zeros_like, gaussians))
    splat_backward(gaussians, drawn, weights.astype(np.float32), gradients, 2)
    for name, found, parameter in zip(gaussians._fields, gradients, parameters, strict=True):
        assert np.abs(found).max() > 0.1, name
        # float32 sums over hundreds of pixels
        np.testing.assert_allclose(found, parameter.grad, atol=1e-5 * np.abs(found).max(), err_msg=name)


def test_gradient_of_the_opacity_is_the_slope_of_the_picture():
    gaussians, view = random_gaussians(5, 1), camera()
    weights = np.random.default_rng(2).normal(size=(view.height, view.width, 4)).astype(np.float32)

    def loss(logits: np.ndarray) -> float:
        image = splat(gaussians._replace(logits=logits.astype(np.float32)), view, near=0.1, threads=1).image
        return float((image.astype(np.float64) * weights).sum())

    gradients = Gaussians(*map(np.zeros_like, gaussians))
    gaussians.logits[:] = np.clip(gaussians.logits, -1, 1)
    drawn = splat(gaussians, view, near=0.1, threads=1)
    splat_backward(gaussians, drawn, weights, gradients, 1)
    for k in range(5):
        step = np.zeros(5)
        step[k] = 1e-2
        slope = (loss(gaussians.logits + step) - loss(gaussians.logits - step)) / 2e-2
        # Pixels that cross the least alpha of 1/255 make the picture jump a little.
        assert gradients.logits[k] == pytest.approx(slope, rel=0.05, abs=0.05)


def test_results_are_the_same_bits_for_any_number_of_threads():
    gaussians, view = random_gaussians(300, 4), camera()
    found = []
    for threads in (1, 2, 3):
        drawn = splat(gaussians, view, near=0.1, threads=threads)
        gradients = Gaussians(*map(np.zeros_like, gaussians))
        splat_backward(gaussians, drawn, drawn.image, gradients, threads)
        found.append((drawn.image, *gradients))
    assert all(np.array_equal(a, b) for other in found[1:] for a, b in zip(found[0], other, strict=True))


def test_what_is_behind_the_camera_or_outside_is_not_drawn():
    gaussians = random_gaussians(3, 1)
    gaussians.log_scales[:] = -3
    gaussians.logits[:] = 3
    gaussians.centers[:] = [[0.3, -2.4, 0.5], [30, 0, 0], [0.3, -2.15, 0.5]]  # behind, beside, nearer than near
    drawn = splat(gaussians, camera(), near=0.1, threads=1)
    assert not drawn.image.any() and not len(drawn.order)
    nothing = Gaussians(*(values[:0] for values in gaussians))
    assert not splat(nothing, camera(), near=0.1, threads=1).image.any()


def test_the_nearer_of_two_opaque_gaussians_hides_the_other():
    two = random_gaussians(2, 1)
    two.centers[:] = [[0, 0, 0], [0, -0.5, 0.1]]  # the second is in front
    two.log_scales[:], two.logits[:], two.harmonics[:] = -1, 9, 0
    two.harmonics[:, 0] = [[1.7, -1.7, -1.7], [-1.7, -1.7, 1.7]]
    pixel = splat(two, camera(), near=0.1, threads=1).image[19, 20]
    assert pixel[2] > 0.9 and pixel[0] < 0.05 and pixel[3] > 0.99
