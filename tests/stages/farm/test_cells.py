"""Cells, ranks and fronts against values worked out by hand."""

import statistics

import pytest

from stages.comparison.runs import STYLIZATIONS, Run, RunMetric
from stages.farm.cells import cells_of, fronts_of, standings_of
from stages.farm.jobs import Axes

BETTER = {"sifid": "lower", "edges_kept": "higher", "seconds": "lower", "short_rmse": "lower", "long_rmse": "lower"}


def run(scene: str, method: str, seed: int, protocol: str = "p", left_out: int = 0, **values: float):
    metrics = {
        key: RunMetric(value, key, "", BETTER[key], protocol, 3, left_out)
        for key, value in values.items() if key != "seconds"
    }  # fmt: skip
    costs = {"seconds": values.get("seconds", 1.0), "peak_memory_mb": 100.0, "parameters": None}
    made = Run(STYLIZATIONS, scene, f"x-{method}-s{seed}", "g", method, "", "cpu", ("stylize",), costs, metrics)
    return made, Axes(scene, "x", method, seed)


def test_spread_is_that_of_the_seeds():
    values = [1.0, 2.0, 4.0]
    cell, = cells_of([run("a", "m", seed, sifid=value) for seed, value in enumerate(values)])
    found = cell.values["sifid"]
    assert (found.mean, found.spread, found.count) == (
        pytest.approx(7 / 3), pytest.approx(statistics.stdev(values)), 3,
    )  # fmt: skip
    assert cells_of([run("a", "m", 0, sifid=1.0)])[0].values["sifid"].spread is None


def test_values_of_another_protocol_or_with_views_missing_do_not_count():
    runs = [run("a", "m", 0, sifid=1.0), run("a", "m", 1, "q", sifid=9.0), run("a", "m", 2, left_out=1, sifid=9.0)]
    assert cells_of(runs)[0].values["sifid"].count == 1


def test_ranks_share_places_and_follow_the_better_end():
    runs = [
        run("a", "m", 0, sifid=1.0, edges_kept=0.2), run("a", "n", 0, sifid=3.0, edges_kept=0.2),
        run("b", "m", 0, sifid=4.0, edges_kept=0.1), run("b", "n", 0, sifid=2.0, edges_kept=0.9),
    ]  # fmt: skip
    found = {(one.method, one.column): one for one in standings_of(cells_of(runs), BETTER)}
    assert (found["m", "sifid"].rank, found["n", "sifid"].rank) == (1.5, 1.5)
    assert (found["m", "edges_kept"].rank, found["n", "edges_kept"].rank) == (1.75, 1.25)
    assert found["m", "sifid"].relative == pytest.approx((1 / 2 + 4 / 3) / 2)


def test_a_block_that_lacks_a_method_ranks_none():
    runs = [run("a", "m", 0, sifid=1.0), run("a", "n", 0, sifid=3.0), run("b", "m", 0, sifid=9.0)]
    assert {one.blocks for one in standings_of(cells_of(runs), BETTER) if one.column == "sifid"} == {1}


def test_blur_is_on_the_front_only_where_nothing_is_better_at_both():
    runs = [
        run("a", "painterly", 0, sifid=1.0, short_rmse=3.0), run("a", "blurred", 0, sifid=5.0, short_rmse=1.0),
        run("a", "worse", 0, sifid=5.0, short_rmse=3.0),
    ]  # fmt: skip
    assert set(fronts_of(cells_of(runs), BETTER)["short_rmse"].best) == {"painterly", "blurred"}


def test_a_front_is_of_the_blocks_that_have_both_figures():
    """In scene b, which has no consistency, m is far from the style: that must not take it off the front of scene a."""
    runs = [
        run("a", "m", 0, sifid=1.0, long_rmse=1.0), run("a", "n", 0, sifid=3.0, long_rmse=2.0),
        run("b", "m", 0, sifid=9.0), run("b", "n", 0, sifid=1.0),
    ]  # fmt: skip
    front = fronts_of(cells_of(runs), BETTER)["long_rmse"]
    assert front.best == ("m",)
    assert front.points["m"] == pytest.approx((2 / 3, 1 / 2))
