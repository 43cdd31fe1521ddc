"""Capacity on tiny scenes: what is kept, dropped, not even tried; and that time spent longer is never lost."""

import math

import numpy as np
import pytest

from stylerf.rendering.view import render_view
from stylerf.training.fit.capacity_search import MIN_STEPS_PER_LEVEL, ROUNDING_PSNR
from stylerf.training.fit.fitter import Fitter
from tests.stylerf.training.running import Stopped, assert_same_bits, now, resumed, run_until
from tests.stylerf.training.scenes import LEVELS, box_bank, box_fitter, box_photo, dome, settings, wall_bank


def test_a_level_that_gains_too_little_is_dropped_for_the_field_before_it():
    fitter, seen, tried = box_fitter(300, min_gain=50.0, level_ends=(0.34, 0.68)), {}, []

    def on_step(now_: Fitter) -> None:
        state = now_.state
        if state.trial is not None and not seen:
            seen.update(now(now_.checkpoint()[1], "anchor."))
            tried.append(state.trial.before)
            assert now_.field.density.size.max() == 12
        if state.growth_ended:
            assert_same_bits(now(now_.checkpoint()[1]), seen)
            assert now_.held_out_psnr() == pytest.approx(tried[0], abs=1e-9)
            raise Stopped

    with pytest.raises(Stopped):
        fitter.run(on_step)
    assert fitter.state.level == 0 and fitter.field.density.size.max() == 8 and fitter.state.step > 200
    assert len(fitter.state.decisions) == 1 and "12^3 rank 16+24 dropped" in fitter.state.decisions[0]
    fitter = resumed(box_fitter(300, min_gain=50.0, level_ends=(0.34, 0.68)), fitter)
    fitter.run()
    assert fitter.state.level == 0 and len(fitter.state.decisions) == 1  # not tried twice


def test_a_level_that_gains_is_kept():
    fitter = box_fitter(300, levels=LEVELS[:2])
    fitter.run()
    assert fitter.state.level == 1 and fitter.field.density.size.max() == 12
    assert "12^3 rank 16+24 kept" in fitter.state.decisions[0]
    sizes = [entry["parameters"] for entry in fitter.state.curve]
    assert sizes == sorted(sizes) and sizes[-1] == fitter.field.parameters > sizes[0]


def test_a_long_budget_leaves_a_coarse_level_after_its_longest():
    """By fractions of a long budget, levels would last longer; the last trial, too, ends by its steps."""
    fitter, level_gain = box_fitter(3000, min_gain=-9.0, level_max_steps=(110, 240, 350), level_ends=(0.4, 0.6)), {}

    def on_step(now_: Fitter) -> None:
        level_gain.setdefault(now_.state.level, now_.state.step)
        if len(now_.state.decisions) == 2:
            raise Stopped

    with pytest.raises(Stopped):
        fitter.run(on_step)
    assert level_gain == {0: 1, 1: 110, 2: 240}
    # The last trial is judged at the first evaluation after its maximum of steps.
    assert 350 <= fitter.state.step <= 350 + 120 and fitter.state.trial is None


def test_growing_holds_the_same_picture():
    fitter = run_until(box_fitter(300), 60)
    before = fitter.held_out_psnr()
    fitter.resize(LEVELS[2])
    assert fitter.field.density.size.max() == 16 and fitter.field.occupancy.cells == 16 and fitter.field.step == 1 / 16
    fitter.field.step = 1 / 8
    assert fitter.held_out_psnr() == pytest.approx(before, abs=0.3)  # sixteen vertices do not hold eight exactly


def sizes_by_step(steps: int, **more) -> dict[int, int]:
    """Parameters at each look of a fit."""
    fitter = box_fitter(steps, **more)
    fitter.run()
    assert fitter.state.trial is None
    return {entry["step"]: entry["parameters"] for entry in fitter.state.curve}


def test_a_trial_has_its_least_steps_however_few_a_fit_has():
    """By its share of the budget the trial of 12^3 would end at step 96 of 320, before it has begun."""
    sizes = sizes_by_step(320, min_gain=50.0)
    tried = [step for step, size in sizes.items() if size > min(sizes.values())]
    assert MIN_STEPS_PER_LEVEL < min(tried) < 120 and 200 <= max(tried) < 220


