"""Isosurfaces in slabs are those of the whole grid: closed, outward, and where the density says."""

import numpy as np
import pytest

from stylerf.surfaces import isosurface as module
from stylerf.surfaces.isosurface import isosurface
from stylerf.surfaces.mesh import Mesh, without_small_pieces

SIZE = np.array([33, 41, 37])


def ball(points: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(40 * (np.linalg.norm(points - 0.5, axis=1) - 0.3)))


@pytest.mark.parametrize("planes", [2, 5, 33])
def test_a_ball_in_slabs_is_closed_and_faces_outward(monkeypatch, planes):
    monkeypatch.setattr(module, "POINTS_AT_ONCE", planes * 41 * 37)
    mesh = isosurface(ball, SIZE, 0.5)
    radii = np.linalg.norm(mesh.vertices - 0.5, axis=1)
    np.testing.assert_allclose(radii, 0.3, atol=1e-3)
    # Euler's characteristic of a sphere: every edge has two faces, so edges = 3/2 faces.
    assert len(mesh.vertices) - len(mesh.faces) / 2 == 2
    assert (mesh.crosses() * (mesh.vertices[mesh.faces].mean(1) - 0.5)).sum(1).min() >= 0
    assert mesh.areas().sum() == pytest.approx(4 * np.pi * 0.09, rel=0.01)
    np.testing.assert_allclose((mesh.normals() * (mesh.vertices - 0.5)).sum(1), 0.3, atol=0.005)


def test_slabs_do_not_change_the_surface(monkeypatch):
    whole = isosurface(ball, SIZE, 0.3)
    monkeypatch.setattr(module, "POINTS_AT_ONCE", 1)
    parts = isosurface(ball, SIZE, 0.3)
    assert len(parts.faces) == len(whole.faces)
    np.testing.assert_allclose(np.sort(parts.vertices, axis=0), np.sort(whole.vertices, axis=0), atol=1e-6)


def test_nothing_dense_has_no_surface():
    assert len(isosurface(lambda points: np.zeros(len(points), np.float32), SIZE, 0.5).faces) == 0


def test_small_pieces_are_removed_with_their_vertices():
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    mesh = Mesh(np.concatenate([triangle * 0.01 + 5, triangle]), np.array([[0, 1, 2], [3, 4, 5]]))
    kept = without_small_pieces(mesh, 1e-3)
    np.testing.assert_array_equal(kept.vertices, triangle)
    np.testing.assert_array_equal(kept.faces, [[0, 1, 2]])
    assert len(without_small_pieces(mesh, 1e-5).faces) == 2
