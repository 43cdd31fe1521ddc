"""Pictures that sharpen end as the renderer's own, to the bit, each pixel rendered once."""

import numpy as np
import pytest

from stylerf.geometry.cameras import Camera
from stylerf.rendering.interlaced import coarsest_within, in_batches, interlaced, render_pixels, spread_out
from stylerf.rendering.view import render_view
from tests.stylerf.small import SPACES, field_of, vm_color


def camera(space: str, width: int = 26, height: int = 19) -> Camera:
    pose = np.eye(4)
    pose[2, 3] = -3.0 if space == "box" else 0.0
    return Camera("c", width, height, 24.0, 24.0, width / 2, height / 2, pose)


@pytest.mark.parametrize("coarsest", [1, 2, 8])
def test_passes_hold_every_pixel_once(coarsest):
    passes = list(interlaced(13, 7, coarsest))
    assert [stride for stride, _ in passes] == [s for s in (8, 4, 2, 1) if s <= coarsest]
    together = np.concatenate([pixels for _, pixels in passes])
    assert sorted(together) == list(range(13 * 7))
    held = np.zeros((7, 13), bool)
    for stride, pixels in passes:
        held.ravel()[pixels] = True
        assert held[::stride, ::stride].all()


@pytest.mark.parametrize("space", SPACES)
def test_all_passes_together_are_the_renderers_view(space):
    field, view = field_of(SPACES[space], 1, vm_color(2)), camera(space)
    marked = np.random.default_rng(0).random((8, 8, 8)) < 0.5
    out = np.zeros((view.width * view.height, 6), np.float32)
    for _, pixels in interlaced(view.width, view.height, 4):
        for batch in in_batches(pixels, 50, lambda: False):
            out[batch] = render_pixels(field, view, batch, threads=1, marked=marked)
    whole = render_view(field, view, threads=1, regions={"a": marked})
    assert whole.alpha.max() > 0.1
    np.testing.assert_array_equal(out[:, :3].reshape(whole.rgb.shape), whole.rgb)
    np.testing.assert_array_equal(np.clip(out[:, 3], 0, 1).reshape(whole.alpha.shape), whole.alpha)
    np.testing.assert_array_equal(np.minimum(out[:, 5].reshape(whole.alpha.shape), whole.alpha), whole.masks["a"])


def test_a_grid_is_spread_to_the_whole_picture():
    image = np.arange(35).reshape(5, 7)
    spread = spread_out(image, 2)
    rows, columns = np.mgrid[0:5, 0:7]
    np.testing.assert_array_equal(spread, image[rows // 2 * 2, columns // 2 * 2])
    assert spread_out(image, 1) is image


def test_the_first_pass_fits_what_may_be_spent():
    assert [coarsest_within(6400, most) for most in (6400, 1600, 1599, 400, 100, 1)] == [1, 2, 4, 4, 8, 8]


def test_batches_end_when_nobody_wants_them():
    taken = []
    for batch in in_batches(np.arange(10), 3, lambda: len(taken) == 2):
        taken.append(batch.tolist())
    assert taken == [[0, 1, 2], [3, 4, 5]]
