"""The opacity prior: its gradient by differences, and that it clears haze and leaves solids."""

import numpy as np

from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.fit.engine import coverage_gradient, opacity_gradient
from tests.stylerf.training.fit.test_visual_hull import ball_photo
from tests.stylerf.training.scenes import LEVELS, box_bank, box_fitter, dome


def test_the_gradient_is_that_of_the_stated_loss():
    alpha = np.linspace(0.02, 0.98, 25)

    def loss(values: np.ndarray) -> float:
        return 0.3 * float((4 * values * (1 - values)).sum()) / 40

    found = opacity_gradient(alpha.astype(np.float32), 0.3, 40)
    for place in range(25):
        step = np.zeros(25)
        step[place] = 1e-6
        expected = (loss(alpha + step) - loss(alpha - step)) / 2e-6
        assert abs(found[place] - expected) < 1e-6
    assert opacity_gradient(np.float32([0.5]), 1.0, 1)[0] == 0 and found.dtype == np.float32


def test_rays_of_a_fit_are_clear_or_opaque():
    """A box seen by three views: with the prior less haze is left on rays that no view has seen."""
    bank = box_bank(10)
    haze = []
    for weight in (0.0, 0.05):
        fitter = box_fitter(
            250, held_out=7, bank=bank, levels=LEVELS[-1:], level_ends=(), held_out_until=1.0, opacity=weight
        )
        fitter.run()
        alpha = seen(fitter)
        haze.append(float((4 * alpha * (1 - alpha)).mean()))
        assert alpha.max() > 0.9  # the box is still there
    assert haze[1] < 0.8 * haze[0]


def seen(fitter) -> np.ndarray:
    """Opacity of the held-out rays."""
    from stylerf.kernels.cpu.ray_samples import Rays
    from stylerf.rendering.rays import render_rays

    origins, directions = fitter.held_out_rays.rays[:2]
    rays = Rays.of(origins[:4096], directions[:4096], fitter.field.space.near)
    return np.clip(render_rays(fitter.field, rays, threads=1).out[:, 3], 0, 1)


def test_coverage_has_the_mean_gradient_of_random_backgrounds():
    generator = np.random.default_rng(0)
    alpha, wanted = generator.random((2, 9)).astype(np.float32)
    backgrounds = generator.random(400_000)
    for a, w in zip(alpha, wanted):
        # Colors met exactly: what differs is how much background shows, d/da of its squared error, its mean over gray.
        noisy = np.mean(2 * np.square(backgrounds) * (a - w)) - 2 * 0.25 * (a - w)
        assert abs(coverage_gradient(np.float32([a]), np.float32([w]), 1 / 12, 1)[0] - noisy) < 1e-3


def test_pale_matter_is_reported_from_a_white_background():
    """A pale ball before white: where colors alone are asked for, half a ball is nearly as good as a whole one."""
    cameras = dome(8, 1, 24)
    bank = RayDataset(cameras, [np.maximum(ball_photo(camera), np.uint8([200, 200, 200, 0])) for camera in cameras])
    covered, errors = [], []
    for weight in (0.0, 0.1):
        fitter = box_fitter(300, bank=bank, levels=LEVELS[-1:], level_ends=(), held_out_until=1.0, coverage=weight)
        fitter.run()
        wanted, alpha = fitter.held_out_rays.rays[2][:4096, 3], seen(fitter)
        covered.append(float(alpha[wanted > 0.5].mean()))
        errors.append(float(np.square(alpha - wanted).mean()))
    assert covered[0] < 0.7 and covered[1] > 0.9
    assert errors[1] < 0.3 * errors[0]


def test_a_white_ball_that_is_missing_before_white_is_no_good_fit():
    cameras = dome(8, 1, 24)
    bank = RayDataset(cameras, [np.maximum(ball_photo(camera), np.uint8([255, 255, 255, 0])) for camera in cameras])
    missing = box_fitter(1, bank=bank)
    fitter = box_fitter(300, bank=bank, levels=LEVELS[-1:], level_ends=(), held_out_until=1.0, coverage=0.3)
    fitter.run()
    assert fitter.state.rollbacks == 0
    wanted, alpha = fitter.held_out_rays.rays[2][:4096, 3], seen(fitter)
    assert alpha[wanted > 0.5].mean() > 0.9 and fitter.held_out_psnr() > missing.held_out_psnr() + 6