@pytest.mark.parametrize("steps", [150, 200])
def test_nothing_is_tried_without_the_steps_to_judge_it(steps):
    """Three quarters into a fit the held-out views are trained on, and decide nothing any more."""
    assert len(set(sizes_by_step(steps, min_gain=0.0).values())) == 1


def test_held_out_views_are_trained_on_once_nothing_is_left_to_decide():
    requested, seen = box_fitter(400, force_growth=True, level_ends=(0.25, 0.5)), {}

    def on_step(now_: Fitter) -> None:
        seen.setdefault((now_.judging, now_.state.level), now_.progress)

    requested.run(on_step)
    # What was asked for stays from the first look on.
    assert seen == {(True, 0): 1 / 400, (True, 1): 0.25, (True, 2): 0.5, (False, 2): 201 / 400}
    assert [point["held_out"] for point in requested.state.curve] == [p["step"] <= 201 for p in requested.state.curve]
    grown = box_fitter(800, min_gain=-9.0)
    grown.run()
    assert 0.38 <= next(p["step"] for p in grown.state.curve if not p["held_out"]) / 800 <= 0.44
    never = box_fitter(400, force_growth=True, level_ends=(0.25, 0.5), held_out_until=1.0)
    never.run()
    assert all(point["held_out"] for point in never.state.curve[:-1])


def test_without_held_out_views_decisions_name_the_training_views():
    fitter = box_fitter(300, held_out=0, min_gain=-9.0)
    fitter.run()
    assert fitter.state.decisions and all("training views gained" in d for d in fitter.state.decisions[:1])


def test_a_capacity_that_was_requested_is_reached_whatever_it_gains():
    fitter = box_fitter(300, min_gain=50.0, force_growth=True)
    fitter.run()
    assert fitter.field.density.size.max() == 16 and all("as requested" in d for d in fitter.state.decisions)


@pytest.mark.parametrize("steps", [60, 250])
def test_a_short_fit_shares_its_steps_among_levels_up_to_the_requested(steps):
    fitter, level_gain = box_fitter(steps, force_growth=True), {}
    fitter.run(lambda now_: level_gain.setdefault(now_.state.level, now_.state.step))
    assert level_gain == {0: 1, 1: math.ceil(steps / 3), 2: math.ceil(2 * steps / 3)}
    assert fitter.field.density.size.max() == 16


@pytest.mark.parametrize("steps", [300, 900])
def test_where_every_level_has_its_least_steps_nothing_of_that_changes(steps):
    fitter, level_gain = box_fitter(steps, force_growth=True, level_ends=(0.05, 0.1)), {}

    def on_step(now_: Fitter) -> None:
        level_gain.setdefault(now_.state.level, now_.state.step)
        if now_.state.level == 2:
            raise Stopped

    with pytest.raises(Stopped):
        fitter.run(on_step)
    assert level_gain == {0: 1, 1: MIN_STEPS_PER_LEVEL, 2: 2 * MIN_STEPS_PER_LEVEL}


def test_what_is_reported_is_the_quality_of_the_field_that_stands():
    """Neither of one on trial that was refused nor of one that was left behind by a return."""
    fitter, seen = box_fitter(300, min_gain=50.0, level_ends=(0.34, 0.68), levels=LEVELS[:2]), []

    def on_step(now_: Fitter) -> None:
        if now_.state.growth_ended and not seen:
            seen.extend([now_.state.quality["held out"], now_.state.curve[-1]["psnr"], now_.held_out_psnr()])
            raise Stopped

    with pytest.raises(Stopped):
        fitter.run(on_step)
    anchored, last, found = seen
    assert anchored == pytest.approx(found, abs=1e-3) and abs(last - anchored) > 0.1


@pytest.mark.parametrize("steps", [200, 600])
def test_a_wall_of_one_color_stays_at_the_smallest_capacity(steps):
    space, bank = wall_bank()
    # Of eight seeds, four roll back once within 200 steps; this one does not.
    fitter = Fitter(space, bank, 2, settings(steps), 2, 1)
    fitter.run()
    assert fitter.state.level == 0 and fitter.field.density.size.max() == LEVELS[0].resolution
    assert {entry["parameters"] for entry in fitter.state.curve} == {fitter.field.parameters}
    assert fitter.state.rollbacks == 0 and fitter.state.curve[-1]["psnr"] > ROUNDING_PSNR


