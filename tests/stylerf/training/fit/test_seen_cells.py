"""Cells that training rays see, and those that a fit empties because none does."""

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.kernels.cpu.ray_samples import Samples
from stylerf.kernels.cpu.regions import mark_cells
from stylerf.training.fit.fitter import Fitter
from stylerf.training.fit.seen_cells import PATIENCE, SeenCells
from tests.stylerf.training.running import assert_same_bits, result_of, resumed, run_until
from tests.stylerf.training.scenes import settings, wall_bank


@pytest.mark.parametrize("threads", [1, 3])
def test_cells_are_marked_where_samples_weigh_enough(threads):
    generator = np.random.default_rng(0)
    n, cells = 300, 4
    x = generator.random((n, 3), dtype=np.float32)
    x[0], x[1] = 1.0, 0.0  # the far face belongs to the last cell
    weights, deltas = generator.random(n, dtype=np.float32), np.ones(n, np.float32)
    weights[:2] = 1
    deltas[5:40] = 0  # the opaque background
    ends = np.arange(10, n + 1, 10)
    starts = ends - 8  # two samples of rubbish before each ray's own
    starts[0] = 0
    samples = Samples(starts, ends, weights, deltas, x, weights, weights)
    marked = np.zeros(cells**3, np.uint8)
    mark_cells(samples, cells, np.float32(0.7), threads, marked)
    expected = np.zeros((cells,) * 3, np.uint8)
    for first, end in zip(starts, ends):
        for k in range(first, end):
            if weights[k] >= np.float32(0.7) and deltas[k] > 0:
                expected[tuple(np.minimum((x[k] * cells).astype(int), cells - 1))] = 1
    np.testing.assert_array_equal(marked, expected.ravel())
    assert marked[-1] and marked[0] and 0 < marked.sum() < cells**3


def test_cells_unseen_for_long_are_empty_unless_they_touch_a_seen_one():
    seen = SeenCells(6)
    seen.update(0.6 * PATIENCE)
    assert not seen.unseen().any()
    seen.marked[0] = 1
    seen.update(0.6 * PATIENCE)
    kept = ~seen.unseen().view(6, 6, 6)
    assert kept[:2, :2, :2].all() and kept.sum() == 8
    assert not seen.marked.any()
    finer = seen.resized(12)
    assert finer.unseen().view(12, 12, 12)[3:, 3:, 3:].all() and not finer.unseen().view(12, 12, 12)[:3, :3, :3].any()
    arrays = {k: v.copy() for k, v in finer.arrays().items()}
    again = SeenCells.restore(arrays, 12)
    assert again.cells == 12 and torch.equal(again.unseen(), finer.unseen())
    assert SeenCells.restore({}, 12) is None
    arrays["seen.ages"][3] = np.nan
    for wrong, cells in ((arrays, 12), (finer.arrays(), 8), ({"seen.ages": finer.arrays()["seen.ages"]}, 12)):
        with pytest.raises(InvalidValue, match="seen"):
            SeenCells.restore(wrong, cells)


def wall_fitter(steps: int, **more) -> Fitter:
    space, bank = wall_bank()
    return Fitter(space, bank, 2, settings(steps, background="none", **more), 0, 1)


def test_a_fit_empties_what_no_ray_sees_and_resumes_to_the_same_bits():
    clean = {"least_weight": 0.01, "distortion": 0.01}
    whole = wall_fitter(400, **clean)
    whole.run()
    hazy = wall_fitter(400)
    hazy.run()
    assert whole.field.occupancy.share < 0.7 * hazy.field.occupancy.share
    assert whole.held_out_psnr() > hazy.held_out_psnr() - 1.0
    halfway = run_until(wall_fitter(400, **clean), 251)
    halfway = resumed(wall_fitter(400, **clean), halfway)
    halfway.run()
    assert_same_bits(result_of(halfway)[1], result_of(whole)[1])
    assert result_of(halfway)[0] == result_of(whole)[0]
