"""Cells that cut-out photos show to be clear: none of the object's, not by one wrong mask, kept through a fit."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from stylerf.geometry.cameras import Camera
from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.fit.visual_hull import clear_cells
from tests.stylerf.training.running import resumed, run_until
from tests.stylerf.training.scenes import AROUND, LEVELS, box_fitter, dome

CELLS, RADIUS = 16, 0.3  # of a ball in the middle of a box 1.6 wide


def ball_photo(camera: Camera) -> np.ndarray:
    """[h, w, 4] uint8 of the ball, green, nothing around it."""
    origins, directions = (a.astype(np.float64) for a in camera.rays())
    beside = np.linalg.norm(np.cross(origins, directions), axis=1) < RADIUS
    return (beside[:, None] * np.uint8([20, 200, 40, 255])).reshape(camera.height, camera.width, 4)


def ball_cells(cells: int = CELLS) -> np.ndarray:
    """Cells [cells^3] bool that share a place with the ball."""
    low = np.stack(np.unravel_index(np.arange(cells**3), (cells,) * 3), 1) / cells * 1.6 - 0.8
    return np.linalg.norm(np.clip(0, low, low + 1.6 / cells), axis=1) < RADIUS


@pytest.fixture(scope="module")
def seen() -> tuple[list[Camera], list[np.ndarray]]:
    cameras = dome(24, 1, 48)
    return cameras, [ball_photo(camera)[..., 3] for camera in cameras]


@pytest.mark.parametrize(("share", "most"), [(0.0, 0.2), (0.05, 0.2), (0.5, 0.5)])
def test_what_lies_outside_is_clear_and_nothing_of_the_object(seen, share, most):
    """Most of a box is as large as the hull of a ball with the rim of cells that no view sees whole."""
    found = clear_cells(*seen, AROUND, CELLS, share, 2)
    assert not (found & ball_cells()).any()
    left = (~found & ~ball_cells()).reshape((CELLS,) * 3)[2:-2, 2:-2, 2:-2]
    assert left.mean() < most


def test_fewer_cells_are_clear_where_more_views_have_to_agree(seen):
    found = [clear_cells(*seen, AROUND, CELLS, share, 1) for share in (0.05, 0.5, 0.8, 1.0)]
    for wider, closer in pairwise(found):
        assert not (closer & ~wider).any() and closer.sum() < wider.sum()


def test_threads_do_not_change_what_is_found(seen):
    assert np.array_equal(*(clear_cells(*seen, AROUND, CELLS, 0.05, threads) for threads in (1, 5)))


def test_a_lost_mask_clears_nothing_and_a_dirty_one_hides_nothing(seen):
    cameras, alphas = seen
    sound = clear_cells(cameras, alphas, AROUND, CELLS, 0.05, 1)
    lost = [np.zeros_like(alphas[0]), *alphas[1:]]
    assert not (clear_cells(cameras, lost, AROUND, CELLS, 0.05, 1) & ball_cells()).any()
    dirty = [np.maximum(alpha, 5) for alpha in alphas]  # as JPEG leaves them
    assert np.array_equal(clear_cells(cameras, dirty, AROUND, CELLS, 0.05, 1), sound) and sound.any()
    filled = [np.full_like(alpha, 255) for alpha in alphas]
    assert not clear_cells(cameras, filled, AROUND, CELLS, 0.0, 1).any()


def test_what_no_view_sees_whole_is_not_clear():
    narrow = [replace(camera, width=12, height=12, cx=6.0, cy=6.0) for camera in dome(24, 1, 48)]
    found = clear_cells(narrow, [np.zeros((12, 12), np.uint8)] * 24, AROUND, CELLS, 0.0, 1).reshape((CELLS,) * 3)
    assert found[7:9, 7:9, 7:9].all() and not found[::15, ::15, ::15].any()


# -- in a fit -------------------------------------------------------------------------------------------------------


def ball_bank() -> RayDataset:
    cameras = dome(12, 1, 48)
    return RayDataset(cameras, [ball_photo(camera) for camera in cameras])


def test_a_fit_never_looks_there_while_it_grows_and_resumes():
    levels = LEVELS[0], replace(LEVELS[1], cells=16)
    more = {"levels": levels, "level_ends": (0.4,), "force_growth": True, "visual_hull": 0.05}
    fitter = run_until(box_fitter(250, bank=ball_bank(), **more), 150)
    fitter = resumed(box_fitter(250, bank=ball_bank(), **more), fitter)
    assert fitter.field.occupancy.cells == 16
    fitter.run()
    clear, occupied = fitter.field.occupancy.clear, fitter.field.occupancy.distances == 0
    assert clear.mean() > 0.5 and occupied.any() and not (occupied & clear).any()


def test_without_the_option_or_transparency_a_fit_searches_everywhere():
    assert box_fitter(10, bank=ball_bank()).field.occupancy.clear is None
    cameras = dome(12, 1, 24)
    opaque = RayDataset(cameras, [ball_photo(camera)[..., :3].copy() for camera in cameras])
    assert box_fitter(10, bank=opaque, visual_hull=0.05).field.occupancy.clear is None
