"""The surface of a field lies where its density was put, in every space, and has the colors that renders show."""

from dataclasses import replace

import numpy as np
import pytest

from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.procedural.still_life import StillLife, dome_cameras
from stylerf.surfaces import field_surface as module
from stylerf.surfaces.field_surface import BEHIND, cell_size, field_surface, isosurface, seen_part, within_reach
from stylerf.surfaces.mesh import Mesh, without_small_pieces
from stylerf.surfaces.vertex_colors import vertex_colors
from stylerf.surfaces.visibility import DepthView
from tests.stylerf.surfaces.fields import RADIUS, ball, solid

BOX = SpaceWarp.box([-1, -1, -1], [1, 1, 1])


def around(count: int = 6, distance: float = 2.5) -> list[Camera]:
    eyes = distance * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0.1, 1], [0, 0.1, -1]])[:count]
    poses = [look_at(eye, np.zeros(3), np.array([0, 0, 1.0])) for eye in eyes]
    return [Camera(f"v{index}", 64, 64, 90, 90, 32, 32, pose) for index, pose in enumerate(poses)]


def test_the_surface_of_a_ball_is_where_half_of_the_light_is_lost():
    field, cameras = solid(ball, BOX), around()
    mesh, level = field_surface(field, cameras, 48, 1)
    assert 0.1 < level <= 0.9
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert abs(radii.mean() - RADIUS) < 2 / 48 and np.ptp(radii) < 1 / 48  # a cell is 2 / 48 wide


@pytest.mark.parametrize("kind", ["contraction", "frustum"])
def test_surfaces_in_warped_spaces_come_back_to_the_world(kind):
    if kind == "contraction":
        space, center = SpaceWarp.box([-1] * 3, [1] * 3, near=0.05, far=1e3, kind="contraction"), np.zeros(3)
        cameras = around()
    else:
        space, center = SpaceWarp.frustum(0.7, 0.7, 1.0, 1e4), np.array([0, 0, 2.5])
        cameras = [Camera("v", 64, 64, 60, 60, 32, 32, np.eye(4))]
    field = solid(lambda points: ball(points - center), space, 96)
    mesh = within_reach(field_surface(field, cameras, 64, 1)[0], space, 5.0)
    away = np.abs(np.linalg.norm(mesh.vertices - center, axis=1) - RADIUS)
    assert np.median(away) < 0.05 and len(mesh.faces) > 1000
    outward = (mesh.crosses() * (mesh.vertices[mesh.faces].mean(1) - center)).sum(1)
    assert (outward > 0).mean() > 0.98


def test_only_what_a_camera_sees_is_kept():
    field, cameras = solid(ball, BOX), around(1)
    mesh, _ = field_surface(field, cameras, 48, 1)
    views = [DepthView.of(field, cameras[0], 1)]
    seen = seen_part(mesh, views, field.space, BEHIND * cell_size(field.space, 48))
    # From (2.5, 0, 0) a ball of radius 0.5 is seen up to x = 0.5^2 / 2.5.
    assert -0.05 < seen.vertices[:, 0].min() < 0.2
    assert seen.areas().sum() == pytest.approx(2 * np.pi * RADIUS * (RADIUS - 0.1), rel=0.1)


def test_a_displaced_field_has_the_surface_that_is_rendered():
    """Every position reads 0.1 of the cube further along x, so that the ball appears 0.2 units to the left."""
    field = solid(ball, BOX)
    field.displacement = np.zeros((5, 5, 5, 3), np.float32)
    field.displacement[..., 0] = 0.1
    mesh, _ = field_surface(field, around(), 48, 1)
    np.testing.assert_allclose((mesh.vertices.min(0) + mesh.vertices.max(0)) / 2, [-0.2, 0, 0], atol=0.02)


def test_vertices_have_the_colors_of_their_places():
    field, cameras = solid(ball, BOX), around()
    mesh, _ = field_surface(field, cameras, 48, 1)
    views, tolerance = [DepthView.of(field, camera, 1) for camera in cameras], BEHIND * cell_size(field.space, 48)
    colors = vertex_colors(field, mesh.vertices, mesh.normals(), views, tolerance, 1)
    assert np.abs(colors - field.space.warp(mesh.vertices)).mean() < 0.05


def test_what_no_camera_sees_is_colored_along_its_normal():
    field, cameras = solid(ball, BOX), around(1)
    mesh = field_surface(field, cameras, 32, 1)[0]
    far = mesh.with_faces((mesh.vertices[mesh.faces][..., 0] < -0.3).all(1))
    colors = vertex_colors(field, far.vertices, far.normals(), [DepthView.of(field, cameras[0], 1)], 0.1, 1)
    assert np.abs(colors - field.space.warp(far.vertices)).mean() < 0.06


def test_the_still_life_is_within_half_a_percent_of_its_diagonal():
    life = StillLife(0)
    field = solid(life.distance, SpaceWarp.box([-1.25] * 3, [1.25] * 3), 96)
    cameras = [replace(one.scaled(0.5)) for one in dome_cameras(6, 96, "train", 0)]
    mesh, _ = field_surface(field, cameras, 96, 1)
    tolerance = BEHIND * cell_size(field.space, 96)
    seen = seen_part(mesh, [DepthView.of(field, one, 1) for one in cameras], field.space, tolerance)
    away = np.abs(life.distance(seen.vertices))
    assert len(seen.faces) > 10_000
    assert away.mean() / np.linalg.norm([2.5] * 3) < 0.005


def test_a_mesh_beyond_reach_is_cut():
    space = SpaceWarp.box([-1] * 3, [1] * 3, near=0.05, far=1e3, kind="contraction")
    mesh = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 4.0, 0], [0, 0, 9]]), np.array([[0, 1, 2], [0, 1, 3]]))
    assert len(within_reach(mesh, space, 5.0).faces) == 1


SIZE = np.array([33, 41, 37])


def soft_ball(points: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(40 * (np.linalg.norm(points - 0.5, axis=1) - 0.3)))


@pytest.mark.parametrize("planes", [2, 5, 33])
def test_a_ball_in_slabs_is_closed_and_faces_outward(monkeypatch, planes):
    monkeypatch.setattr(module, "POINTS_AT_ONCE", planes * 41 * 37)
    mesh = isosurface(soft_ball, SIZE, 0.5)
    radii = np.linalg.norm(mesh.vertices - 0.5, axis=1)
    np.testing.assert_allclose(radii, 0.3, atol=1e-3)
    # Euler's characteristic of a sphere: every edge has two faces, so edges = 3/2 faces.
    assert len(mesh.vertices) - len(mesh.faces) / 2 == 2
    assert (mesh.crosses() * (mesh.vertices[mesh.faces].mean(1) - 0.5)).sum(1).min() >= 0
    assert mesh.areas().sum() == pytest.approx(4 * np.pi * 0.09, rel=0.01)
    np.testing.assert_allclose((mesh.normals() * (mesh.vertices - 0.5)).sum(1), 0.3, atol=0.005)


def test_slabs_do_not_change_the_surface(monkeypatch):
    whole = isosurface(soft_ball, SIZE, 0.3)
    monkeypatch.setattr(module, "POINTS_AT_ONCE", 1)
    parts = isosurface(soft_ball, SIZE, 0.3)
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
