"""Memory that the parts of a view use one after another."""

import numpy as np

from stylerf.fields.room import reused, room


def test_outside_of_a_view_every_array_is_its_own():
    first, second = room((4, 3)), room((4, 3))
    assert first.shape == (4, 3) and first.dtype == np.float32 and not np.shares_memory(first, second)


def test_a_round_has_arrays_of_its_own_and_the_next_round_has_them_again():
    with reused() as memory:
        memory.begin_round()
        first, second = room((1000,)), room((500, 3))
        assert not np.shares_memory(first, second)
        memory.begin_round()
        again, smaller = room((1000,)), room((400, 3))
        assert np.shares_memory(first, again) and np.shares_memory(second, smaller)
        memory.begin_round()
        longer = room((2000,), np.int64)
        assert longer.shape == (2000,) and longer.dtype == np.int64 and not np.shares_memory(first, longer)
    assert not np.shares_memory(room((1000,)), again)
