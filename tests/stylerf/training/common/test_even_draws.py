"""Draws that are uniform, repeatable, and evener than independent ones, in whole and in any run."""

import numpy as np
import pytest

from stylerf.training.common.even_draws import drawn_evenly


@pytest.mark.parametrize("below", [1, 7, 1 << 20, 3_000_000_019])
def test_draws_lie_in_their_range_and_have_the_mean_of_a_uniform_one(below):
    drawn = drawn_evenly(100_000, below, np.random.default_rng(0))
    assert drawn.dtype == np.int64 and 0 <= drawn.min() and drawn.max() < below
    assert abs(drawn.mean() - (below - 1) / 2) <= 1e-4 * below
    assert len(drawn_evenly(0, below, np.random.default_rng(0))) == 0


def test_every_integer_is_as_likely_whatever_its_place_in_the_batch():
    firsts = np.array([drawn_evenly(3, 10, np.random.default_rng(seed)) for seed in range(4000)])
    for place in range(3):
        shares = np.bincount(firsts[:, place], minlength=10) / 4000
        np.testing.assert_allclose(shares, 0.1, atol=0.02)


@pytest.mark.parametrize("run", [slice(None), slice(0, 500), slice(1500, 2000)])
def test_any_run_of_draws_is_evener_than_independent_ones(run):
    drawn = drawn_evenly(5000, 1_000_000, np.random.default_rng(1))[run]
    counts = np.histogram(drawn, 100, (0, 1_000_000))[0]
    assert counts.std() < 0.3 * np.sqrt(len(drawn) / 100)  # of independent draws


def test_gaps_are_of_three_lengths_at_most():
    drawn = np.sort(drawn_evenly(1000, 1 << 40, np.random.default_rng(2)))
    gaps = np.diff(drawn)
    lengths = 1 + (np.diff(np.sort(gaps)) > 1000).sum()  # equal but for rounding
    assert lengths <= 3 and gaps.max() < 3 * gaps.min()


def test_the_start_is_the_generators():
    one, same, other = (drawn_evenly(50, 1000, np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert np.array_equal(one, same) and not np.array_equal(one, other)


def test_draws_continue_those_of_a_generator_in_the_same_state():
    parts = [drawn_evenly(count, 10_000, np.random.default_rng(4), at) for at, count in ((0, 300), (300, 500))]
    assert np.array_equal(np.concatenate(parts), drawn_evenly(800, 10_000, np.random.default_rng(4)))
    late = drawn_evenly(1000, 1_000_000, np.random.default_rng(4), 10**11)  # after hours on a GPU
    assert np.histogram(late, 100, (0, 1_000_000))[0].std() < 1
