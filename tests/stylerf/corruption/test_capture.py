"""Faults of cameras against what statistics, a plain loop and scipy say they are."""

import itertools

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from stylerf.corruption import capture
from stylerf.errors import InvalidValue
from stylerf.procedural.still_life import dome_cameras


def poses_of(count: int, seed: int = 0) -> np.ndarray:
    return np.array([camera.world_from_camera for camera in dome_cameras(count, 16, "v", seed)])


def test_pose_noise_has_the_requested_deviations_and_keeps_rotations():
    """4,000 cameras: the deviation of 12,000 components is known to 0.65 %, its third of each axis to 1.1 %."""
    poses = poses_of(4000)
    noisy = capture.noisy_poses(poses, 0.5, 0.01, np.random.default_rng(3))
    turns = Rotation.from_matrix(noisy[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1)).as_rotvec(degrees=True)
    moves = noisy[:, :3, 3] - poses[:, :3, 3]
    np.testing.assert_allclose(turns.std(0), 0.5, rtol=0.05)
    np.testing.assert_allclose(moves.std(0), 0.01 * 4.03, rtol=0.05)  # the dome's radius, its center is looked at
    assert np.abs(turns.mean(0)).max() < 0.03 and np.abs(moves.mean(0)).max() < 0.003
    assert abs(np.corrcoef(turns[:, 0], moves[:, 0])[0, 1]) < 0.06
    products = noisy[:, :3, :3] @ noisy[:, :3, :3].transpose(0, 2, 1)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), products.shape), atol=1e-12)
    np.testing.assert_array_equal(noisy[:, 3], poses[:, 3])
    again = capture.noisy_poses(poses, 0.5, 0.01, np.random.default_rng(3))
    np.testing.assert_array_equal(noisy, again)


def test_rotations_are_those_of_scipy_and_nothing_for_nothing():
    vectors = np.random.default_rng(0).normal(size=(50, 3))
    vectors[0] = 0
    np.testing.assert_allclose(capture.rotations(vectors), Rotation.from_rotvec(vectors).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("count", [3, 8, 12])
def test_fewer_views_are_as_many_and_spread_out(count):
    """The least distance of two is at least half the best of all choices (tried out whole for three)."""
    centers = poses_of(20, 1)[:, :3, 3]
    chosen = capture.spread_views(centers, count, np.random.default_rng(4))
    assert len(chosen) == len({*chosen}) == count and chosen == sorted(chosen)

    def least(some) -> float:
        return min(np.linalg.norm(centers[a] - centers[b]) for a, b in itertools.combinations(some, 2))

    random = np.random.default_rng(5)
    by_chance = [least(random.choice(20, count, replace=False)) for _ in range(200)]
    assert least(chosen) > np.median(by_chance)
    if count == 3:
        assert least(chosen) >= 0.5 * max(least(some) for some in itertools.combinations(range(20), 3))


def test_more_views_than_there_are_cannot_be_chosen():
    with pytest.raises(InvalidValue):
        capture.spread_views(np.eye(3), 4, np.random.default_rng(0))


def test_one_side_is_a_half_space_of_cameras():
    """Some plane has the kept on one side and the others on the other: a linear program finds it."""
    poses = poses_of(24, 2)
    kept = capture.one_sided(poses, 0.5, np.random.default_rng(6))
    centers = poses[:, :3, 3]
    others = [i for i in range(24) if i not in kept]
    assert len(kept) == 12
    rows = np.concatenate([-np.c_[centers[kept], np.ones(12)], np.c_[centers[others], np.ones(12)]])
    assert linprog(np.zeros(4), rows, -np.ones(24), bounds=[(None, None)] * 4).success
    assert len(capture.one_sided(poses[:4], 0.1, np.random.default_rng(0))) == 3


def test_the_box_and_the_near_plane():
    low, high = capture.cut_box(((-1, -2, -1), (1, 2, 3)), 0.5)
    assert low == (-1, -2, -1) and high == (1, 2, 1)
    assert capture.late_near(0.05, 1000.0, 0.5, 3.0) == 1.5
    assert capture.late_near(1.0, 1000.0, 0.5, 1.0) == 1.0 and capture.late_near(1.0, 2.0, 0.5, 10.0) == 1.8
