"""What a first selection needs is computed while the page rests."""

import time

import numpy as np

from stages import region_select
from stages.viewing.selection import Selection
from tests.stages.viewing.room import FRONT


def opened_page(desk):
    """Make the desk's painter rest, as with a page that shows an exact picture."""
    desk.painter.open(0, lambda picture, exact, stride: None)
    desk.painter.move(0, FRONT)
    desk.display.refresh()
    desk.painter.start()


def waited_for(found, seconds: float = 60.0) -> bool:
    end = time.monotonic() + seconds
    while not found() and time.monotonic() < end:
        time.sleep(0.02)
    return bool(found())


def test_what_selecting_needs_is_computed_once_while_the_page_rests(desk, monkeypatch):
    from stages.viewing.growing import Grower

    steps, plain = [], region_select.Sight.look
    monkeypatch.setattr(region_select.Sight, "look", lambda sight, view: (steps.append(view), plain(sight, view))[1])
    desk.preparation.start()
    time.sleep(0.5)
    assert steps == [], "no page is open"
    opened_page(desk)
    assert waited_for(lambda: desk.preparation._growers and next(iter(desk.preparation._growers.values()))._solid)
    seed = desk.selector.click(FRONT, 0.5, 0.5)
    assert steps == desk.preparation.grower()._first.looking_views
    alone = Grower(desk.library, "plain", 1, print)
    np.testing.assert_array_equal(alone.cells(Selection(at=(seed,))), desk.display.selected)


def test_preparing_is_given_up_for_another_field_and_by_closing(desk, monkeypatch):
    looked, plain = [], region_select.Sight.look

    def slow(sight, view):
        looked.append(sight.field)
        desk.display.look(field="palette")
        return plain(sight, view)

    monkeypatch.setattr(region_select.Sight, "look", slow)
    opened_page(desk)
    desk.preparation.start()
    palette = desk.library.source("palette").field
    assert waited_for(lambda: len(looked) == 3), "one look in the first field, two in the other"
    assert [one is palette for one in looked] == [False, True, True]
    desk.close()
    assert not desk.preparation._thread.is_alive()
