"""Adam against torch's, but for runs of eight that no gradient has touched."""

import numpy as np
import pytest
import torch

from stylerf.training.common.adam import BETA1, BETA2, EPSILON, NORM_STEPS, Adam, clipped


def gradients_of(step: int, length: int) -> np.ndarray:
    return np.random.default_rng([1, step]).normal(size=length).astype(np.float32)


@pytest.mark.parametrize("threads", [1, 3])
def test_steps_equal_torch_and_clear_the_buffers(threads):
    length, rates = 45, [0.1, 0.05, 0.02, 0.01]
    start = np.random.default_rng(0).normal(size=length).astype(np.float32)
    values = start.copy()
    adam = Adam(values, [(0, length, 1.0)], threads)
    leaf = torch.from_numpy(start.astype(np.float64)).requires_grad_()
    reference = torch.optim.Adam([leaf], lr=1.0, betas=(BETA1, BETA2), eps=EPSILON)
    for step, rate in enumerate(rates):
        gradient = gradients_of(step, length)
        shares = np.random.default_rng(2).dirichlet(np.ones(threads))
        adam.gradients[:] = shares[:, None] * gradient
        adam.step(rate)
        assert not adam.gradients.any()
        reference.param_groups[0]["lr"] = rate
        leaf.grad = torch.from_numpy(gradient.astype(np.float64))
        reference.step()
        np.testing.assert_allclose(values, leaf.detach(), atol=2e-6)


def test_runs_without_a_gradient_are_left_as_they_are_and_others_go_on():
    values = np.zeros(40, np.float32)
    adam = Adam(values, [(0, 40, 1.0)], 2)
    adam.gradients[0] = 1.0
    adam.step(0.1)
    kept = [array.copy() for array in (values, adam.first, adam.second)]
    adam.gradients[0, 3], adam.gradients[1, 21] = -2.0, 1e-30  # the runs 0..7 and 16..23
    adam.step(0.1)
    touched = np.zeros(40, bool)
    touched[0:8] = touched[16:24] = True
    for array, before in zip((values, adam.first, adam.second), kept):
        assert np.array_equal(array[~touched], before[~touched]) and (array[touched] != before[touched]).all()
    # In a touched run, elements whose own gradient is 0 go on by their momentum: m = 0.09, v = 0.0099.
    expected = -0.1 - 0.1 * (0.09 / (1 - 0.9**2)) / np.sqrt(0.0099 / (1 - 0.99**2))
    np.testing.assert_allclose(values[:8][np.arange(8) != 3], expected, rtol=1e-5)


def test_gradients_that_cancel_between_threads_count_as_touched():
    values = np.zeros(8, np.float32)
    adam = Adam(values, [(0, 8, 1.0)], 2)
    adam.gradients[0], adam.gradients[1] = 1.0, -1.0
    adam.first[:] = 1.0
    adam.second[:] = 1.0
    adam.step(0.1)
    assert (adam.first == np.float32(0.9)).all() and (values < 0).all() and not adam.gradients.any()


def test_groups_have_rates_of_their_own_and_odd_ends():
    values = np.zeros(21, np.float32)
    adam = Adam(values, [(0, 10, 1.0), (10, 21, 0.5)], 1)
    adam.gradients[:] = 3.0
    adam.step(0.2)
    np.testing.assert_allclose(values, [-0.2] * 10 + [-0.1] * 11, rtol=1e-5)  # the first step is the rate itself


def test_restored_moments_go_on_bit_by_bit():
    def three_more(adam):
        for step in range(3):
            adam.gradients[0] = gradients_of(step + 9, 19)
            adam.step(0.1)
        return adam.values.copy()

    adam = Adam(np.zeros(19, np.float32), [(0, 19, 1.0)], 1)
    three_more(adam)
    other = Adam(adam.values.copy(), [(0, 19, 1.0)], 1)
    other.restore({k: v.copy() for k, v in adam.arrays().items()})
    assert np.array_equal(three_more(adam), three_more(other)) and other.steps == 6


def test_a_skip_is_shortened_to_what_is_usual_and_the_direction_stays():
    """Gradients split over two threads; lengths by another norm."""
    whole = gradients_of(1, 30)
    parts = np.stack([0.25 * whole, 0.75 * whole])
    usual = clipped(parts, 2.0, 0.0, 0)
    assert usual == pytest.approx(np.linalg.norm(whole), rel=1e-5)  # the first sets it, and is not touched
    np.testing.assert_array_equal(parts[1], 0.75 * whole)
    skip = 50 * parts
    after = clipped(skip, 2.0, usual, NORM_STEPS)
    np.testing.assert_allclose(skip.sum(0), 2.0 * whole, rtol=1e-5)
    assert after == pytest.approx(0.9 * usual + 0.1 * 2.0 * usual, rel=1e-5)
    small = 1.5 * parts
    clipped(small, 2.0, usual, NORM_STEPS)
    np.testing.assert_array_equal(small, 1.5 * parts)
    nothing = np.zeros_like(parts)
    assert clipped(nothing, 2.0, usual, NORM_STEPS) == usual  # tells nothing of what is usual


def test_what_is_usual_is_learned_before_anything_is_shortened():
    """A first gradient of next to nothing, as of a network whose last layer begins at zero, holds no later one down."""
    usual, lengths = 0.0, [1e-4, *range(1, NORM_STEPS)]
    for step, length in enumerate(lengths):
        one = np.full((1, 4), length / 2, np.float32)
        usual = clipped(one, 2.0, usual, step)
        np.testing.assert_array_equal(one, np.float32(length / 2))
    assert usual == pytest.approx(np.mean(lengths), rel=1e-5)
    skip = np.full((1, 4), 50.0, np.float32)
    clipped(skip, 2.0, usual, NORM_STEPS)
    assert np.linalg.norm(skip) == pytest.approx(2 * usual, rel=1e-5)


def test_a_gradient_of_nan_is_no_step_and_without_a_clip_nothing_changes():
    one, other = (Adam(np.zeros(30, np.float32), [(0, 30, 1.0)], 2, clip) for clip in (3.0, 0.0))
    for step in range(5):
        for adam in (one, other):
            adam.gradients[0] = gradients_of(step, 30)  # of like lengths
            adam.step(0.1)
    np.testing.assert_array_equal(one.values, other.values)
    usual = one.running_norm
    one.gradients[1, 7] = np.nan
    one.step(0.1)
    assert np.isfinite(one.values).all() and np.isfinite(one.first).all() and one.running_norm == usual > 0
    again = Adam(one.values.copy(), [(0, 30, 1.0)], 2, 3.0)
    again.restore(one.arrays())
    assert (again.running_norm, again.steps) == (one.running_norm, 6)
    again.restore({**one.arrays(), "steps": np.asarray([4])})  # as checkpoints of before had it
    assert (again.running_norm, again.steps) == (0.0, 4)
