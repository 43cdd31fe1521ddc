"""Strokes by depth: steps of size, depths of a field whose surface is known, and that training uses them."""

import numpy as np
import pytest

from stylerf.training.stylize.arf import Arf
from stylerf.training.stylize.scene import StyledScene
from stylerf.training.stylize.stroke_sizes import FACTORS, StrokesByDepth, factors_at, stroke_sizes
from tests.stylerf.style.small_trunk import small_trunk
from tests.stylerf.training.stylizing import HEIGHT, WIDTH, arf, new_color, problem, settings

SOLID = {"raw": 6.0}  # density of the box: opaque at its faces


def test_sizes_halve_where_depth_doubles_and_end_at_twice_and_half():
    depth = np.array([[0.1, 5.0, 10 / 1.2, 12.0, 20.0, 1e6, np.inf]])
    sizes = np.array(FACTORS)[factors_at(depth, 10.0)]
    assert sizes.tolist() == [[2.0, 2.0, 1.26, 0.79, 0.5, 0.5, 0.5]]
    assert stroke_sizes(3.0, False) == (3.0,)
    assert stroke_sizes(0.5, True) == pytest.approx([1.0, 0.63, 0.395, 0.25])


def test_depth_is_that_of_the_surface_and_nothing_is_far_away():
    """A solid box of half width 1, seen from 2.8 away: its nearest corner is nearer than its silhouette."""
    scene = StyledScene(problem(settings(), **SOLID), new_color)
    strokes = StrokesByDepth(scene, 1e6)
    alpha = scene.fixed.alpha(0)
    assert 1.0 < strokes.median < 2.8
    sizes = strokes[0]
    assert sizes.shape == (HEIGHT, WIDTH) and (sizes[alpha < 0.5] == len(FACTORS) - 1).all()
    shown = np.array(FACTORS)[sizes[alpha > 0.9]]
    assert 0.79 in shown and 1.26 in shown


def test_a_step_compares_every_pixel_with_its_size_of_strokes(monkeypatch):
    seen = []
    made = Arf(StyledScene(problem(settings(stroke_by_depth=True), **SOLID), new_color), small_trunk())
    inner = type(made.loss.objective).__call__
    monkeypatch.setattr(
        type(made.loss.objective), "__call__",
        lambda self, *inputs: (seen.append(inputs[4]), inner(self, *inputs))[1],
    )  # fmt: skip
    made.step()
    view = made.view_step.view_of_step()
    assert len(made.loss.objective.styles) == len(FACTORS)
    assert np.array_equal(seen[0].numpy(), StrokesByDepth(made.scene, 0)[view])


def test_training_by_depth_gives_other_colors_and_repeats_alike():
    runs = [arf({"raw": 6.0}, steps=4, stroke_by_depth=by) for by in (False, True, True)]
    for run in runs:
        run.run()
    plain, by_depth, again = (run.scene.field.color.values for run in runs)
    assert not np.allclose(plain, by_depth, atol=1e-4) and np.array_equal(by_depth, again)
