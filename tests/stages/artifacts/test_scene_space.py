"""Which warp of space a scene gets, and what part of the scene it serves best."""

from types import SimpleNamespace

import numpy as np
import pytest

from schemas.scene import Bounds
from stages.artifacts.scene_space import FOCUS, space_of
from stylerf.geometry.cameras import Camera


def scene(layout: str, centers, box=((-1, -1, -1), (1, 1, 1)), near: float = 0.5) -> SimpleNamespace:
    cameras = []
    for place, center in enumerate(centers):
        pose = np.eye(4)
        pose[:3, 3] = center
        cameras.append(Camera(f"c{place}", 40, 30, 40.0, 40.0, 20.0, 15.0, pose))
    about = SimpleNamespace(layout_reason="made up")
    return SimpleNamespace(layout=layout, scene=about, cameras=cameras, bounds=Bounds(box, near, 10.0))


def test_half_the_cube_of_an_unbounded_scene_covers_the_cameras_focus():
    space, _ = space_of(scene("unbounded", [(0, 0, -1), (1, 0, 0)]), "auto")
    assert space.kind == "contraction" and 0 < FOCUS < 1
    np.testing.assert_allclose(space.warp([[FOCUS, 0, 0], [-FOCUS, 0, FOCUS]]), [[0.75, 0.5, 0.5], [0.25, 0.5, 0.75]])


def test_an_object_contracted_keeps_its_whole_box():
    space, _ = space_of(scene("object", [(0, 0, -3)], ((-2, -1, -1), (2, 1, 1))), "contraction")
    np.testing.assert_allclose(space.warp([[2, 0, 0], [0, 1, 0]]), [[0.75, 0.5, 0.5], [0.5, 0.75, 0.5]])


def test_a_frustum_knows_how_far_its_views_are_apart():
    space, _ = space_of(scene("forward", [(-0.1, 0, 0), (0.2, 0.1, 0.7)]), "auto")
    assert space.kind == "frustum" and space.parameters[3] == pytest.approx(0.3 / 0.5)
