"""How fast the levels of a hash color learn."""

import numpy as np
import pytest

from stylerf.fields.hash_grid import HashColor


@pytest.fixture
def color() -> HashColor:
    """16, 25, 40, 64, 101 and 160 cells a side."""
    return HashColor.create(np.random.default_rng(0), levels=6, base=16, finest=160, table=1 << 10)


def test_all_levels_learn_alike_unless_asked_otherwise(color):
    assert color.groups() == [(0, len(color.values), 1.0)]


def test_levels_finer_than_five_cells_of_the_finest_learn_more_slowly(color):
    color.detail_rate = 0.1
    begins, ends, rates = zip(*color.groups())
    assert (0, *ends) == (*begins, len(color.values))
    # 160 / 5 = 32 cells; then in equal steps of the logarithm: 0.1^(log(cells / 32) / log 5).
    expected = [1, 1] + [0.1 ** (np.log(cells / 32) / np.log(5)) for cells in (40, 64, 101)] + [0.1]
    np.testing.assert_allclose(rates, expected)
    color.detail = 2.0  # 160 / 2 = 80 cells
    expected = [1, 1, 1, 1] + [0.1 ** (np.log(cells / 80) / np.log(5)) for cells in (101, 160)]
    np.testing.assert_allclose(list(zip(*color.groups()))[2], expected)


def test_levels_of_broad_cells_learn_the_more_slowly_the_wider_they_are(color):
    color.broad = 4.0  # of the finest level's cells; those of the coarsest are ten times as wide
    rates = list(zip(*color.groups()))[2]
    np.testing.assert_allclose(rates, [0.4, 4 / (160 / 25), 1, 1, 1, 1])
    color.detail_rate = 0.1
    assert list(zip(*color.groups()))[2][:2] == rates[:2] and list(zip(*color.groups()))[2][-1] == pytest.approx(0.1)


def test_levels_of_narrow_cells_do_not_learn(color):
    color.narrow = 2.0  # of the finest level's cells; those of 101 a side are 1.6 times as wide
    assert [rate for _, _, rate in color.groups()] == [1, 1, 1, 1, 0, 0]
    color.narrow = 100.0  # all are narrower: a region of a few pixels
    assert [rate for _, _, rate in color.groups()] == [1, 0, 0, 0, 0, 0]
    color.narrow = float("nan")  # nothing is seen
    assert {rate for _, _, rate in color.groups()} == {1.0}
