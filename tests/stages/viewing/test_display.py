"""What can be looked at."""

import pytest

from schemas.errors import UsageError


def test_nothing_else_can_be_looked_at(desk):
    with pytest.raises(UsageError, match="planes are"):
        desk.display.look(plane="secret")
    assert desk.display.choice.plane == "color"
