"""Decisions about capacity, without a field: what is tried, for how long, and what the views' answer means."""

import pytest

from stylerf.training.fit.capacity_levels import LADDER, CapacityLevel, Kinds
from stylerf.training.fit.capacity_search import GROW, RAMP, REDUCTIONS, TRIAL_STEPS, CapacitySearch
from stylerf.training.fit.settings import FitSettings, FitState

EVEN = tuple(CapacityLevel(n, table_bits=18) for n in (64, 128, 192, 256))


def climb_at(rung: int = 3, step: int = 1200, **more) -> CapacitySearch:
    settings = FitSettings(**{"steps": 2000, "ladder": EVEN, **more})
    return CapacitySearch(settings, FitState(step=step, rung=rung, best=30.0), "held-out views")


def tried(climb: CapacitySearch, progress: float, quality: float) -> tuple[str, bool]:
    """One reduction, begun at 30 dB and judged at `quality`."""
    name = climb.reduction_due(progress)
    climb.begin(name, 30.0, 1000, progress)
    assert climb.reduction_due(progress) is None and not climb.over(progress)
    begun, climb.state.step = climb.state.step, climb.state.trial["until"]
    assert climb.over(progress)
    climb.state.step = begun  # so that a step goes on standing for the same progress
    return name, climb.judge(quality, 500)[0]


def test_nothing_is_given_up_before_the_ladder_ends():
    assert climb_at(2).reduction_due(0.6) is None  # a rung is left
    assert climb_at().reduction_due(0.5) is None  # the last rung's trial is not over
    assert climb_at().reduction_due(0.6) == "density ranks"
    left = climb_at(2)
    left.state.fixed = True
    assert left.reduction_due(0.4) == "density ranks"
    assert climb_at(always_climb=True).reduction_due(0.6) is None


def test_a_fit_is_settled_when_nothing_is_left_to_try():
    climb = climb_at(reductions=("density ranks", "degree"))
    assert not climb.settled and not climb_at(2).settled
    assert climb_at(always_climb=True).settled and not climb_at(2, always_climb=True).settled
    assert tried(climb, 0.56, 29.5) == ("density ranks", False)
    assert not climb.settled
    climb.begin("degree", 30.0, 1000, 0.6)
    assert not climb.settled  # while it is on trial
    climb.judge(30.0, 900)
    assert climb.settled
    left = climb_at(2, reductions=())
    left.state.fixed = True
    assert left.settled


def test_nor_when_the_held_out_views_are_about_to_be_trained_on():
    assert climb_at(step=1400).reduction_due(0.70) is None
    assert climb_at(step=1200).reduction_due(0.66) == "density ranks"


def test_a_reduction_that_loses_little_stays_and_one_that_loses_more_is_refused_for_good():
    climb = climb_at(min_gain=0.1)
    assert tried(climb, 0.56, 29.95) == ("density ranks", True)
    assert (climb.rung.density_rank, climb.rung.color_rank, climb.rung.resolution) == (8, 24, 256)
    assert tried(climb, 0.58, 29.5) == ("resolution", False)
    assert climb.rung == CapacityLevel(256, 8, 24, table_bits=18)
    assert tried(climb, 0.57, 30.0) == ("color ranks", True)
    assert climb.rung.color_rank == 16
    assert tried(climb, 0.57, 29.8) == ("color ranks", False)
    assert climb.rung.color_rank == 16
    assert tried(climb, 0.58, 30.0) == ("color resolution", True)
    assert climb.rung.color.resolution == 176 and climb.rung.resolution == 256
    assert tried(climb, 0.59, 29.8) == ("color resolution", False)
    assert tried(climb, 0.60, 30.2) == ("degree", True)
    assert climb.rung.degree == 0 and climb.reduction_due(0.64) is None


@pytest.mark.parametrize(("gain", "size", "asked_back"), [(0.05, 500, True), (0.12, 1000, False), (0.3, 400, False)])
def test_a_rung_that_was_worth_its_climb_is_not_asked_back(gain, size, asked_back):
    climb = climb_at(2)
    climb.begin(GROW, 29.0, 500, 0.4)
    assert climb.judge(29.0 + gain, size)[0] and climb.state.rung == 3
    climb.state.refused = ["density ranks"]
    assert climb.reduction_due(0.6) == ("resolution" if asked_back else "color ranks")
    # A climb that is dropped says nothing about the rung below it.
    climb.state.rung, climb.state.climbed, climb.state.fixed = 2, 0.3, False
    climb.begin(GROW, 30.0, 500, 0.4)
    assert not climb.judge(30.05, 1000)[0] and climb.state.climbed == 0.3


@pytest.mark.parametrize(
    ("gain", "size", "kept"), [(0.09, 900, True), (0.0, 1000, True), (-0.01, 900, False), (0.09, 1001, False)]
)
def test_a_rung_that_is_no_larger_stays_where_nothing_is_lost(gain, size, kept):
    climb = climb_at(2, min_gain=0.1)
    climb.begin(GROW, 30.0, 1000, 0.4)
    assert climb.judge(30.0 + gain, size)[0] is kept
    assert climb.state.rung == (3 if kept else 2)


def test_a_rung_is_not_dropped_after_next_to_no_part_of_the_budget():
    """In a contraction coarse rungs end after so many steps, of many thousands a fiftieth."""
    climb = climb_at(1, step=1350, min_gain=0.1, steps=50_000, longest=(350, 850, 1350, 1350))
    climb.begin(GROW, 30.0, 1000, 0.027)
    assert climb.over(0.038) and climb.prolonged(30.06, 2000, 0.038)
    assert not climb.over(0.1) and climb.over(0.11)
    assert not climb.prolonged(30.06, 2000, 0.11) and not climb.judge(30.06, 2000)[0]
    climb = climb_at(1, step=1350, min_gain=0.1, steps=50_000, longest=(350, 850, 1350, 1350))
    climb.begin(GROW, 30.0, 1000, 0.027)
    assert not climb.prolonged(30.2, 2000, 0.038) and climb.judge(30.2, 2000)[0]  # what is plain is not waited for


