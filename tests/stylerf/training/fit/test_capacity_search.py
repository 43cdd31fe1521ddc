"""Decisions about capacity, without a field: what is tried, for how long, and what the views' answer means."""

import pytest

from stylerf.training.fit.capacity_search import PRUNINGS, RAMP, TRIAL_STEPS, CapacitySearch
from stylerf.training.fit.settings import FULL, GROW, LEVELS, CapacityLevel, FitSettings, FitState, Kinds, levels_for

EVEN = tuple(CapacityLevel(n, table_bits=18) for n in (64, 128, 192, 256))


def search_at(level: int = 3, step: int = 1200, **more) -> CapacitySearch:
    settings = FitSettings(**{"steps": 2000, "levels": EVEN, **more})
    return CapacitySearch(settings, FitState(step=step, level=level, best=30.0), "held-out views")


def tried(search: CapacitySearch, progress: float, quality: float) -> tuple[str, bool]:
    """One pruning, begun at 30 dB and judged at `quality`."""
    name = search.pruning_due(progress)
    search.begin(name, 30.0, 1000, progress)
    assert search.pruning_due(progress) is None and not search.over(progress)
    begun, search.state.step = search.state.step, search.state.trial.until_step
    assert search.over(progress)
    search.state.step = begun  # so that a step goes on standing for the same progress
    return name, search.judge(quality, 500)[0]


def test_nothing_is_given_up_before_the_levels_ends():
    assert search_at(2).pruning_due(0.6) is None  # a level is left
    assert search_at().pruning_due(0.5) is None  # the last level's trial is not over
    assert search_at().pruning_due(0.6) == "density ranks"
    left = search_at(2)
    left.state.growth_ended = True
    assert left.pruning_due(0.4) == "density ranks"
    assert search_at(force_growth=True).pruning_due(0.6) is None


def test_a_fit_is_settled_when_nothing_is_left_to_try():
    search = search_at(prunings=("density ranks", "degree"))
    assert not search.settled and not search_at(2).settled
    assert search_at(force_growth=True).settled and not search_at(2, force_growth=True).settled
    assert tried(search, 0.56, 29.5) == ("density ranks", False)
    assert not search.settled
    search.begin("degree", 30.0, 1000, 0.6)
    assert not search.settled  # while it is on trial
    search.judge(30.0, 900)
    assert search.settled
    left = search_at(2, prunings=())
    left.state.growth_ended = True
    assert left.settled


def test_nor_when_the_held_out_views_are_about_to_be_trained_on():
    assert search_at(step=1400).pruning_due(0.70) is None
    assert search_at(step=1200).pruning_due(0.66) == "density ranks"


def test_a_pruning_stays_if_it_loses_little_and_is_else_refused_for_good():
    search = search_at(min_gain=0.1)
    assert tried(search, 0.56, 29.95) == ("density ranks", True)
    assert (search.level.density_rank, search.level.color_rank, search.level.resolution) == (8, 24, 256)
    assert tried(search, 0.58, 29.5) == ("resolution", False)
    assert search.level == CapacityLevel(256, 8, 24, table_bits=18)
    assert tried(search, 0.57, 30.0) == ("color ranks", True)
    assert search.level.color_rank == 16
    assert tried(search, 0.57, 29.8) == ("color ranks", False)
    assert search.level.color_rank == 16
    assert tried(search, 0.58, 30.0) == ("color resolution", True)
    assert search.level.color.resolution == 176 and search.level.resolution == 256
    assert tried(search, 0.59, 29.8) == ("color resolution", False)
    assert tried(search, 0.60, 30.2) == ("degree", True)
    assert search.level.degree == 0 and search.pruning_due(0.64) is None


@pytest.mark.parametrize(("gain", "size", "wanted"), [(0.05, 500, True), (0.12, 1000, False), (0.3, 400, False)])
def test_a_level_that_gained_keeps_its_resolution(gain, size, wanted):
    search = search_at(2)
    search.begin(GROW, 29.0, 500, 0.4)
    assert search.judge(29.0 + gain, size)[0] and search.state.level == 3
    search.state.rejected = ["density ranks"]
    assert search.pruning_due(0.6) == ("resolution" if wanted else "color ranks")
    # A search that is dropped says nothing about the level below it.
    search.state.level, search.state.level_gain, search.state.growth_ended = 2, 0.3, False
    search.begin(GROW, 30.0, 500, 0.4)
    assert not search.judge(30.05, 1000)[0] and search.state.level_gain == 0.3


@pytest.mark.parametrize(
    ("gain", "size", "kept"), [(0.09, 900, True), (0.0, 1000, True), (-0.01, 900, False), (0.09, 1001, False)]
)
def test_a_level_that_is_no_larger_stays_where_nothing_is_lost(gain, size, kept):
    search = search_at(2, min_gain=0.1)
    search.begin(GROW, 30.0, 1000, 0.4)
    assert search.judge(30.0 + gain, size)[0] is kept
    assert search.state.level == (3 if kept else 2)


def test_a_level_is_not_dropped_after_next_to_no_part_of_the_budget():
    """In a contraction coarse levels end after so many steps, of many thousands a fiftieth."""
    search = search_at(1, step=1350, min_gain=0.1, steps=50_000, level_max_steps=(350, 850, 1350, 1350))
    search.begin(GROW, 30.0, 1000, 0.027)
    assert search.over(0.038) and search.extended(30.06, 2000, 0.038)
    assert not search.over(0.1) and search.over(0.11)
    assert not search.extended(30.06, 2000, 0.11) and not search.judge(30.06, 2000)[0]
    search = search_at(1, step=1350, min_gain=0.1, steps=50_000, level_max_steps=(350, 850, 1350, 1350))
    search.begin(GROW, 30.0, 1000, 0.027)
    assert not search.extended(30.2, 2000, 0.038) and search.judge(30.2, 2000)[0]  # what is plain is not waited for


