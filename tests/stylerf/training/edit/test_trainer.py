"""Learning a palette from small regions: what comes of it, resuming, and what stops it."""

import time
from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.editing.palette_losses import EditWeights, figures_of, kept_colors, shares_of
from stylerf.errors import Diverged, InvalidValue
from stylerf.training.edit.trainer import EditSettings, EditTrainer, start_module
from tests.stylerf.editing.region_pictures import PLAIN, view_of
from tests.stylerf.style.small_trunk import picture, small_trunk
from tests.stylerf.training.running import Stopped, assert_same_bits, result_of, resumed

SMALL = EditSettings(
    palette_steps=120, style_steps=12, pruned_steps=40, pruned_style_steps=6, pixels=1024, style_side=32
)


def trainer(count: int = 3, style: bool = False, seed: int = 0, threads: int = 2, views=None, **more) -> EditTrainer:
    settings = replace(SMALL, **more)
    views = [view_of(number) for number in range(count)] if views is None else views
    painting, extractor = (picture(40, 40, 9), small_trunk()) if style else (None, None)
    return EditTrainer(views, start_module(views, settings, seed), settings, painting, extractor, seed, threads)


def hue_distance(color: np.ndarray, plain: np.ndarray) -> float:
    """Sine of the angle between two colors: shading makes a color darker, not another."""
    return float(np.linalg.norm(np.cross(color, plain)) / np.linalg.norm(color) / np.linalg.norm(plain))


def test_plain_colors_are_found_and_eight_pruned_to_them():
    made = trainer()
    made.run()
    figures = made.figures()
    # Published of lego's shovel, on real photos: 5 colors, sparsity 0.859.
    assert figures["colors"] == made.module.active.sum() == 4
    assert figures["sparsity"] < 0.25 and figures["psnr"] > 31
    np.testing.assert_allclose(figures["shares"], 0.25, atol=0.03)
    for plain in PLAIN:
        assert min(hue_distance(color, plain) for color in made.module.palette) < 0.06


def test_a_random_palette_comes_to_the_colors_too():
    made = trainer(palette="random")
    made.run()
    figures = made.figures()
    assert 4 <= figures["colors"] < 8 and figures["sparsity"] < 0.859 and figures["psnr"] > 29
    assert sum(figures["shares"]) == pytest.approx(1, abs=1e-3)
    for plain in PLAIN:
        assert min(hue_distance(color, plain) for color in made.module.palette) < 0.3


def test_each_quarter_has_a_color_of_its_own():
    """No collapse: the strongest colors of the four quarters differ, from eight as from four at first."""
    for colors in (4, 8):
        made = trainer(colors=colors, max_colors=colors)
        made.run()
        view = view_of(0)
        strongest = made.module.weights(view.x).argmax(1)
        place = (view.x[:, :2] - 0.3) / 0.2
        quarter = (place[:, 0] > 0.5) * 2 + (place[:, 1] > 0.5)
        shares = np.stack([np.bincount(strongest[quarter == q], minlength=8) / (quarter == q).sum() for q in range(4)])
        # Each strongest color belongs to one quarter: what two quarters share is at most a tenth.
        assert max(float(np.minimum(shares[a], shares[b]).sum()) for a in range(4) for b in range(a)) < 0.1


def test_one_view_is_enough():
    made = trainer(count=1, palette_steps=60, pruned_steps=20)
    made.run()
    assert made.state.phase == "done" and made.figures()["psnr"] > 20


def test_every_view_has_its_turn_once_an_epoch():
    made, seen = trainer(count=5), []
    for step in range(15):
        made.state.step = step
        seen.append(made.view_of_step(0))
    assert [sorted(seen[at : at + 5]) for at in (0, 5, 10)] == [list(range(5))] * 3
    assert seen[:5] != seen[5:10]


def test_pruning_by_shares():
    active = np.array([True, True, False, True, True])
    assert kept_colors(active, np.array([0.5, 0.024, 0.2, 0.276]), 8).tolist() == [True, False, False, True, True]
    assert kept_colors(active, np.array([0.5, 0.024, 0.2, 0.276]), 2).tolist() == [True, False, False, False, True]
    assert kept_colors(np.ones(80, bool), np.full(80, 1 / 80), 40).sum() == 1
    made = trainer(count=12)
    views = [replace(view, x=view.x[:100]) for view in made.views]
    expected = np.mean([made.module.weights(views[at].x).mean(0) for at in (0, 1, 2, 4, 5, 6, 7, 9, 10, 11)], 0)
    np.testing.assert_allclose(shares_of(made.module, views, 1), expected, rtol=1e-5)


