"""Which training views a deformation's gate judges by."""

import pytest

from stages.deform_init import held_out


@pytest.mark.parametrize(("views", "expected"), [(1, 0), (2, 1), (19, 1), (30, 3), (100, 4)])
def test_the_gate_leaves_a_view_to_learn_from(views, expected):
    train = list(range(10, 10 + views))
    assert len(held_out(train)) == expected and set(held_out(train)) < set(train)