def test_steps_follow_the_cells_of_the_space_at_every_capacity():
    capture, thing = Fitter(*wall_bank(), 2, settings(10), 1, 1), box_fitter(10)
    for level in LEVELS[:2]:
        for fitter, cells in ((capture, 1.5), (thing, 1.0)):
            fitter.resize(level)
            assert fitter.field.step == pytest.approx(cells / level.resolution)


# -- giving up ------------------------------------------------------------------------------------------------------


def reducing(steps: int = 400, **more) -> Fitter:
    given = {"levels": LEVELS[:1], "level_ends": (0.3,), "prunings": ("density ranks",), "min_gain": 0.3}
    return box_fitter(steps, **{**given, **more})


def test_ranks_that_the_views_do_not_miss_are_pruned():
    fitter = reducing()
    fitter.run()
    assert fitter.field.density.rank == 8 and fitter.field.color.rank == 24
    sizes = [entry["parameters"] for entry in fitter.state.curve]
    assert sizes[-1] == fitter.field.parameters < 0.85 * sizes[0]
    whole = box_fitter(400, levels=LEVELS[:1])
    whole.run()
    assert unseen_psnr(fitter) > unseen_psnr(whole) - 0.3
    assert "is enough" in fitter.state.decisions[0] and fitter.search.summary(1).startswith("vm 8^3 rank 8+24")


def test_what_the_views_miss_comes_back_to_the_bit_and_is_not_taught(monkeypatch):
    fitter, seen = reducing(min_gain=-50.0), []
    go_back = Fitter._go_back

    def watched(self: Fitter) -> None:
        before = self.field.density.rank
        go_back(self)
        seen.append((before, now(self.checkpoint()[1]), now(self.checkpoint()[1], "anchor.")))

    monkeypatch.setattr(Fitter, "_go_back", watched)
    fitter.run()
    [(rank, restored, kept)] = seen
    assert rank == 8
    assert_same_bits(restored, kept)
    assert fitter.field.density.rank == 16 and "8^3 rank 8+24 is too little" in fitter.state.decisions[0]
    assert fitter.state.rejected == ["density ranks"] and fitter.state.rate_scale == 1.0
    assert len({entry["parameters"] for entry in fitter.state.curve}) == 1


def test_a_fit_stopped_after_a_pruning_goes_on_to_the_same_bits():
    given = {"prunings": ("color ranks",), "min_gain": 50.0}
    whole = reducing(260, **given)
    whole.run()
    at = run_until(reducing(260, **given), 130)
    assert at.state.pruned == {"color_rank": 8} and at.field.color.rank == 8
    at = resumed(reducing(260, **given), at)
    at.run()
    assert at.state.decisions == whole.state.decisions
    assert_same_bits(at.field.arrays(), whole.field.arrays())


# -- time -----------------------------------------------------------------------------------------------------------


def unseen_psnr(fitter: Fitter) -> float:
    """Over views that no fit has had, on white."""
    error = []
    for camera in dome(4, 99):
        photo = box_photo(camera).astype(np.float64) / 255
        seen = render_view(fitter.field, camera, threads=1)
        over = seen.rgb + (1 - seen.alpha[..., None])
        error.append((over - photo[..., :3] * photo[..., 3:] - (1 - photo[..., 3:])) ** 2)
    return -10 * np.log10(np.mean(error))


def qualities(lengths, views: int, size: int = 24, **more) -> list[float]:
    found = []
    for steps in lengths:
        fitter = box_fitter(steps, bank=box_bank(views, size), **more)
        fitter.run()
        found.append(unseen_psnr(fitter))
    return found


def test_a_longer_fit_never_ends_worse():
    found = qualities((80, 160, 320), views=20)
    assert found[1] > found[0] - 0.2 and found[2] > found[1] - 0.2 and found[2] > found[0] + 1


@pytest.mark.slow
@pytest.mark.parametrize("rate", [2e-2, 1e-1])
def test_a_much_longer_fit_never_ends_worse(rate):
    """A rate of 0.1 is one at which fits fall apart: the returns to the best field are what holds them."""
    found = qualities((200, 600, 1800), views=16, size=32, rate=rate)
    assert found[1] > found[0] - 0.2 and found[2] > found[1] - 0.2
