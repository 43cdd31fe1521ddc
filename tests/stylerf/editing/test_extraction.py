"""What views show of a region, on a box of known shape: depths, ends of rays, edges, transition, what is left out."""

import numpy as np
import pytest

from stylerf.editing.edit_grid import Region, march_view
from stylerf.editing.extraction import EditView, Extraction, seen_of_view
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import alpha_inside, render_rays
from tests.stylerf.small import density, vm_color, wall_in_front
from tests.stylerf.training.scenes import SIDE, box_photo, dome, masked_wall

CELLS = 16
SPACE = SpaceWarp.box([-0.8] * 3, [0.8] * 3)


@pytest.fixture(scope="module")
def field():
    """An opaque box of SIDE, by occupancy: density everywhere, but only cells inside are marched."""
    made = density(1, size=(8, 8, 8), shift=8.0)
    occupancy = OccupancyGrid(32)
    center = (np.stack(np.meshgrid(*[np.arange(32)] * 3, indexing="ij"), -1) + 0.5) / 32 * 1.6 - 0.8
    occupancy.set_occupied((np.abs(center) < SIDE).all(-1).ravel())
    return RadianceField(SPACE, made, vm_color(2), occupancy, 0.01)


def halves() -> Region:
    """E: x < 0; G: a layer of two cells beyond it."""
    edit, grow = np.zeros((CELLS,) * 3, bool), np.zeros((CELLS,) * 3, bool)
    edit[: CELLS // 2] = True
    grow[CELLS // 2 : CELLS // 2 + 2] = True
    return Region(edit, grow)


@pytest.fixture(scope="module")
def seen(field):
    camera = dome(6, 1)[2]
    photo = box_photo(camera).astype(np.float32) / 255
    return camera, photo, seen_of_view(field, camera, photo, halves(), Extraction(0.5, 0.3), 2, 1)


def test_region_pixels_are_those_whose_rays_hit_its_half_of_the_box(seen):
    camera, _, found = seen
    origins, directions = (a.astype(np.float64) for a in camera.rays())
    sides = np.stack([(s * SIDE - origins) / directions for s in (-1, 1)])
    near, far = sides.min(0).max(1), sides.max(0).min(1)
    points = origins + near[:, None] * directions
    # A soft edge, a cell's width, and what only grazes the box lie between; a ray is in one half all the way.
    clear = (far - near > 0.2) & (np.abs(points[:, 0]) > 0.1)
    inside = np.zeros(len(near), bool)
    inside[found.edit.pixels] = True
    np.testing.assert_array_equal(inside[clear], points[clear, 0] < 0)
    assert not inside[near > far + 0.2].any()


def test_depth_and_ends_agree_with_the_box(seen):
    camera, _, found = seen
    edit = found.edit
    origins, directions = (a.astype(np.float64) for a in camera.rays(edit.pixels))
    world = SPACE.unwarp(edit.x)
    np.testing.assert_allclose(origins + directions * edit.depth[:, None], world, atol=0.02)
    sure = edit.weight > 0.99
    assert sure.mean() > 0.7
    on_a_side = np.abs(np.abs(world[sure]).max(1) - SIDE)
    assert np.quantile(on_a_side, 0.9) < 0.06


def test_content_behind_the_region_counts_in_its_rays_depth_and_opacity():
    """A fog: of many rays a good part of the opacity lies before or behind the region."""
    field = RadianceField(SPACE, density(1, size=(8, 8, 8), shift=-3.0), vm_color(2), OccupancyGrid(32), 0.01)
    camera = dome(6, 1)[2]
    photo = np.full((24, 24, 3), 0.5, np.float32)
    seen = seen_of_view(field, camera, photo, halves(), Extraction(1.0), 0, 1).edit
    rays = Rays.of(*camera.rays(seen.pixels), SPACE.near)
    out = render_rays(field, rays, threads=1).out
    partly = (seen.inside > 0.3) & (seen.inside < 0.7 * seen.weight)
    assert partly.sum() > 5
    np.testing.assert_allclose(seen.through, out[:, 4], rtol=1e-3)
    assert np.abs(seen.depth * seen.weight / out[:, 4] - 1)[partly].max() > 0.1
    inside = np.concatenate([alpha_inside(halves().edit, s, 1) for _, s in march_view(field, camera, 1)])
    np.testing.assert_allclose(seen.inside, inside[seen.pixels], atol=1e-5)


def test_the_depth_of_a_whole_ray_excludes_the_background():
    """A capture, of whose rays some light is left for an opaque background far away: fine-tuning compares the two."""
    space = SpaceWarp("contraction", SpaceWarp.box([-0.8] * 3, [0.8] * 3).parameters, 0.0, 1e3)
    field = RadianceField(space, density(1, size=(8, 8, 8), shift=-3.0), vm_color(2), OccupancyGrid(32), 0.01)
    assert field.opaque_background
    camera = dome(6, 1)[2]
    photo = np.full((24, 24, 3), 0.5, np.float32)
    seen = seen_of_view(field, camera, photo, halves(), Extraction(1.0), 0, 1).edit
    out = render_rays(field, Rays.of(*camera.rays(seen.pixels), space.near), threads=1).out
    np.testing.assert_allclose(seen.through, out[:, 4], rtol=1e-3)
    assert seen.weight.min() > 0.99  # opaque by the background


def test_rays_that_end_in_the_background_have_no_depth_and_leave_that_of_others_alone():
    """A wall with a hole, and a region that holds both it and the infinitely far background in the hole."""
    field, camera = wall_in_front(1e-4), masked_wall(0)[1].cameras[0]
    solid = (field.occupancy.distances == 0).reshape((field.occupancy.cells,) * 3)
    solid[40:56, 40:56] = False
    field.occupancy.set_occupied(solid.ravel())
    photo = np.random.default_rng(0).random((camera.height, camera.width, 3)).astype(np.float32)
    everything = np.ones((CELLS,) * 3, bool)
    near = everything.copy()
    near[..., -1] = False
    seen, wall = (
        seen_of_view(field, camera, photo, Region(cells, np.zeros_like(cells)), Extraction(), 0, 1).edit
        for cells in (everything, near)
    )
    there = np.isin(seen.pixels, wall.pixels)
    assert len(seen) == camera.height * camera.width > there.sum() > 100
    for name in ("along", "depth", "edges"):
        assert not getattr(seen, name)[~there].any(), name
        np.testing.assert_array_equal(getattr(seen, name)[there], getattr(wall, name), err_msg=name)
    assert seen.depth[there].max() < 5 and seen.edges.max() > 0.1
    assert np.linalg.norm(seen.along, axis=1).max() < 0.01


def test_targets_are_the_photo_where_it_shows_anything(seen):
    _, photo, found = seen
    np.testing.assert_array_equal(found.edit.target, photo[..., :3].reshape(-1, 3)[found.edit.pixels])
    assert photo[..., 3].ravel()[found.edit.pixels].min() > 0.5


def test_an_edge_of_the_box_is_an_edge_and_its_sides_are_none(field):
    """Edges need a jump of depth within the region: two towers, one behind the other, give it where they part."""
    camera = dome(6, 1)[2]
    photo = np.random.default_rng(0).random((24, 24, 3)).astype(np.float32)
    whole = Region(np.ones((CELLS,) * 3, bool), np.zeros((CELLS,) * 3, bool))
    edit = seen_of_view(field, camera, photo, whole, Extraction(), 0, 1).edit
    assert edit.edges.min() >= 0 and edit.edges.max() <= 1
    # By hand at one pixel: four sure pixels in a column.
    place = {int(p): i for i, p in enumerate(edit.pixels)}
    for i, p in enumerate(edit.pixels):
        column = [place.get(int(p) + k * 24) for k in (-1, 0, 1, 2)]
        if None not in column and (edit.weight[column] >= 0.98).all():
            spread = edit.depth.max() - edit.depth.min()
            step = abs(edit.depth[column[1]] - edit.depth[column[2]]) / spread
            contrast = np.abs(edit.target[column[1]] - edit.target[column[2]]).sum()
            expected = np.clip(step * contrast * np.prod(edit.weight[column]), 0, 1)
            np.testing.assert_allclose(edit.edges[i, 0], expected, rtol=2e-3, atol=1e-5)
            return
    pytest.fail("no run of four sure pixels")


def test_the_transition_is_one_at_the_seam_and_nothing_far_from_it(seen):
    _, _, found = seen
    x = SPACE.unwarp(found.edit.x)[:, 0]
    fading = found.edit.transition
    assert fading.max() > 0.6
    assert fading[x > -0.12].mean() > fading[x < -0.35].mean() + 0.3
    assert (fading[x < -0.45] == 0).all()


def test_views_without_the_region_show_nothing(field):
    camera = dome(6, 1)[2]
    photo = box_photo(camera).astype(np.float32) / 255
    hidden = np.zeros((CELLS,) * 3, bool)
    hidden[7:9, 7:9, 7:9] = True  # inside the box
    found = seen_of_view(field, camera, photo, Region(hidden, np.zeros_like(hidden)), Extraction(), 0, 1)
    assert found.edit is None
    assert found.alpha.max() > 0.99


def test_pairs_are_the_neighbors_that_both_show_the_region():
    pixels = np.array([0, 1, 3, 4, 7, 11])  # of a picture 4 wide: 3 and 4 are not neighbors
    n = len(pixels)
    blank = {name: np.zeros((n, 3), np.float32) for name in ("x", "along", "directions", "target")}
    view = EditView(0, 4, 3, pixels, *blank.values(), *(np.zeros(n, np.float32),) * 5, np.zeros((n, 2), np.float32))
    upper, lower, left, right = view.pairs()
    assert list(zip(pixels[upper], pixels[lower])) == [(0, 4), (3, 7), (7, 11)]
    assert list(zip(pixels[left], pixels[right])) == [(0, 1)]
    assert view.window == (slice(0, 3), slice(0, 4))
