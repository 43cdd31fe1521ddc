"""Memory that parts of a view and batches of a fit use one after another."""

import numpy as np

from stylerf.fields.scratch_arena import ScratchArena, room


def test_outside_of_a_round_every_array_is_its_own():
    first, second = room((4, 3)), room((4, 3))
    assert first.shape == (4, 3) and first.dtype == np.float32 and not np.shares_memory(first, second)


def test_a_round_has_arrays_of_its_own_and_the_next_round_has_them_again():
    memory = ScratchArena()
    with memory.round():
        first, second = room((1000,)), room((500, 3))
        assert not np.shares_memory(first, second)
    with memory.round():
        again, smaller = room((1100,)), room((400, 3))
        assert np.shares_memory(first, again) and np.shares_memory(second, smaller)
    assert not np.shares_memory(room((1000,)), again)
    with memory.round():
        longer = room((2000,), np.int64)
        assert longer.shape == (2000,) and longer.dtype == np.int64 and not np.shares_memory(first, longer)


def test_a_round_within_a_round_has_its_own_memory():
    """A look at held-out views may render within whatever else is under way."""
    outer, inner = ScratchArena(), ScratchArena()
    with outer.round():
        first = room((10,))
        with inner.round():
            assert not np.shares_memory(first, room((10,)))
        assert not np.shares_memory(first, room((10,)))
    with outer.round():
        assert np.shares_memory(first, room((10,)))
