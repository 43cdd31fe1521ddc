"""Packed surfaces: the picture of a whole render within the rounding of positions; chosen pixels are the whole's."""

import numpy as np
import pytest

from stylerf.fields import packed_surface as module
from stylerf.fields.packed_surface import PackedSurface, cells_of, surface_of
from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.rendering.view import render_view
from stylerf.training.stylize.geometry import FixedGeometry
from tests.stylerf.small import SPACES, displacement_grid, field_of, float64, hash_color, oracle_color

BOX = SpaceWarp.box([-1, -1, -1], [1, 1, 1])
SHARE = 0.3


def camera(space: SpaceWarp = BOX) -> Camera:
    if space.kind == "frustum":
        return Camera("view", 13, 9, 14.0, 15.0, 6.5, 4.5, np.eye(4))
    pose = look_at(np.array([2.6, 0.9, 0.7]), np.zeros(3), np.array([0, 0, 1.0]))
    return Camera("view", 13, 9, 14.0, 15.0, 6.5, 4.5, pose)


def scene(space: SpaceWarp = BOX, **more):
    field = field_of(space, 1, hash_color(2), **more)
    field.weight_threshold = SHARE
    return field


CASES = {"box": (BOX, {}), "contraction": (SPACES["contraction"], {}), "frustum": (SPACES["frustum"], {})}
CASES["bent"] = BOX, {"displacement": displacement_grid(3)}


@pytest.mark.parametrize("name", CASES)
def test_a_surface_is_the_picture_of_the_whole_render(name):
    space, more = CASES[name]
    field, view = scene(space, **more), camera(space)
    whole = render_view(field, view, threads=1)
    geometry = FixedGeometry(field, [view], SHARE, 2)
    painted, _ = geometry.paint(0, np.arange(13 * 9))
    difference = np.abs(painted - whole.rgb.reshape(-1, 3))
    # A sixteen-bit step is 8e-6 of the cube, half of it the error; colors of the finest level (40 cells, values of
    # up to +-1.5) change by 30 a cube's width at most where eight levels do not conspire.
    assert 0 < difference.max() < 0.5 / 65535 * 3 * 100
    np.testing.assert_allclose(geometry.alpha(0), whole.alpha, atol=1e-6)
    assert (whole.alpha > 0.5).mean() > 0.2


def test_what_is_kept_equals_the_oracle_at_the_rounded_positions():
    field, view = scene(), camera()
    kept = surface_of(field, view, SHARE, 2)
    starts, ends, x, weights = kept.samples(np.arange(13 * 9))
    assert np.array_equal(np.rint(x * 65535).astype(np.uint16), kept.x) and len(x) > 100
    assert np.array_equal(starts[1:], ends[:-1])
    colors = oracle_color(field.color, float64(field.color.values), None, float64(x)).numpy()
    expected = [weights[a:b] @ colors[a:b] for a, b in zip(starts, ends)]
    painted, _ = FixedGeometry(field, [view], SHARE, 1).paint(0, np.arange(13 * 9))
    np.testing.assert_allclose(painted, expected, atol=1e-6)
    largest = np.array([weights[a:b].max() if b > a else 0 for a, b in zip(starts, ends)])
    smallest = np.array([weights[a:b].min() if b > a else 0 for a, b in zip(starts, ends)])
    assert (smallest >= SHARE * largest * (1 - 1e-6)).all()
    empty = starts == ends
    assert empty.any() and not kept.alpha.ravel()[empty].any() and (kept.alpha.ravel()[~empty] > 0).all()


def test_chosen_pixels_are_the_same_bits_as_in_the_whole():
    geometry = FixedGeometry(scene(), [camera()], SHARE, 1)
    whole, _ = geometry.paint(0, np.arange(13 * 9))
    for pixels in (np.array([], np.int64), np.array([60]), np.arange(5, 117, 4), np.array([70, 3, 70, 116, 0])):
        assert np.array_equal(geometry.paint(0, pixels)[0], whole[pixels])


