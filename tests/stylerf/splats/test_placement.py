"""Splats are placed on surfaces, flat along them, and more of them where pictures have detail."""

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.rendering.view import render_view
from stylerf.splats.placement import SurfacePoints, on_surfaces, picture_and_points, thinned
from stylerf.splats.views import views_to_learn
from tests.stylerf.small import density, field_of, hash_color
from tests.stylerf.splats.reference import camera

BOX = SpaceWarp.box([-1, -1, -1], [1, 1, 1])


def points_on_a_plane(count: int) -> SurfacePoints:
    """Of z = 0.3, with detail where x > 0."""
    generator = np.random.default_rng(0)
    xyz = generator.uniform(-0.9, 0.9, (count, 3)).astype(np.float32)
    xyz[:, 2] = 0.3
    ones = np.ones(count, np.float32)
    return SurfacePoints(xyz, np.stack([ones, 0 * ones, 0 * ones], 1), 0.8 * ones, (xyz[:, 0] > 0).astype(np.float32))


def solid_box():
    field = field_of(BOX, 1, hash_color(2), step=1 / 50)
    field.density = density(0, size=(2, 2, 2))
    field.density.values[:-1], field.density.values[-1] = 0, 12
    return field


def test_thinning_keeps_within_the_limit_and_prefers_detail():
    kept = thinned(points_on_a_plane(20000), BOX, 3000)
    assert 2000 < len(kept.centers) <= 3000
    detailed = (kept.centers[:, 0] > 0).sum()
    assert detailed > 1.5 * (len(kept.centers) - detailed)
    np.testing.assert_allclose(kept.centers[:, 2], 0.3, atol=1e-6)
    np.testing.assert_allclose(kept.colors, [[1, 0, 0]] * len(kept.colors), atol=1e-6)


def test_gaussians_lie_flat_on_the_surface():
    gaussians = on_surfaces(thinned(points_on_a_plane(20000), BOX, 3000), 1, 1)
    _, x, y, _ = gaussians.quaternions.T
    normal_z = 1 - 2 * (x * x + y * y)  # of the third axis, which is the thin one
    assert np.percentile(np.abs(normal_z), 1) > 0.999
    assert (gaussians.log_scales[:, 2] < gaussians.log_scales[:, 0] - 1).all()
    np.testing.assert_allclose(0.5 + 0.28209479 * gaussians.harmonics[:, 0], [[1, 0, 0]] * len(x), atol=1e-5)
    assert gaussians.harmonics.shape[1:] == (4, 3) and not gaussians.harmonics[:, 1:].any()


def test_points_lie_on_the_front_of_a_solid_box():
    field, view = solid_box(), camera(center=(0, -4, 0))
    picture, points = picture_and_points(field, view, 100.0, np.random.default_rng(0), 2)
    seen = render_view(field, view, threads=2)
    np.testing.assert_allclose(picture[..., :3], seen.rgb, atol=1e-6)
    assert len(points.centers) == (seen.alpha > 0.5).sum() > 100
    front = points.centers[np.abs(points.centers[:, 0]) < 0.9]
    np.testing.assert_allclose(front[:, 1], -1, atol=0.06)  # within a step and a half
    assert points.opacities.min() > 0.9


def test_a_field_without_surfaces_is_refused():
    nothing = SurfacePoints(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), *np.zeros((2, 0), np.float32))
    with pytest.raises(InvalidValue, match="shows nothing"):
        thinned(nothing, BOX, 1000)


def test_a_single_point_still_makes_a_gaussian():
    one = on_surfaces(SurfacePoints(*(values[:1] for values in vars(points_on_a_plane(1)).values())), 0, 1)
    assert len(one.centers) == 1 and all(np.isfinite(values).all() for values in one)


def test_views_are_the_cameras_and_one_between_each_two():
    cameras = [camera(center=(3 * np.cos(a), 3 * np.sin(a), 1)) for a in np.linspace(0, 5, 7)]
    views = views_to_learn(cameras)
    assert len(views) == 13 and sum(any(view is one for one in cameras) for view in views) == 7
    assert sum(any(view is one for one in cameras) for view in views[:4]) == 2
    assert len(views_to_learn(cameras[:1])) == 1
