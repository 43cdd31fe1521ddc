"""Selecting: what clicks, strokes and boxes select, and that the command makes the same region."""

import numpy as np
import pytest

from schemas.errors import BadInput, UsageError
from stages import region_select
from stages.artifacts.region import load_region
from stages.run.progress import Context
from stages.run.runner import execute
from stages.viewing.cameras import Pose
from tests.stages.viewing.command_lines import config_of
from tests.stages.viewing.room import FRONT


def test_a_click_selects_and_its_command_makes_the_same_region(desk):
    seed = desk.selector.click(FRONT, 0.5, 0.5)
    desk.selector.change(tolerance=40.0, steps=2, iterations=500)
    assert desk.selector.cells > 0
    args, config = config_of(desk.selector.command("thing"))
    assert (args.of, args.name, config.at, config.tolerance) == ("plain", "thing", (seed,), 40.0)
    work = desk.library.work
    inputs = {"scene": work.get("scene", "wall"), "field": work.get("field", "plain")}
    kept, _ = execute(region_select.SPEC, region_select.run, work, "thing", inputs, config, Context(threads=1))
    np.testing.assert_array_equal(load_region(kept)[0].edit, desk.display.selected)
    desk.display.look(overlay="thing")
    assert desk.library.regions("plain") == ["thing"]


def test_growing_goes_in_steps_and_back(desk):
    desk.selector.click(FRONT, 0.5, 0.5)
    sizes = []
    for steps in (0, 1, 2):
        desk.selector.change(tolerance=0.0, steps=steps, iterations=40)
        sizes.append(desk.selector.cells)
    assert sizes[0] < sizes[1] < sizes[2]
    desk.selector.undo()
    assert desk.selector.cells == sizes[1]
    desk.selector.clear()
    assert desk.selector.cells == 0
    with pytest.raises(UsageError, match="nothing is selected"):
        desk.selector.command()
    desk.selector.undo()
    assert desk.selector.cells == sizes[1]


def test_a_box_holds_what_the_rectangle_shows(desk):
    low_x, low_y, low_z, high_x, high_y, high_z = desk.selector.box(FRONT, (0.45, 0.45), (0.55, 0.55))
    # The front of the fog, at z = 2, seen from x = 0.05 with a tangent of 0.4 (0.53 across) to the picture's rim.
    assert low_x < 0.0 and high_x > 0.1 and low_y < -0.05 and high_y > 0.05 and low_z < 2.05 < high_z
    assert -0.2 < low_x and high_x < 0.3 and 1.9 < low_z and high_z < 2.2
    assert desk.selector.cells > 0
    assert config_of(desk.selector.command())[1].box == (low_x, low_y, low_z, high_x, high_y, high_z)


def test_what_meets_nothing_selects_nothing(desk):
    away = Pose((0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0), 0.76, 4 / 3)
    for action in (
        lambda: desk.selector.click(away, 0.5, 0.5),
        lambda: desk.selector.scribble(away, [(0.4, 0.4), (0.6, 0.6)]),
        lambda: desk.selector.box(away, (0.4, 0.4), (0.6, 0.6)),
    ):
        with pytest.raises(BadInput, match="nothing of the field"):
            action()
    assert not desk.selector.history.now and len(desk.selector.history.states) == 1