def test_parts_and_chunks_make_the_same_surface(monkeypatch):
    field, view = scene(), camera()
    whole = surface_of(field, view, SHARE, 1)
    monkeypatch.setattr(module, "RAYS_AT_ONCE", 50)
    parts = surface_of(field, view, SHARE, 3)
    for name in ("offsets", "x", "weights", "alpha"):
        assert np.array_equal(getattr(parts, name), getattr(whole, name)), name


def test_teaching_chosen_pixels_is_teaching_their_part_of_the_whole():
    field, view = scene(), camera()
    geometry, gradients = FixedGeometry(field, [view], SHARE, 2), np.random.default_rng(4).normal(size=(117, 3))
    gradients = gradients.astype(np.float32)
    whole, parts = (np.zeros((2, len(field.color.values)), np.float32) for _ in range(2))
    geometry.learn(geometry.paint(0, np.arange(117))[1], gradients, whole)
    for part in np.array_split(np.arange(117), 4):
        geometry.learn(geometry.paint(0, part)[1], gradients[part], parts)
    largest = np.abs(whole.sum(0)).max()
    np.testing.assert_allclose(parts.sum(0), whole.sum(0), atol=1e-6 * largest)
    values = float64(field.color.values).requires_grad_()
    starts, ends, x, weights = geometry.surface(0).samples(np.arange(117))
    each = float64(np.repeat(gradients, ends - starts, axis=0) * weights[:, None])
    (oracle_color(field.color, values, None, float64(x)) * each).sum().backward()
    np.testing.assert_allclose(whole.sum(0), values.grad, atol=1e-5 * largest)


def test_views_beyond_the_memory_are_marched_again_and_look_the_same():
    field, views = scene(), [camera(), camera()]
    plenty, none = (FixedGeometry(field, views, SHARE, 1, memory) for memory in (1e8, 1))
    first = [one.surface(1) for one in (plenty, none)]
    assert none.surface(1) is first[1]  # the last view's is kept
    for one in (plenty, none):
        one.surface(0)
    assert plenty.surface(1) is first[0] and none.surface(1) is not first[1]
    assert np.array_equal(plenty.paint(1, np.arange(117))[0], none.paint(1, np.arange(117))[0])


def wall(height: int, width: int, apart: tuple[float, float], alpha: np.ndarray) -> PackedSurface:
    """A wall seen head on, two samples a pixel that average to a grid of points `apart` across and down."""
    down, across = np.mgrid[:height, :width]
    points = np.stack([0.1 + across * apart[0], 0.2 + down * apart[1], np.full(across.shape, 0.5)], -1).reshape(-1, 3)
    pair = np.stack([points - [0, 0, 0.02], points + [0, 0, 0.01]], 1).reshape(-1, 3)  # weights 1 : 2
    weights = (alpha.ravel()[:, None] * [1 / 3, 2 / 3]).ravel().astype(np.float32)
    offsets = np.arange(height * width + 1, dtype=np.int64) * 2
    return PackedSurface(offsets, np.rint(pair * 65535).astype(np.uint16), weights, alpha)


def test_cells_are_as_wide_as_a_pixel_sees_by_its_finer_side():
    alpha = np.ones((20, 30), np.float32)
    assert cells_of(wall(20, 30, (1 / 64, 1 / 40), alpha)) == pytest.approx(64, rel=5e-3)
    assert cells_of(wall(20, 30, (1 / 50, 1 / 200), alpha)) == pytest.approx(200, rel=2e-2)
    assert np.isnan(cells_of(wall(20, 30, (0.01, 0.01), alpha * 0.5)))


def test_what_is_not_opaque_does_not_count_for_cells():
    alpha = np.ones((20, 30), np.float32)
    alpha[:, 10:] = 0.3
    made = wall(20, 30, (1 / 64, 1 / 64), alpha)
    made.x[made.offsets[:-1].reshape(20, 30)[:, 10:].ravel()] = 0  # far off, were it looked at
    assert cells_of(made) == pytest.approx(64, rel=5e-3)
