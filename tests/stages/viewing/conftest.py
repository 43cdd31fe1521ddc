"""A desk over a small work folder."""

import pytest

from stages.viewing.desk import Desk
from stages.viewing.library import Library
from stages.viewing.painter import Painter
from tests.stages.viewing.room import furnished


@pytest.fixture
def desk(tmp_path):
    library = Library(furnished(tmp_path / "work").root)
    opened = Desk(library, Painter(1, 2700.0, 12.0), 1)
    opened.display.look(field="plain")
    yield opened
    opened.close()
    opened.painter.stop()
