"""Optimization brings splats to their pictures, and keeps them compact."""

import numpy as np

from stylerf.splats.optimization import FAINTEST, LONGEST, WIDEST, SplatOptimizer
from stylerf.splats.rasterizer import splat
from tests.stylerf.splats.reference import camera, random_gaussians

VIEWS = [camera(center) for center in ((0.3, -2.2, 0.5), (2.2, 0.2, 0.4), (-1.6, 1.5, 0.6), (0.1, 1.9, -1.2))]


def pictures_of(gaussians) -> list[np.ndarray]:
    return [splat(gaussians, view, near=0.1, threads=1).image for view in VIEWS]


def optimized(start, steps: int, threads: int = 2) -> SplatOptimizer:
    targets = pictures_of(random_gaussians(40, 1))
    optimizer = SplatOptimizer(start, 0.1, threads)
    for step in range(steps):
        optimizer.step(VIEWS[step % 4], targets[step % 4], step / steps)
    return optimizer


def perturbed():
    start, generator = random_gaussians(40, 1), np.random.default_rng(3)
    start.centers[:] += generator.normal(0, 0.03, start.centers.shape)
    start.harmonics[:] = 0
    start.logits[:] = 0
    return start


def test_error_falls_by_a_factor_of_ten():
    targets, start = pictures_of(random_gaussians(40, 1)), perturbed()

    def error(gaussians) -> float:
        return float(np.mean([(a - b) ** 2 for a, b in zip(pictures_of(gaussians), targets, strict=True)]))

    assert error(optimized(start, 120).gaussians) < 0.1 * error(start)


def test_two_runs_are_the_same_bits_with_any_threads():
    one, other = optimized(perturbed(), 12, 1).result(), optimized(perturbed(), 12, 3).result()
    assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_no_needles_no_giants_and_nothing_too_faint_is_left():
    start = perturbed()
    start.log_scales[:] = [-2.0, -6.0, -6.0]  # needles
    start.logits[:5] = -9
    result = optimized(start, 8).result()
    scales = np.sort(np.exp(result.log_scales), 1)
    assert (scales[:, 2] <= 1.001 * LONGEST * scales[:, 1]).all()
    assert (scales[:, 2] <= 1.001 * WIDEST * np.exp(-2)).all()
    assert len(result.centers) <= 35 and (1 / (1 + np.exp(-result.logits)) > FAINTEST).all()
    np.testing.assert_allclose(np.linalg.norm(result.quaternions, axis=1), 1, atol=1e-5)
