"""A stress in numbers: criteria on pictures whose answer is known, cells, heat map, page, baseline, kept outcomes."""

import json
import statistics
from dataclasses import asdict
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest
from skimage.color import lab2rgb

from schemas.errors import BadInput, UsageError
from stages.configs.faults import FAULTS, METHODS, PALETTE, STYLE
from stages.configs.stress import StressConfig
from stages.stress import test_views
from stages.stress.baseline import compared, read_baseline, write_baseline
from stages.stress.criteria import MIN_GAIN, MIN_STRUCTURE, ViewPair, judge_edit, judge_fit, judge_style
from stages.stress.outcomes import cells_of, load_outcome, save_outcome
from stages.stress.page import build_page, cell_rows, heat_map, rates, run_rows
from stages.stress.test_views import side_by_side
from stylerf.geometry.cameras import Camera
from tests.stages.stress_fixture import outcome
from tests.stylerf.small import SPACES, field_of, wall_in_front

# -- criteria -------------------------------------------------------------------------------------------------------


def photo(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((20, 24, 3)).astype(np.float32)


def off_by(picture: np.ndarray, error: float) -> np.ndarray:
    """A render whose every value is off by `error`: PSNR = -20 log10(error)."""
    signs = np.where(np.random.default_rng(9).random(picture.shape) < 0.5, -1, 1)
    return (picture + error * signs).astype(np.float32)


def test_a_fit_is_set_beside_the_best_picture_of_one_color():
    """Three views in three grays; the best one color is 0.5, off by 0.2, 0.1 and 0.3: 14.81 dB in the mean."""
    grays = [np.full((20, 20, 3), level, np.float32) for level in (0.3, 0.4, 0.8)]
    least = -20 * np.log10(0.2 * 0.1 * 0.3) / 3
    for error, ok in ((0.1227, True), (0.1363, False)):  # 18.22 and 17.31 dB: 3.41 and 2.50 over it
        verdict = judge_fit([ViewPair(f"v{i}", off_by(gray, error), gray) for i, gray in enumerate(grays)])
        assert verdict.ok == ok and bool(verdict.why) != ok
        assert verdict.score == pytest.approx(-20 * np.log10(error), abs=1e-3)
        assert verdict.figures["gain_over_flat"] == pytest.approx(-20 * np.log10(error) - least, abs=1e-3)
    assert MIN_GAIN == 3.0


def test_an_object_is_set_beside_its_own_outlines_in_one_color():
    """On white, a gray blob with the outlines of the object is 15 dB better than white, and shows nothing of it."""
    mask = np.zeros((40, 48), bool)
    mask[10:30, 12:36] = True
    truth = np.where(mask[..., None], 0.5 * np.random.default_rng(1).random((40, 48, 3)), 1.0).astype(np.float32)
    blob, inside = np.where(mask[..., None], np.float32(0.25), np.float32(1)), truth[mask]
    assert judge_fit(
        [ViewPair("v", np.broadcast_to(blob, truth.shape), truth)]
    ).ok  # where nothing tells object and ground
    verdict = judge_fit([ViewPair("v", np.broadcast_to(blob, truth.shape), truth, mask)])
    assert not verdict.ok and "silhouette" in verdict.why
    assert verdict.figures["gain_over_flat"] == pytest.approx(0.0, abs=0.1)
    better = np.where(mask[..., None], truth + 0.5 * (inside.mean(0) - truth), 1.0).astype(np.float32)
    assert judge_fit([ViewPair("v", better, truth, mask)]).figures["gain_over_flat"] == pytest.approx(6.02, abs=0.05)


def test_the_worst_view_is_the_one_that_is_farthest_off():
    views = [ViewPair(f"v{i}", off_by(photo(i), error), photo(i)) for i, error in enumerate((0.01, 0.2, 0.05))]
    assert judge_fit(views).worst == 1
    assert judge_fit([ViewPair("same", photo(), photo())]).score == 100.0  # not infinite: it goes to a file


def test_what_is_not_finite_has_failed_whatever_else():
    broken = photo(1).copy()
    broken[3, 4, 0] = np.nan
    views = [ViewPair("good", photo(), photo()), ViewPair("bad", broken, photo(1))]
    for verdict in (judge_fit(views), judge_style(views, photo(2))):
        assert not verdict.ok and verdict.score is None and verdict.worst == 1 and "1 of 2 views" in verdict.why
    shown = side_by_side(views[1])
    assert shown.shape == (20, 52, 3) and tuple(shown[3, 28 + 4]) == (1, 0, 1) and np.isfinite(shown).all()


def recolored(picture: np.ndarray, mean: np.ndarray, scale: float) -> np.ndarray:
    return (mean + scale * (picture - picture.mean((0, 1)))).astype(np.float32)


def test_a_stylization_keeps_luma_and_takes_colors():
    """The painting is the photo darkened: three tenths of the way leave 0.7 of the distance of means, the limit."""
    seen = photo()
    painting = seen - np.float32(0.6)
    just, not_yet = (ViewPair("v", seen - np.float32(0.6 * share), seen) for share in (0.31, 0.29))
    assert judge_style([just], painting).ok
    verdict = judge_style([not_yet], painting)
    assert not verdict.ok and "colors" in verdict.why
    assert verdict.figures["color_distance_of_photos"] == pytest.approx(0.6 * np.sqrt(3), abs=1e-3)
    assert verdict.figures["color_distance"] == pytest.approx(0.71 * 0.6 * np.sqrt(3), abs=1e-3)
    near = seen - np.float32(0.02)
    assert judge_style([ViewPair("v", seen, seen)], near).ok  # so near that nothing needs to be taken


def test_a_stylization_without_structure_fails_on_smooth_photos_too():
    seen = photo()
    faint = recolored(seen, np.full(3, 0.9, np.float32), 0.02)
    noise = np.random.default_rng(5).random(seen.shape).astype(np.float32)
    for one in (seen, faint):
        flat = recolored(one, one.mean((0, 1)), 0.0)
        for render in (flat, 0.9 * flat + 0.1 * noise):
            verdict = judge_style([ViewPair("v", render, one)], flat)
            assert not verdict.ok and "structure kept" in verdict.why
            # Noise explains a little of anything by chance.
            assert verdict.score < (1e-6 if render is flat else MIN_STRUCTURE / 2)
    assert judge_style([ViewPair("v", flat, faint)], flat).figures["content_ssim"] > 0.8
    # What was light and became dark is still to be seen.
    assert judge_style([ViewPair("v", 1 - seen, seen)], 1 - seen).ok
    kept = judge_style([ViewPair("a", seen, seen), ViewPair("b", recolored(seen, seen.mean((0, 1)), 0.0), seen)], seen)
    assert kept.score == pytest.approx(0.5, abs=2e-3) and kept.worst == 1


def test_of_an_object_only_what_is_there_counts():
    seen = np.ones((40, 40, 3), np.float32)
    seen[10:30, 10:30] = 0.5 * photo()[:20, :20]
    mask = np.zeros((40, 40), bool)
    mask[10:30, 10:30] = True
    render = seen.copy()
    render[~mask] = 0.0  # wrong, but nothing is there
    painting = 0.5 * photo()
    verdict = judge_style([ViewPair("v", render, seen, mask)], painting)
    assert verdict.figures["color_distance"] < 0.1 and verdict.ok
    assert judge_style([ViewPair("v", render, seen)], painting).score < verdict.score - 0.1


def edited_view(inside: float, around: float, mask: np.ndarray | None = None) -> ViewPair:
    """A textured gray view whose grays rise by so much of L* in the part, and around it."""
    if mask is None:
        mask = np.zeros((40, 48), bool)
        mask[10:30, 12:36] = True
    lightness = 40 + 10 * np.random.default_rng(3).random(mask.shape)
    return ViewPair("v", of_lightness(lightness + np.where(mask, inside, around)), of_lightness(lightness), mask)


def of_lightness(lightness: np.ndarray) -> np.ndarray:
    return lab2rgb(np.stack([lightness, *np.zeros((2, *lightness.shape))], -1)).astype(np.float32)


def test_an_edit_changes_its_part_and_nothing_around_it():
    """Grays of one lightness more are 1 apart in CIE76, the whole color difference."""
    verdict = judge_edit([edited_view(20, 1), edited_view(20, 3)])
    assert verdict.ok and verdict.worst == 1 and verdict.score == pytest.approx(0.9, abs=2e-3)
    assert verdict.figures["change_inside"] == pytest.approx(20, abs=0.05)
    assert verdict.figures["change_around"] == pytest.approx(2, abs=0.02)
    for inside, around, why in ((9, 0, "the region changed by 9.0"), (20, 4.5, "its surroundings"), (0, 0, "0.0 dE")):
        verdict = judge_edit([edited_view(inside, around)])
        assert not verdict.ok and why in verdict.why
    assert judge_edit([edited_view(0, 0)]).score == 0 and judge_edit([edited_view(10, 20)]).score == 0


def test_an_edit_that_is_unseen_broken_or_without_content_fails():
    unseen = edited_view(20, 0, np.zeros((40, 48), bool))
    assert judge_edit([unseen]).why == "no test view shows the region"
    assert judge_edit([unseen, edited_view(20, 0)]).ok  # those that show it count
    view = edited_view(20, 0)
    inverted = np.where(view.mask[..., None], 1.3 - view.photo, view.photo)
    assert "content SSIM" in judge_edit([ViewPair("v", inverted, view.photo, view.mask)]).why
    broken = view.render.copy()
    broken[0, 0] = np.nan
    verdict = judge_edit([ViewPair("v", broken, view.photo, view.mask)])
    assert not verdict.ok and verdict.score is None


# -- cells, heat map, page ------------------------------------------------------------------------------------------


def some_outcomes():
    scores = {0: 20.0, 1: 24.0, 2: None, 3: 18.0}
    found = [outcome(seed=seed, score=score, ok=seed in (0, 1), fault="views-3") for seed, score in scores.items()]
    found += [outcome(seed=seed) for seed in range(4)]
    found.append(outcome("arf", "style-white", score=0.1, ok=False, remedies=True, picture="arf.png"))
    found.append(outcome("arf", "style-white", score=0.5, picture="arf2.png"))
    return found


def test_a_cell_is_what_statistics_make_of_its_runs():
    cells = {(cell.fault, cell.method): cell for cell in cells_of(some_outcomes())}
    few = cells["views-3", "fit"]
    assert (few.successes, few.count, few.rate, few.median, few.lowest) == (2, 4, 0.5, 20.0, 18.0)
    assert few.spread == pytest.approx(statistics.stdev([20, 24, 18])) and few.seconds == 8.0
    assert few.worst.seed == 2 and few.whys == ("too far off",)  # without a picture is worse than any score
    lone = cells["style-white", "arf"]
    assert lone.spread is None and cells["style-white", "arf + remedies"].successes == 0
    assert next(iter(cells)) == ("seeds", "fit")  # in the order of the table of faults


def test_the_heat_maps_numbers_are_those_of_the_cells():
    cells = cells_of(some_outcomes())
    faults, methods, table = rates(cells)
    assert faults == ["seeds", "views-3", "style-white"] and methods == ["fit", "arf", "arf + remedies"]
    np.testing.assert_array_equal(table, [[1, np.nan, np.nan], [0.5, np.nan, np.nan], [np.nan, 1, 0]])
    chart = heat_map(cells)
    assert chart.png.startswith(b"\x89PNG") and heat_map(cells).svg == chart.svg
    for text in ("4/4", "2/4", "0/1", "style-white", "+ remedies", "20 ± 3.1"):
        assert text in chart.svg, text
    assert "2 of 4 cells succeed" in chart.description
    assert "arf + remedies under style-white 0 of 1" in chart.description


def test_page_and_tables_tell_the_same(tmp_path):
    outcomes = some_outcomes()
    cells = cells_of(outcomes)
    (tmp_path / "arf.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    page = build_page(cells, heat_map(cells), {"side": 24}, [("views-8", "too few")], None, tmp_path)
    assert page.count("<svg") == 1 and "<script" not in page and page.count("data:image/png") == 1
    assert "2 of 4" in page and "too far off" in page and "too few" in page and "side 24" in page
    assert all(fault.description in unescape(page) for fault in FAULTS.values())
    # The criteria on the page are those in use: SSIM does not judge a stylization (decision 0037).
    criterion = page[page.index("A stylization succeeds") : page.index("A local edit succeeds")]
    assert "at least 0.33" in criterion and "SSIM" not in criterion
    rows = cell_rows(cells)
    assert [row["rate"] for row in rows] == [1.0, 0.5, 1.0, 0.0] and rows[1]["worst_seed"] == 2
    assert len(run_rows(outcomes)) == 10 and run_rows(outcomes)[8]["method"] == "arf + remedies"


# -- baseline -------------------------------------------------------------------------------------------------------


def five(successes: int, median: float, spread: float = 0.0, method="fit", fault="seeds"):
    scores = median + spread * np.array([-1, -0.5, 0, 0.5, 1]) / np.std([-1, -0.5, 0, 0.5, 1], ddof=1)
    return [outcome(method, fault, seed, float(score), seed < successes) for seed, score in enumerate(scores)]


@pytest.mark.parametrize(
    ("now", "verdict"),
    [
        (five(5, 20.0), "same"),
        (five(4, 20.0), "worse"),
        (five(5, 19.6), "same"),  # within the tolerance of half a dB
        (five(5, 19.4), "worse"),
        (five(5, 20.6), "better"),
        (five(5, 18.5, 2.0), "same"),  # 1.5 dB; two standard errors of a spread of 2 are 1.8
        (five(5, 18.0, 2.0), "worse"),
    ],
)
def test_a_baseline_sees_what_is_worse(tmp_path, now, verdict):
    path, conditions = tmp_path / "baseline.json", {"budget": "10", "seeds": 5}
    write_baseline(path, cells_of(five(5, 20.0)), conditions)
    held = compared(read_baseline(path, conditions), cells_of(now))
    assert bool(held.worse) == (verdict == "worse") and bool(held.better) == (verdict == "better")
    assert held.unmatched == []
    assert all(text.startswith("fit under seeds") for text in held.worse + held.better)


def test_weights_and_paintings_count_where_both_have_methods_that_see_one(tmp_path):
    path, fits = tmp_path / "baseline.json", {"seeds": 5, "features": "", "paintings": ""}
    mixed, other = fits | {"features": "a", "paintings": 1}, fits | {"features": "b", "paintings": 2}
    for made, fitting in ((fits, (fits, mixed, other)), (mixed, (fits, mixed))):
        write_baseline(path, cells_of(five(5, 20.0)), made)
        for conditions in fitting:
            assert len(read_baseline(path, conditions)) == 1
    with pytest.raises(UsageError, match="features 'a', now 'b', paintings 1, now 2; use the same"):
        read_baseline(path, other)
    write_baseline(path, cells_of(five(5, 20.0)), {"seeds": 5, "features": "a"})  # of before paintings were reported
    assert len(read_baseline(path, fits)) == 1
    with pytest.raises(UsageError, match="paintings missing"):
        read_baseline(path, mixed)


def test_runs_that_all_break_are_worse_than_runs_that_fail():
    broken = [outcome(seed=seed, score=None, ok=False) for seed in range(5)]
    failing, none = cells_of(five(0, 5.0)), cells_of(broken)
    before = [[asdict(cell) for cell in cells] for cells in (failing, none)]
    assert compared(before[0], none).worse == ["fit under seeds: median score missing, was 5.000"]
    assert compared(before[1], failing).better == ["fit under seeds: median score 5.000, was missing"]
    same = compared(before[1], none)
    assert same.worse == same.better == [] and same.matched == 1


def test_cells_that_lack_runs_are_not_compared_nor_kept(tmp_path):
    path, conditions = tmp_path / "baseline.json", {"seeds": 5}
    write_baseline(path, cells_of(five(5, 20.0)), conditions)
    part = cells_of([*five(5, 0.5, method="arf"), *five(0, 9.0)[:1]])
    held = compared(read_baseline(path, conditions), part)
    assert held.worse == held.better == [] and held.matched == 0
    assert held.unmatched[1:] == ["fit under seeds: number of runs 1, was 5"]
    kept = path.read_bytes()
    with pytest.raises(UsageError, match="fit under seeds has 1 of 5 runs; rerun without --only"):
        write_baseline(path, part, conditions)
    assert path.read_bytes() == kept


def test_cells_of_one_side_are_reported_and_not_judged(tmp_path):
    path, conditions = tmp_path / "baseline.json", {"seeds": 5}
    write_baseline(path, cells_of([*five(5, 20.0), *five(5, 0.5, method="arf")]), conditions)
    held = compared(read_baseline(path, conditions), cells_of([*five(5, 20.0), *five(0, 9.0, fault="blur")]))
    assert held.worse == held.better == []
    assert held.unmatched == ["arf under seeds: only in the baseline", "fit under blur: not in the baseline"]


def test_other_conditions_and_files_that_are_none_are_refused(tmp_path):
    path = tmp_path / "baseline.json"
    with pytest.raises(BadInput, match="--write-baseline"):
        read_baseline(path, {})
    conditions = {"budget": "10", "seeds": 5}
    write_baseline(path, cells_of(five(5, 20.0)), conditions)
    with pytest.raises(UsageError, match="budget '10', now '20'"):
        read_baseline(path, conditions | {"budget": "20"})
    with pytest.raises(UsageError, match="other conditions: criteria missing; use the same, or write a new one"):
        read_baseline(path, conditions | {"criteria": 3})  # of before it was kept
    content = json.loads(path.read_text())
    for damaged in (
        "[]",
        "{",
        json.dumps(content | {"cells": [{"method": "fit"}]}),
        json.dumps(content | {"schema": 9}),
        json.dumps(content | {"conditions": []}),
        json.dumps(content | {"cells": {}}),
        *(
            json.dumps(content | {"cells": [content["cells"][0] | {key: wrong}]})
            for key, wrong in (("median", "x"), ("median", float("nan")), ("spread", "3"), ("successes", "5"),
                               ("count", 0), ("method", []))
        ),
    ):  # fmt: skip
        path.write_text(damaged)
        with pytest.raises(BadInput):
            read_baseline(path, conditions)


# -- outcomes on disk, options --------------------------------------------------------------------------------------


def test_an_outcome_stands_under_its_key_alone(tmp_path):
    one = outcome(seed=3, score=None, ok=False, figures={"psnr": 1.5})
    save_outcome(tmp_path, one)
    assert one.name == "fit--seeds--3--k"
    assert load_outcome(tmp_path, one.name, "k") == one
    other = outcome(seed=3, key="another", score=1.0)
    save_outcome(tmp_path, other)
    assert load_outcome(tmp_path, one.name, "k") == one and load_outcome(tmp_path, other.name, "another") == other
    (tmp_path / "runs" / f"{other.name}.json").rename(tmp_path / "runs" / "fit--seeds--3.json")  # as before
    assert load_outcome(tmp_path, other.name, "another") == other
    assert load_outcome(tmp_path, one.name, "third") is None and load_outcome(tmp_path, "none", "k") is None
    (tmp_path / "runs" / f"{one.name}.json").write_text('{"key": "k"}')
    assert load_outcome(tmp_path, one.name, "k") is None


def test_options_choose_and_refuse():
    whole = StressConfig(methods=("all",))
    assert whole.chosen_methods == [*METHODS] and whole.chosen_faults == [*FAULTS]
    some = StressConfig(methods=("arf", "fit", "arf"), faults=("blur", "seeds"))
    assert some.chosen_methods == ["fit", "arf"] and some.chosen_faults == ["seeds", "blur"]
    assert StressConfig().conditions["seeds"] == 5 and StressConfig(quick=True).conditions["seeds"] == 2
    assert StressConfig(quick=True, budget="7", side=40).conditions["budget"] == "7"
    assert StressConfig(budget="30s").conditions["style_budget"] == "30s"
    for wrong in ({"methods": ("magic",)}, {"faults": ("fire",)}, {"budget": "soon"}, {"seeds": -1}, {"side": 8}):
        with pytest.raises(ValueError):
            StressConfig(**wrong)
    facing = {name: {fault.of for fault in FAULTS.values() if one.faces(fault)} for name, one in METHODS.items()}
    assert not facing["fit"] & {STYLE, PALETTE} and facing["arf"] == facing["laenerf-paint"] == {"scene", "made", STYLE}
    assert facing["laenerf-recolor"] == facing["palettenerf"] == {"scene", "made", PALETTE}
    assert not METHODS["palettenerf"].faces(FAULTS["palette-random"])
    assert all("{" not in fault.description for fault in FAULTS.values())


def test_what_a_mask_hides_in_a_capture_judges_no_method(monkeypatch):
    """Transparency in an object's photo is background; in a capture's it is hidden: nothing is asked there."""
    camera = Camera("v", 16, 16, 14.0, 14.0, 8.0, 8.0, np.eye(4))
    pixels = np.full((16, 16, 4), 0.25, np.float32)
    pixels[..., 3] = 1.0
    pixels[:, :8, 3] = 0.0
    data = SimpleNamespace(cameras=[camera], splits={"test": [0]}, images=lambda index: pixels)
    monkeypatch.setattr(test_views, "load_scene", lambda artifact: data)
    for field, hidden in ((wall_in_front(0.02), True), (field_of(SPACES["box"], 1), False)):
        monkeypatch.setattr(test_views, "load_field", lambda artifact, field=field: (field, "none"))
        (view,) = test_views.view_pairs(None, None, 1)
        assert (view.mask is None) == hidden
        left = view.render if hidden else np.zeros_like(view.render)
        np.testing.assert_allclose(view.photo[:, :8], left[:, :8], atol=1e-6)
        assert (view.photo[:, 8:] == 0.25).all()