def test_a_capacity_that_was_requested_is_on_no_trial():
    """What it has grown to stands at the next look: a fall leads back to it, not to the level before."""
    search = search_at(2, force_growth=True)
    search.begin(GROW, 30.0, 1000, 0.4)
    assert search.over(0.4)
    kept, text = search.judge(28.5, 2000)
    assert kept and search.state.level == 3 and text.endswith("as requested")


def test_small_losses_do_not_add_up():
    """What is compared is the best field so far, not the one before the last pruning."""
    search = search_at(min_gain=0.1, prunings=("resolution",))
    search.begin("resolution", 30.0, 1000, 0.56)
    assert search.judge(29.94, 900)[0]
    search.begin("resolution", 29.94, 900, 0.58)
    kept, text = search.judge(29.88, 800)
    assert not kept and "is too little" in text
    assert search.level.resolution == 192


def test_a_fall_to_a_view_still_met_within_rounding_is_no_loss():
    search = search_at(min_gain=0.1)
    search.begin("resolution", 60.0, 1000, 0.56)
    assert search.judge(52.0, 500)[0]


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
    search = search_at(kinds=kinds)
    possible = [name for name, less in PRUNINGS.items() if less(search.level, kinds, search.settings)]
    assert possible == expected


def test_a_trial_lasts_a_share_of_the_budget_within_bounds():
    for step, steps in ((120, TRIAL_STEPS[0]), (1200, 160), (60000, TRIAL_STEPS[1])):
        search = search_at(step=step)
        search.begin("density ranks", 30.0, 1000, 0.6)
        assert search.state.trial.until_step == step + steps


def test_the_summary_says_what_more_or_less_capacity_would_do():
    search = search_at(0, min_gain=0.1, levels=LEVELS)
    search.begin(GROW, 30.0, 200_000, 0.1)
    assert not search.judge(30.04, 340_000)[0] and search.state.growth_ended
    assert search.summary(200_000) == (
        "vm 64^3 rank 8+16, 0.20 M parameters: 128^3 rank 16+24 would gain 0.04 dB for 1.7x the size"
    )
    search.begin("resolution", 30.0, 200_000, 0.2)
    search.judge(29.0, 100_000)
    assert search.summary(200_000).endswith("1.7x the size; 48^3 rank 8+16 would lose 1.00 dB")
    assert search_at(1).summary(5_000_000) == "vm 128^3 rank 16+24, 5.00 M parameters"
    lean = search_at(3, levels=LEVELS)
    assert lean.summary(3_930_000) == "vm 256^3+176^3 rank 8+24, 3.93 M parameters"


def test_default_levels_leave_time_for_pruning():
    search = search_at(len(LEVELS) - 1, levels=LEVELS)
    assert search.pruning_due(search.settings.level_ends[-1] + 0.01) == "resolution"


def test_larger_photos_of_an_object_get_finer_last_levels():
    last = [levels_for(Kinds(), "box", pixels)[-1] for pixels in (200, 400, 800)]
    finest = [(level.color.resolution, level.resolution) for level in last]
    assert finest == sorted(finest) and len(set(finest)) == 3
    assert all(pixels / 2.5 < colors for pixels, (colors, _) in zip((200, 400, 800), finest))


@pytest.mark.parametrize("density", ["hash", "vm"])
def test_larger_photos_of_a_forward_facing_capture_get_finer_colors_last(density):
    small, large = (levels_for(Kinds(density), "frustum", pixels) for pixels in (504, 1008))
    assert large[-2] == FULL and large[-1].resolution == FULL.resolution
    assert large[-1].color.resolution > FULL.color.resolution >= small[-1].color.resolution


def test_the_rate_rises_again_after_a_reduction():
    search = search_at()
    assert search.rate == 1.0
    search.begin("resolution", 30.0, 1000, 0.6)
    rates = []
    for _ in range(RAMP):
        rates.append(search.rate)
        search.state.step += 1
    assert 0 < rates[0] <= 0.2 and rates == sorted(set(rates)) and rates[-1] == search.rate == 1.0
    growing = search_at(2)
    growing.begin(GROW, 30.0, 1000, 0.4)
    assert growing.rate == 1.0


def test_what_falls_too_far_at_once_is_not_taught():
    search = search_at()
    search.begin("resolution", 30.0, 1000, 0.6)
    assert search.enough(29.95) and not search.hopeless(29.95)
    assert not search.enough(29.7) and not search.hopeless(29.7)
    assert search.hopeless(28.0) and search.hopeless(float("nan"))


@pytest.mark.parametrize(
    ("what", "bears"), [("color resolution", True), ("color ranks", False), ("density ranks", False)]
)
def test_ranks_must_fall_less_than_resolution(what, bears):
    search = search_at()
    search.begin(what, 30.0, 1000, 0.6)
    assert search.hopeless(29.55) is not bears and not search.hopeless(29.75)


@pytest.mark.parametrize(("now", "then"), [(384, 256), (256, 176), (176, 112), (64, 48), (32, None), (8, None)])
def test_a_color_gets_coarser_by_a_third(now, then):
    search = search_at()
    found = PRUNINGS["color resolution"](CapacityLevel(now, 16, 24), search.settings.kinds, search.settings)
    assert found == ({} if then is None else {"color_resolution": then})
