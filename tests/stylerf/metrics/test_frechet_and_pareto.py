"""Frechet distance of features by scipy and in closed form; Pareto fronts by brute force."""

import numpy as np
import pytest
from scipy.linalg import sqrtm

from stylerf.errors import InvalidValue
from stylerf.metrics.frechet import Moments, frechet_squared, moments
from stylerf.metrics.pareto import pareto_front


def test_frechet_is_scipys_matrix_root():
    random = np.random.default_rng(0)
    a, b = random.standard_normal((400, 7)), random.standard_normal((300, 7)) @ random.standard_normal((7, 7)) + 0.3
    first, second = (np.cov(rows.T, bias=True) for rows in (a, b))
    shift = a.mean(0) - b.mean(0)
    wanted = shift @ shift + np.trace(first + second - 2 * np.real(sqrtm(first @ second)))
    assert frechet_squared(moments(a), moments(b)) == pytest.approx(wanted, rel=1e-9)
    assert frechet_squared(moments(a), moments(a[::-1])) == pytest.approx(0, abs=1e-9)


def test_frechet_of_gaussians_that_differ_by_scale_is_known():
    first = Moments(np.array([1.0, 2.0]), np.diag([4.0, 9.0]))
    second = Moments(np.array([4.0, 6.0]), np.diag([1.0, 25.0]))
    assert frechet_squared(first, second) == pytest.approx(25 + (2 - 1) ** 2 + (3 - 5) ** 2)
    flat = Moments(np.zeros(2), np.zeros((2, 2)))  # fewer positions than channels: rank deficient
    assert frechet_squared(flat, Moments(np.zeros(2), np.eye(2))) == pytest.approx(2)


def test_what_is_no_set_of_vectors_is_refused():
    for bad in (np.zeros(3), np.zeros((0, 3)), np.full((2, 3), np.inf)):
        with pytest.raises(InvalidValue):
            moments(bad)
    with pytest.raises(InvalidValue):
        frechet_squared(moments(np.zeros((2, 3))), moments(np.zeros((2, 4))))


@pytest.mark.parametrize("higher", [True, False])
def test_the_front_is_that_of_all_comparisons(higher):
    random = np.random.default_rng(3)
    for _ in range(50):
        costs, figures = random.integers(0, 6, (2, 12)).tolist()  # many equal ones

        def beats(i, j, costs=costs, figures=figures):
            no_worse = figures[i] >= figures[j] if higher else figures[i] <= figures[j]
            better = costs[i] < costs[j] or figures[i] != figures[j]
            return costs[i] <= costs[j] and no_worse and better

        wanted = {j for j in range(12) if not any(beats(i, j) for i in range(12))}
        found = pareto_front(costs, figures, higher)
        assert set(found) == wanted and [costs[i] for i in found] == sorted(costs[i] for i in found)
    assert pareto_front([], [], higher) == []
    with pytest.raises(InvalidValue):
        pareto_front([1.0], [], higher)