def test_a_capacity_that_was_asked_for_is_on_no_trial():
    """What it has grown to stands at the next look: a fall leads back to it, not to the rung before."""
    climb = climb_at(2, always_climb=True)
    climb.begin(GROW, 30.0, 1000, 0.4)
    assert climb.over(0.4)
    kept, text = climb.judge(28.5, 2000)
    assert kept and climb.state.rung == 3 and text.endswith("as asked for")


def test_small_losses_do_not_add_up():
    """What is compared is the best field so far, not the one before the last reduction."""
    climb = climb_at(min_gain=0.1, reductions=("resolution",))
    climb.begin("resolution", 30.0, 1000, 0.56)
    assert climb.judge(29.94, 900)[0]
    climb.begin("resolution", 29.94, 900, 0.58)
    kept, text = climb.judge(29.88, 800)
    assert not kept and "is too little" in text
    assert climb.rung.resolution == 192


def test_views_met_within_rounding_lose_nothing_by_falling_less_far_beyond_it():
    climb = climb_at(min_gain=0.1)
    climb.begin("resolution", 60.0, 1000, 0.56)
    assert climb.judge(52.0, 500)[0]


@pytest.mark.parametrize(
    ("kinds", "expected"),
    [
        (Kinds(), ["density ranks", "resolution", "color ranks", "color resolution", "degree"]),
        (Kinds("vm", "hash"), ["density ranks", "resolution", "color resolution"]),
        (Kinds("hash", "hash"), ["resolution", "color resolution"]),
        (Kinds("voxel", "voxel"), ["resolution", "color resolution"]),
        (Kinds("hash", "vm", "mlp"), ["resolution", "color resolution"]),
    ],
)
def test_each_kind_gives_up_what_it_has(kinds, expected):
    climb = climb_at(kinds=kinds)
    possible = [name for name, less in REDUCTIONS.items() if less(climb.rung, kinds, climb.settings)]
    assert possible == expected


def test_a_trial_lasts_a_share_of_the_budget_within_bounds():
    for step, steps in ((120, TRIAL_STEPS[0]), (1200, 160), (60000, TRIAL_STEPS[1])):
        climb = climb_at(step=step)
        climb.begin("density ranks", 30.0, 1000, 0.6)
        assert climb.state.trial["until"] == step + steps


def test_the_capacity_is_told_with_what_more_and_less_of_it_would_do():
    climb = climb_at(0, min_gain=0.1, ladder=LADDER)
    climb.begin(GROW, 30.0, 200_000, 0.1)
    assert not climb.judge(30.04, 340_000)[0] and climb.state.fixed
    assert climb.told(200_000) == (
        "vm 64^3 rank 8+16, 0.20 M parameters: 128^3 rank 16+24 would gain 0.04 dB for 1.7x the size"
    )
    climb.begin("resolution", 30.0, 200_000, 0.2)
    climb.judge(29.0, 100_000)
    assert climb.told(200_000).endswith("1.7x the size; 48^3 rank 8+16 would lose 1.00 dB")
    assert climb_at(1).told(5_000_000) == "vm 128^3 rank 16+24, 5.00 M parameters"
    lean = climb_at(3, ladder=LADDER)
    assert lean.told(3_930_000) == "vm 256^3+176^3 rank 8+24, 3.93 M parameters"


def test_a_ladder_of_the_product_ends_in_time_for_reductions():
    climb = climb_at(len(LADDER) - 1, ladder=LADDER)
    assert climb.reduction_due(climb.settings.shares[-1] + 0.01) == "resolution"


def test_the_rate_rises_again_after_a_reduction():
    climb = climb_at()
    assert climb.rate == 1.0
    climb.begin("resolution", 30.0, 1000, 0.6)
    rates = []
    for _ in range(RAMP):
        rates.append(climb.rate)
        climb.state.step += 1
    assert 0 < rates[0] <= 0.2 and rates == sorted(set(rates)) and rates[-1] == climb.rate == 1.0
    growing = climb_at(2)
    growing.begin(GROW, 30.0, 1000, 0.4)
    assert growing.rate == 1.0


def test_what_falls_too_far_at_once_is_not_taught():
    climb = climb_at()
    climb.begin("resolution", 30.0, 1000, 0.6)
    assert climb.enough(29.95) and not climb.hopeless(29.95)
    assert not climb.enough(29.7) and not climb.hopeless(29.7)
    assert climb.hopeless(28.0) and climb.hopeless(float("nan"))


@pytest.mark.parametrize(
    ("what", "bears"), [("color resolution", True), ("color ranks", False), ("density ranks", False)]
)
def test_ranks_must_fall_less_than_resolution(what, bears):
    climb = climb_at()
    climb.begin(what, 30.0, 1000, 0.6)
    assert climb.hopeless(29.55) is not bears and not climb.hopeless(29.75)


@pytest.mark.parametrize(("now", "then"), [(384, 256), (256, 176), (176, 112), (64, 48), (32, None), (8, None)])
def test_a_color_gets_coarser_by_a_third(now, then):
    climb = climb_at()
    found = REDUCTIONS["color resolution"](CapacityLevel(now, 16, 24), climb.settings.kinds, climb.settings)
    assert found == ({} if then is None else {"color_resolution": then})