@pytest.mark.parametrize("style", [False, True])
@pytest.mark.parametrize("at", ["palette", "last", "pruned"])
def test_a_killed_run_goes_on_to_the_same_bits(style, at):
    more = {"palette_steps": 6, "style_steps": 4, "pruned_steps": 5, "pruned_style_steps": 5, "max_colors": 3}

    def stop(running: EditTrainer) -> None:
        if running.state.phase == phase and running.state.step == step:
            raise Stopped

    phase, step = {"palette": ("palette", 3), "pruned": ("pruned", 2)}.get(at, ("style" if style else "palette", 4))
    whole = trainer(style=style, **more)
    whole.run()
    stopped = trainer(style=style, **more)
    with pytest.raises(Stopped):
        stopped.run(stop)
    going_on = resumed(trainer(style=style, **more), stopped)
    going_on.run()
    (state, arrays), (other, others) = result_of(whole), result_of(going_on)
    assert state | {"spent": 0} == other | {"spent": 0} and state["spent"].keys() == other["spent"].keys()
    assert_same_bits(arrays, others)
    assert arrays["active"].sum() == 3
    assert not np.array_equal(arrays["module.networks"], stopped.checkpoint()[1]["module.networks"])


def test_style_steps_come_nearer_to_the_painting():
    made = trainer(style=True, palette_steps=60, style_steps=40, weights=EditWeights(style=1.0))
    made.run()
    before = [entry["style"] for entry in made.state.curve if "style" in entry]
    assert before[-1] < 0.7 * before[0]
    assert "style" not in made.state.curve[0]
    canvas = made.style.canvas(made.views[0])
    mixed = made.module.mixture(made.views[0].x, made.views[0].directions).colors
    plain = made.style.distance(torch.from_numpy(made.views[0].target), canvas)
    assert float(made.style.distance(mixed, canvas)) < 0.7 * float(plain)


def test_the_edge_of_a_region_holds_the_photo_while_it_is_stylized():
    """lambda = 1 in the left half: there the colors stay, in the right half they go."""
    views = [view_of(number) for number in range(2)]
    left = [view.pixels % view.width < 30 for view in views]
    for view, mask in zip(views, left):
        view.transition[:] = mask
    made = trainer(style=True, views=views, style_steps=40, pruned_style_steps=20, weights=EditWeights(style=3.0))
    made.run()
    colors = made.module.colors(views[0].x, views[0].directions)
    apart = np.abs(colors - views[0].target).mean(1)
    assert apart[left[0]].mean() < 0.5 * apart[~left[0]].mean()


def test_the_painting_in_the_regions_own_colors():
    made, kept = trainer(style=True), trainer(style=True, keep_colors=True)
    assert not torch.allclose(made.style.grams[0], kept.style.grams[0], rtol=0.1)


def test_a_budget_of_seconds_ends_it():
    made = trainer(count=1, seconds=0.4, palette_steps=10**6, pruned_steps=10**6)
    made.run()
    assert made.state.phase == "done" and min(made.state.spent.values()) > 0.09
    assert 0.4 < sum(made.state.spent.values()) < 2 and made.progress == made.whole_progress == 1


def test_a_first_step_that_compiles_changes_nothing(monkeypatch):
    """A bound that is not reached leaves no trace, however long the first step of a process takes."""
    slow, free = (trainer(count=1, seconds=seconds, palette_steps=12, pruned_steps=4) for seconds in (4.0, 0.0))
    step = slow.step
    monkeypatch.setattr(slow, "step", lambda: (time.sleep(0.0 if slow.state.step else 0.5), step())[1])
    for made in (slow, free):
        made.run()
    assert np.array_equal(slow.module.values, free.module.values)


def test_figures_tell_how_well_the_region_is_drawn():
    made = trainer(count=2)
    mixtures = [made.module.mixture(view.x, view.directions) for view in made.views]
    errors = np.concatenate([np.square(m.colors.numpy() - v.target) for m, v in zip(mixtures, made.views)])
    figures = figures_of(made.module, made.views, 2)
    assert figures["psnr"] == pytest.approx(-10 * np.log10(errors.mean()), abs=0.006)
    assert figures["colors"] == 8 and figures["sparsity"] > 5  # all nearly even at first


def test_what_cannot_be_learned_is_refused():
    views = [view_of(0)]
    module = start_module(views, SMALL, 0)
    with pytest.raises(InvalidValue, match="no view shows"):
        EditTrainer([], module, SMALL, None, None, 0, 1)
    with pytest.raises(InvalidValue, match="needs a feature extractor"):
        EditTrainer(views, module, SMALL, picture(40, 40, 0), None, 0, 1)
    with pytest.raises(InvalidValue, match=r"8 colors .*at most 9 after pruning"):
        replace(SMALL, max_colors=9)
    views[0].target[:] = np.nan
    with pytest.raises(Diverged, match="palette step 0"):
        EditTrainer(views, module, SMALL, None, None, 0, 1).run()
