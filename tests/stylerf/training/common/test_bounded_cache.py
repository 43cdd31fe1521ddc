"""What is kept of views, and a stylization that keeps nothing."""

import numpy as np
import pytest

from stylerf.training.common.bounded_cache import BoundedCache
from tests.stylerf.training.running import assert_same_bits, result_of
from tests.stylerf.training.stylize.test_arf import stylizer


def test_the_first_that_fit_are_kept_and_the_others_made_again():
    made = []

    def make(view: int) -> np.ndarray:
        made.append(view)
        return np.full(3, view, np.uint8)

    kept = BoundedCache(make, lambda array: array.nbytes, 4, 7)
    for view in (2, 0, 1, 2, 0, 1, 3):
        assert (kept[view] == view).all()
    assert made == [2, 0, 1, 1, 3] and len(kept) == 4
    with pytest.raises(IndexError):
        kept[4]
    assert [array[0] for array in kept] == [0, 1, 2, 3]


@pytest.mark.parametrize("deform", [False, True])
def test_a_stylization_that_keeps_nothing_ends_with_the_same_bits(deform):
    results = []
    for memory in (1e9, 0):
        made = stylizer(deform=deform, memory=memory, coarse=0.5, match="both")
        made.run()
        assert (made.method.scene.photos[0] is made.method.scene.photos[0]) == (memory > 0)
        results.append(result_of(made))
    assert results[0][0] == results[1][0] and results[0][0]["curve"]
    assert_same_bits(results[0][1], results[1][1])
