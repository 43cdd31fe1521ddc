"""What a selection looks at: colors in cells, boxes and spheres, masks of several views."""

import numpy as np
import pytest
from scipy import ndimage
from skimage.color import rgb2lab

from stylerf.editing.selection import (
    Look,
    SeenCells,
    claimed,
    halved_lightness,
    inside_box,
    inside_sphere,
    modes,
    nearest_within,
    padded,
    shell,
    shown_by_masks,
    widened,
)
from stylerf.fields.packed_surface import PackedSurface
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from tests.stylerf.small import SPACES, occupied, vm_color

CELLS = 8


def looking_in(width: int = 24) -> Camera:
    """At the box of SPACES from outside, along +z."""
    pose = np.eye(4)
    pose[:3, 3] = 0.1, 0.05, -3.0
    return Camera("one", width, width, 1.6 * width, 1.6 * width, width / 2, width / 2, pose)


@pytest.fixture(scope="module")
def field():
    from tests.stylerf.small import density

    return RadianceField(SPACES["box"], density(3, shift=4.0), vm_color(2), occupied(), 0.02)


def test_cells_take_the_colors_of_the_photo_that_sees_them(field):
    camera = looking_in()
    photo = np.zeros((24, 24, 3), np.float32)
    photo[:, :12], photo[:, 12:] = (0.9, 0.1, 0.1), (0.1, 0.2, 0.8)
    seen = SeenCells([Look.at(field, camera, photo, 2)], CELLS)
    assert seen.seen.sum() > 20
    red = seen.like(halved_lightness(np.array([[0.9, 0.1, 0.1]])), 10)
    blue = seen.like(halved_lightness(np.array([[0.1, 0.2, 0.8]])), 10)
    assert red.any() and blue.any() and not (red & blue).any()
    nearer = seen.nearer(halved_lightness(np.array([[0.9, 0.1, 0.1]])), halved_lightness(np.array([[0.1, 0.2, 0.8]])))
    np.testing.assert_array_equal(nearer[red | blue], red[red | blue])
    # x of the camera is x of the cube: what is red lies left of what is blue.
    assert np.argwhere(red)[:, 0].mean() < np.argwhere(blue)[:, 0].mean() - 2


def test_a_large_view_is_looked_at_by_every_other_ray(field, monkeypatch):
    camera = looking_in()
    photo = np.random.default_rng(1).random((24, 24, 3)).astype(np.float32)
    whole = Look.at(field, camera, photo, 2)
    monkeypatch.setattr("stylerf.editing.selection.MOST_RAYS", 24 * 24 // 4)
    half = Look.at(field, camera, photo, 2)
    assert (whole.stride, half.stride) == (1, 2) and half.surface.alpha.shape == (12, 12)
    np.testing.assert_array_equal(half.colors.reshape(12, 12, 3), photo[::2, ::2])
    np.testing.assert_array_equal(half.surface.alpha, whole.surface.alpha[::2, ::2])
    sums = [np.zeros((CELLS**3, 4), np.float32) for _ in range(2)]
    for look, to in zip((whole, half), sums):
        look.add(look.colors, CELLS, to)
    assert sums[1][:, 3].sum() == pytest.approx(sums[0][:, 3].sum() / 4, rel=0.1)


def test_cells_seen_only_with_the_region_join_it_and_others_do_not():
    """Rays along z through a soft slab: most of their weight in marked cells, some behind; others see only behind."""

    def look(columns: range) -> Look:
        rays = [(c, r) for c in columns for r in range(8)]
        x = np.array([[(c + 0.5) / 8, (r + 0.5) / 8, z] for c, r in rays for z in (0.3, 0.45)])
        weights = np.tile(np.float32([0.7, 0.3]), len(rays))
        offsets = np.arange(len(rays) + 1) * 2
        surface = PackedSurface(offsets, np.round(x * 65535).astype(np.uint16), weights, np.ones((len(columns), 8)))
        return Look(surface, np.zeros((len(rays), 3), np.float32), 1)

    marked = np.zeros((8,) * 3, bool)
    marked[:4, :, 2] = True  # z = 0.3 of the left half
    found = claimed([look(range(8))], marked, 1)
    behind = np.zeros_like(marked)
    behind[:4, :, 3] = True
    np.testing.assert_array_equal(found, marked | behind)
    twice = look(range(4))
    alone = Look(  # the same places behind, seen by rays that do not pass the region
        PackedSurface(twice.surface.offsets, twice.surface.x, np.tile(np.float32([0, 1.0]), 32), twice.surface.alpha),
        twice.colors,
        1,
    )
    np.testing.assert_array_equal(claimed([look(range(8)), alone], marked, 1), marked)


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


def test_box_and_sphere_hold_the_cells_whose_centers_they_hold():
    for name, space in SPACES.items():
        from stylerf.editing.selection import centers_of

        world = space.unwarp(centers_of(CELLS))
        low, high = np.percentile(world, 30, axis=0), np.percentile(world, 70, axis=0)
        expected = np.array([all(low[a] <= p[a] <= high[a] for a in range(3)) for p in world])
        assert expected.any(), name
        np.testing.assert_array_equal(inside_box(space, CELLS, high, low).ravel(), expected)  # corners in any order
        middle = np.median(world, axis=0)
        away = np.array([np.sqrt(sum((p[a] - middle[a]) ** 2 for a in range(3))) for p in world])
        radius = float(np.median(away))
        np.testing.assert_array_equal(inside_sphere(space, CELLS, middle, radius).ravel(), away <= radius)


def test_light_counts_half_of_color():
    colors = np.array([[0.5, 0.5, 0.5], [0.8, 0.3, 0.2]])
    lab = rgb2lab(colors.reshape(1, 2, 3))[0]
    found = halved_lightness(colors)
    np.testing.assert_allclose(found[:, 0], lab[:, 0] / 2, rtol=1e-5)
    np.testing.assert_allclose(found[:, 1:], lab[:, 1:], rtol=1e-4, atol=1e-4)


def test_every_color_is_near_a_mode():
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


@pytest.mark.parametrize("width", [0, 1, 3])
def test_widening_is_scipys_dilation_by_all_neighbors(width):
    marked = np.random.default_rng(0).random((12, 9, 15)) < 0.01
    marked[0, 0, 14] = True
    expected = ndimage.binary_dilation(marked, np.ones((3, 3, 3)), iterations=width) if width else marked
    np.testing.assert_array_equal(widened(marked, width), expected)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.2, 0.7, 1.0])
def test_the_nearest_marked_cells_are_those_of_a_distance_transform(share):
    marked = np.random.default_rng(3).random((17, 18, 19)) < share
    away, ends = ndimage.distance_transform_edt(~marked, return_indices=True)
    near = (away > 0) & (away <= 2.0) if marked.any() else marked
    found, nearest = nearest_within(marked, 2.0)
    order = np.argsort(found)
    np.testing.assert_array_equal(found[order], np.flatnonzero(near))
    np.testing.assert_array_equal(np.stack(np.unravel_index(nearest[order], marked.shape)), ends[:, near])
