"""Where rays end in a region, found on the device, as extraction finds it on the CPU."""

import numpy as np
import pytest
import torch

from stylerf.editing.edit_grid import Region
from stylerf.editing.extraction import EVERYWHERE, Extraction, ends_of_view, seen_of_view
from tests.stylerf.small import SPACES, field_of, hash_color
from tests.stylerf.training.scenes import AROUND, box_photo, dome

CELLS = 8


def halves() -> tuple[np.ndarray, np.ndarray]:
    """E: z < 0; G: the other half. Cameras see both beside each other."""
    edit = np.zeros((CELLS,) * 3, bool)
    edit[..., : CELLS // 2] = True
    return edit, ~edit


GRIDS = [*halves(), np.ones((5,) * 3, bool), np.zeros((5,) * 3, bool)]


@pytest.fixture(scope="module")
def walked(device):
    """(field, camera, ends by grid): walked once."""
    from stylerf.editing.extraction_gpu import GpuRayEnds

    field, camera = field_of(AROUND, 3, hash_color(5), 1 / 8), dome(3, 2, 6)[1]
    field.density.values[-1] = -1.0
    ends_of = GpuRayEnds(field, device, rays_at_once=20)
    found = ends_of(camera, GRIDS)
    assert [grid is known for grid, (known, _) in zip(GRIDS, ends_of._there)] == [True] * 4  # sent once
    return field, camera, found


def test_ends_of_rays_are_the_cpus_for_any_share_of_cells(walked):
    field, camera, found = walked
    for ours, theirs in zip(found, ends_of_view(field, camera, GRIDS, 1)):
        assert ours.shape == (36, 6) and ours.dtype == np.float32
        np.testing.assert_allclose(ours, theirs, atol=3e-5)
    some, _, whole, nothing = found
    assert 0.1 < some[:, 1].max() and (some[:, 1] < whole[:, 1] - 0.1).any()
    np.testing.assert_allclose(whole[:, 1], whole[:, 0], atol=1e-6)
    assert not nothing[:, 1:].any() and (nothing[:, 0] == 0).any()  # and rays that meet nothing


def test_a_background_has_no_depth_on_the_device_either(device):
    from stylerf.editing.extraction_gpu import GpuRayEnds

    field, camera = field_of(SPACES["contraction"], 3, hash_color(5), 1 / 8), dome(3, 2, 6)[1]
    field.density.values[-1] = -5.0
    grids = [np.ones((5,) * 3, bool), EVERYWHERE]
    for ours, theirs in zip(GpuRayEnds(field, device)(camera, grids), ends_of_view(field, camera, grids, 1)):
        # Far out, a rounding of x in the cube is a thousand times as much of t.
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=3e-5)
    depth = theirs[:, 2], ends_of_view(field, camera, grids[:1], 1)[0][:, 2]
    assert (depth[1] == 0).any() and (depth[1] > 0).any() and depth[0].max() < 900


def test_a_view_shows_the_same_of_the_region(walked):
    field, camera, ends = walked
    photo = box_photo(camera).astype(np.float32) / 255
    region, settings = Region(*halves()), Extraction(0.5, 0.8)
    requested = []

    def ends_of(camera, grids):
        requested.extend(grids)
        return [each.copy() for each in ends[:3]]

    expected = seen_of_view(field, camera, photo, region, settings, 2, 1)
    found = seen_of_view(field, camera, photo, region, settings, 2, 1, ends_of)
    assert requested[0] is region.edit and requested[1] is region.grow
    assert len(expected.edit) > 5 and np.array_equal(found.edit.pixels, expected.edit.pixels)
    for name in ("x", "along", "directions", "target", "weight", "inside", "depth", "through", "transition", "edges"):
        np.testing.assert_allclose(getattr(found.edit, name), getattr(expected.edit, name), atol=2e-4, err_msg=name)
    assert expected.edit.transition.max() > 0.3
    for name in ("alpha", "alpha_edit", "depth"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=3e-5)


def test_sums_of_rays_by_hand(device):
    from stylerf.kernels.gpu import launch
    from stylerf.kernels.gpu.ray_samples import GpuSamples

    x = torch.tensor([[0.1, 0.1, 0.1], [0.9, 0.1, 0.1], [0.2, 0.4, 0.3], [1.0, 1.0, 1.0]])
    weights, t, nothing = torch.tensor([0.5, 0.25, 0.2, 0.1]), torch.tensor([1.0, 2.0, 3.0, 4.0]), torch.zeros(4)
    starts, ends = torch.tensor([0, 2, 2]), torch.tensor([2, 2, 4])
    samples = GpuSamples(*(a.to(device) for a in (starts, ends, nothing, nothing, nothing, t, nothing, x, nothing,
                                                     weights, nothing)))  # fmt: skip
    marked = torch.zeros(8, dtype=torch.uint8, device=device)
    marked[0] = 1  # the corner at the origin
    found = launch.ends_inside(marked, 2, samples)
    expected = [[0.75, 0.5, 0.5, 0.05, 0.05, 0.05], [0] * 6, [0.3, 0.2, 0.6, 0.04, 0.08, 0.06]]
    np.testing.assert_allclose(found.cpu(), expected, rtol=1e-6)
