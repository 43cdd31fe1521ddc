"""Memory that is used again: no two arrays share it, later rounds get the same."""

import numpy as np

from stylerf.fields.marching import ScratchArena, empty_array


def test_without_an_arena_every_array_is_new():
    first, second = empty_array((4, 3), None), empty_array((4, 3), None)
    assert first.shape == (4, 3) and first.dtype == np.float32 and not np.shares_memory(first, second)


def test_after_a_reset_the_same_memory_is_used_again():
    arena = ScratchArena()
    first, second = empty_array((1000,), arena), empty_array((500, 3), arena)
    assert not np.shares_memory(first, second) and second.shape == (500, 3)
    arena.reset()
    again, smaller = arena.empty((1100,)), arena.empty((400, 3))
    assert np.shares_memory(first, again) and np.shares_memory(second, smaller)
    longer = arena.reset().empty((2000,), np.int64)
    assert longer.dtype == np.int64 and len(longer) == 2000 and not np.shares_memory(longer, first)


def test_two_arenas_share_nothing():
    one, other = ScratchArena(), ScratchArena()
    assert not np.shares_memory(one.empty((10,)), other.empty((10,)))
