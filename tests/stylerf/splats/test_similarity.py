"""Splats in other coordinates look the same from a camera that moved along."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from stylerf.geometry.scene_normalization import moved
from stylerf.splats.rasterizer import splat
from stylerf.splats.similarity import moved_gaussians
from tests.stylerf.splats.reference import camera, random_gaussians


def test_moved_splats_look_the_same_to_a_moved_camera():
    gaussians, view = random_gaussians(80, 9), camera()
    similarity = np.eye(4)
    similarity[:3, :3] = 2.5 * Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()
    similarity[:3, 3] = [3, -1, 7]
    there = replace(view, world_from_camera=moved(view.world_from_camera, similarity))
    here = splat(gaussians, view, near=0.1, threads=1).image
    found = splat(moved_gaussians(gaussians, similarity), there, near=0.25, threads=1).image
    np.testing.assert_allclose(found, here, atol=2e-3)
    assert here[..., 3].max() > 0.9


def test_not_moving_changes_nothing():
    gaussians = random_gaussians(20, 4)
    same = moved_gaussians(gaussians, np.eye(4))
    np.testing.assert_allclose(same.harmonics, gaussians.harmonics, atol=1e-5)
    np.testing.assert_allclose(same.centers, gaussians.centers, atol=1e-6)
