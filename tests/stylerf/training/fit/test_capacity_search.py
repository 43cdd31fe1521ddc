"""Decisions about capacity, without a field: what is tried, when, and what the views' answer means."""

import pytest

from stylerf.training.fit.capacity_search import PRUNINGS, CapacitySearch
from stylerf.training.fit.settings import FULL, LEVELS, CapacityLevel, FitSettings, FitState, Kinds, levels_for

EVEN = tuple(CapacityLevel(n, table_bits=18) for n in (64, 128, 192, 256))


def search_at(level: int = 3, step: int = 1200, **more) -> CapacitySearch:
    settings = FitSettings(**{"steps": 2000, "levels": EVEN, **more})
    return CapacitySearch(settings, FitState(step=step, level=level, best=30.0), "held-out views")


def tried(search: CapacitySearch, progress: float, quality: float) -> tuple[str, bool]:
    """The next pruning of a field of 30 dB, after which it has `quality`."""
    name = search.pruning_due(progress)
    return name, search.judge_pruning(name, 30.0, quality, (1000, 500))[0]


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
    assert tried(search, 0.56, 30.0) == ("degree", True)
    assert search.settled
    growing = search_at(2, prunings=())
    growing.grow(30.0, 1000, 0.4)
    assert growing.state.level == 3 and not growing.settled  # while it is on trial
    left = search_at(2, prunings=())
    left.state.growth_ended = True
    assert left.settled


def test_nor_once_the_held_out_views_are_trained_on():
    assert search_at(step=1500).pruning_due(0.75) is None
    assert search_at(step=1480).pruning_due(0.74) == "density ranks"


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
    search.grow(29.0, 500, 0.4)
    assert search.judge(29.0 + gain, size)[0] and search.state.level == 3
    search.state.rejected = ["density ranks"]
    assert search.pruning_due(0.6) == ("resolution" if wanted else "color ranks")
    # A search that is dropped says nothing about the level below it.
    search.state.level, search.state.level_gain, search.state.growth_ended = 2, 0.3, False
    search.grow(30.0, 500, 0.4)
    assert not search.judge(30.05, 1000)[0] and search.state.level_gain == 0.3


@pytest.mark.parametrize(
    ("gain", "size", "kept"), [(0.09, 900, True), (0.0, 1000, True), (-0.01, 900, False), (0.09, 1001, False)]
)
def test_a_level_that_is_no_larger_stays_where_nothing_is_lost(gain, size, kept):
    search = search_at(2, min_gain=0.1)
    search.grow(30.0, 1000, 0.4)
    assert search.judge(30.0 + gain, size)[0] is kept
    assert search.state.level == (3 if kept else 2)


def test_a_level_is_not_dropped_after_next_to_no_part_of_the_budget():
    """In a contraction coarse levels end after so many steps, of many thousands a fiftieth."""
    search = search_at(1, step=1350, min_gain=0.1, steps=50_000, level_max_steps=(350, 850, 1350, 1350))
    search.grow(30.0, 1000, 0.027)
    assert search.over(0.038) and search.extended(30.06, 2000, 0.038)
    assert not search.over(0.1) and search.over(0.11)
    assert not search.extended(30.06, 2000, 0.11) and not search.judge(30.06, 2000)[0]
    search = search_at(1, step=1350, min_gain=0.1, steps=50_000, level_max_steps=(350, 850, 1350, 1350))
    search.grow(30.0, 1000, 0.027)
    assert not search.extended(30.2, 2000, 0.038) and search.judge(30.2, 2000)[0]  # what is plain is not waited for


def test_a_capacity_that_was_requested_is_on_no_trial():
    """What it has grown to stands at the next look: a fall leads back to it, not to the level before."""
    search = search_at(2, force_growth=True)
    search.grow(30.0, 1000, 0.4)
    assert search.over(0.4)
    kept, text = search.judge(28.5, 2000)
    assert kept and search.state.level == 3 and text.endswith("as requested")


def test_small_losses_do_not_add_up():
    """What is compared is the best field so far, not the one before the last pruning."""
    search = search_at(min_gain=0.1, prunings=("resolution",))
    assert search.judge_pruning("resolution", 30.0, 29.94, (1000, 900))[0]
    kept, text = search.judge_pruning("resolution", 29.94, 29.88, (900, 800))
    assert not kept and "is too little" in text
    assert search.level.resolution == 192


def test_a_fall_to_a_view_still_met_within_rounding_is_no_loss():
    search = search_at(min_gain=0.1)
    assert search.judge_pruning("resolution", 60.0, 52.0, (1000, 500))[0]
    assert not search.judge_pruning("resolution", 60.0, 47.0, (500, 300))[0]
    assert not search.judge_pruning("density ranks", 60.0, float("nan"), (500, 300))[0]


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


def test_the_summary_says_what_more_or_less_capacity_would_do():
    search = search_at(0, min_gain=0.1, levels=LEVELS)
    search.grow(30.0, 200_000, 0.1)
    assert not search.judge(30.04, 340_000)[0] and search.state.growth_ended
    assert search.summary(200_000) == (
        "vm 64^3 rank 8+16, 0.20 M parameters: 128^3 rank 16+24 would gain 0.04 dB for 1.7x the size"
    )
    search.judge_pruning("resolution", 30.0, 29.0, (200_000, 100_000))
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
    assert large[-1].color.resolution > max(FULL.color.resolution, small[-1].color.resolution)
    brief = levels_for(Kinds(density), "frustum", 504, brief=True)
    assert FULL.color.resolution >= brief[-1].color.resolution


@pytest.mark.parametrize(("now", "then"), [(384, 256), (256, 176), (176, 112), (64, 48), (32, None), (8, None)])
def test_a_color_gets_coarser_by_a_third(now, then):
    search = search_at()
    found = PRUNINGS["color resolution"](CapacityLevel(now, 16, 24), search.settings.kinds, search.settings)
    assert found == ({} if then is None else {"color_resolution": then})
