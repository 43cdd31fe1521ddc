"""Masks of regions: the part of a pixel's opacity that lies in marked cells, from the samples of the picture itself."""

import numpy as np
import pytest

from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering import view as module
from stylerf.rendering.view import render_view
from tests.stylerf.rendering.test_view import BOX, camera
from tests.stylerf.small import SPACES, density, field_of, hash_color


def half(axis: int, cells: int = 8) -> np.ndarray:
    """The upper half of the cube along one axis."""
    return np.indices((cells,) * 3)[axis] >= cells // 2


def test_a_mask_is_the_sum_of_weights_in_its_cells_and_changes_no_picture():
    field, odd = field_of(BOX, 1, hash_color(2)), np.random.default_rng(0).random((5, 5, 5)) < 0.4
    plain = render_view(field, camera(), threads=1)
    assert plain.masks == {}
    regions = {"odd": odd, "rest": ~odd}
    seen = render_view(field, camera(), threads=2, rays_at_once=50, regions=regions)
    for name in ("rgb", "alpha", "ray_distance", "z"):
        assert np.array_equal(getattr(seen, name), getattr(plain, name))
    origins, directions = camera().rays()
    samples = field.march(Rays.of(origins, directions, field.space.near), SAMPLES_PER_RAY, 1e-3, 1)
    for ray in range(0, len(origins), 7):
        expected = 0.0
        for k in range(samples.starts[ray], samples.ends[ray]):
            x, y, z = (int(v * np.float32(5)) for v in samples.x[k])
            expected += float(samples.weights[k]) * odd[x, y, z]
        row, column = divmod(ray, 13)
        assert seen.masks["odd"][row, column] == pytest.approx(expected, abs=1e-6)
    np.testing.assert_allclose(seen.masks["odd"] + seen.masks["rest"], seen.alpha, atol=1e-6)
    assert ((seen.masks["odd"] > 0.05) & (seen.masks["rest"] > 0.05)).any()


def test_half_a_solid_box_is_half_its_front():
    field = field_of(BOX, 1, hash_color(2), step=1 / 50)
    field.density = density(0, size=(2, 2, 2))
    field.density.values[:-1], field.density.values[-1] = 0, 12
    seen = render_view(field, camera(center=(4.0, 0, 0), focal=20), threads=1, regions={"up": half(2)})
    # z is up, and row 4 looks along the plane between the halves.
    assert (seen.alpha == 1).all() and (seen.masks["up"][:4] == 1).all() and not seen.masks["up"][5:].any()


def test_the_near_half_of_even_fog_hides_what_the_fog_law_says():
    """Three optical depths over the whole box: the half next to the camera takes 1 - exp(-1.5), the other the rest."""
    field = field_of(BOX, 1, hash_color(2), step=1 / 400)
    field.density = density(0, size=(2, 2, 2))
    field.density.values[:-1], field.density.values[-1] = 0, np.log(0.03)
    view = camera(center=(4.0, 0, 0), width=1, height=1, focal=20)
    seen = render_view(field, view, threads=1, min_transmittance=0.0, regions={"near": half(0), "far": ~half(0)})
    assert seen.masks["near"][0, 0] == pytest.approx(1 - np.exp(-1.5), rel=2e-3)
    assert seen.masks["far"][0, 0] == pytest.approx(np.exp(-1.5) - np.exp(-3), rel=5e-3)


def test_views_are_marched_once_however_many_regions_they_show(monkeypatch):
    field, real, marched = field_of(BOX, 1, hash_color(2)), module.render_rays, []
    monkeypatch.setattr(module, "render_rays", lambda *a, **k: marched.append(len(a[1].origins)) or real(*a, **k))
    monkeypatch.setattr(type(field), "march", counting(type(field).march, marched))
    render_view(field, camera(), threads=1, regions={str(axis): half(axis) for axis in range(3)})
    assert marched == [117, "march"]


def counting(march, calls: list):
    def counted(*arguments):
        calls.append("march")
        return march(*arguments)

    return counted


def test_the_backdrop_of_a_contraction_counts_to_the_cell_it_lies_in():
    space = SPACES["contraction"]
    assert isinstance(space, SpaceWarp)
    field = field_of(space, 1, hash_color(2))
    field.density.values[-1] = -30  # nothing but the background
    seen = render_view(field, camera(), threads=1, regions={"all": np.ones((4, 4, 4), bool), "up": half(2, 4)})
    assert (seen.alpha > 0.99).all() and np.array_equal(seen.masks["all"], seen.alpha)
    assert 0 < (seen.masks["up"] > 0.5).sum() < seen.alpha.size
