"""What a selection looks at: colours in cells, boxes and spheres, masks of several views."""

import numpy as np
import pytest
from skimage.color import rgb2lab

from stylerf.editing.selection import (
    SeenCells,
    halved_light,
    inside_box,
    inside_sphere,
    modes,
    padded,
    shell,
    shown_by_masks,
)
from stylerf.fields.field import RadianceField
from stylerf.geometry.cameras import Camera
from tests.stylerf.small import SPACES, occupied, vm_colour

CELLS = 8


def looking_in(width: int = 24) -> Camera:
    """At the box of SPACES from outside, along +z."""
    pose = np.eye(4)
    pose[:3, 3] = 0.1, 0.05, -3.0
    return Camera("one", width, width, 1.6 * width, 1.6 * width, width / 2, width / 2, pose)


@pytest.fixture(scope="module")
def field():
    from tests.stylerf.small import density

    return RadianceField(SPACES["box"], density(3, shift=4.0), vm_colour(2), occupied(), 0.02)


def test_cells_take_the_colours_of_the_photo_that_sees_them(field):
    camera = looking_in()
    photo = np.zeros((24, 24, 3), np.float32)
    photo[:, :12], photo[:, 12:] = (0.9, 0.1, 0.1), (0.1, 0.2, 0.8)
    seen = SeenCells(field, [camera], [photo], CELLS, 2)
    assert seen.seen.sum() > 20
    red = seen.like(halved_light(np.array([[0.9, 0.1, 0.1]])), 10)
    blue = seen.like(halved_light(np.array([[0.1, 0.2, 0.8]])), 10)
    assert red.any() and blue.any() and not (red & blue).any()
    # x of the camera is x of the cube: what is red lies left of what is blue.
    assert np.argwhere(red)[:, 0].mean() < np.argwhere(blue)[:, 0].mean() - 2


def test_masks_mark_the_cells_that_most_of_their_views_show_inside(field):
    camera = looking_in()
    left = np.zeros((24, 24))
    left[:, :12] = 1
    marked = shown_by_masks(field, [camera], [left], CELLS, 2)
    whole = shown_by_masks(field, [camera], [np.ones((24, 24))], CELLS, 2)
    assert 0 < marked.sum() < whole.sum()
    assert np.argwhere(marked)[:, 0].max() <= np.argwhere(whole)[:, 0].mean() + 1
    outvoted = shown_by_masks(field, [camera] * 3, [left, 1 - left, 1 - left], CELLS, 2)
    assert not (outvoted & marked & ~shown_by_masks(field, [camera], [1 - left], CELLS, 2)).any()


def test_box_and_sphere_hold_the_cells_whose_centres_they_hold():
    for name, space in SPACES.items():
        from stylerf.editing.selection import centres_of

        world = space.unwarp(centres_of(CELLS))
        low, high = np.percentile(world, 30, axis=0), np.percentile(world, 70, axis=0)
        expected = np.array([all(low[a] <= p[a] <= high[a] for a in range(3)) for p in world])
        assert expected.any(), name
        np.testing.assert_array_equal(inside_box(space, CELLS, high, low).ravel(), expected)  # corners in any order
        middle = np.median(world, axis=0)
        away = np.array([np.sqrt(sum((p[a] - middle[a]) ** 2 for a in range(3))) for p in world])
        radius = float(np.median(away))
        np.testing.assert_array_equal(inside_sphere(space, CELLS, middle, radius).ravel(), away <= radius)


def test_light_counts_half_of_colour():
    colours = np.array([[0.5, 0.5, 0.5], [0.8, 0.3, 0.2]])
    lab = rgb2lab(colours.reshape(1, 2, 3))[0]
    found = halved_light(colours)
    np.testing.assert_allclose(found[:, 0], lab[:, 0] / 2, rtol=1e-5)
    np.testing.assert_allclose(found[:, 1:], lab[:, 1:], rtol=1e-4, atol=1e-4)


def test_every_colour_is_near_a_mode():
    random = np.random.default_rng(5)
    lab = np.concatenate([random.normal([20, 40, 10], 1, (50, 3)), random.normal([40, -30, 0], 1, (30, 3))])
    found = modes(lab, 12)
    assert len(found) == 2
    assert (np.linalg.norm(lab[:, None] - found[None], axis=2).min(1) <= 12).all()
    assert modes(np.full((3, 3), np.nan), 5).shape == (0, 3)


def test_a_shell_lies_around_and_padding_spares_others():
    marked = np.zeros((9,) * 3, bool)
    marked[4, 4, 4] = True
    around = shell(marked, 2, np.ones_like(marked))
    assert around.sum() == 5**3 - 1 and not around[4, 4, 4]
    assert shell(marked, 0, np.ones_like(marked)).sum() == 0
    others = np.zeros_like(marked)
    others[5] = True
    assert padded(marked, others).sum() == 27 - 9
