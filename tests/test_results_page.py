"""docs/published.md: verdicts follow the better side; README, the result pages and their charts are up to date."""

import json
import math
import shutil
import sys
from dataclasses import replace

from benchmarks import readme
from benchmarks.published import PUBLISHED, Published
from benchmarks.results_page import ours, page, verdict


def published(value: float, better: str, key: str = "a.b") -> Published:
    return Published("M", "f", value, better, "paper", ("x.json", {"case": "one"}, key), "unlike")


def test_a_figure_is_found_by_its_row_and_key(tmp_path):
    (tmp_path / "x.json").write_text(
        json.dumps({"rows": [{"case": "two", "a": {"b": 9}}, {"case": "one", "a": {"b": 3}}]})
    )
    assert ours(published(1.0, "lower"), tmp_path) == 3.0
    (tmp_path / "x.json").write_text(json.dumps({"rows": [{"case": "two", "a": {"b": 9}}]}))
    assert ours(published(1.0, "lower"), tmp_path) is None
    assert ours(published(1.0, "lower"), tmp_path / "nowhere") is None


def test_the_better_side_decides():
    assert verdict(published(2.0, "lower"), 1.0) == "better" and verdict(published(2.0, "lower"), 3.0) == "worse"
    assert verdict(published(2.0, "higher"), 1.0) == "worse" and verdict(published(2.0, "higher"), 3.0) == "better"
    assert verdict(published(2.0, "higher"), 2.0) == "equal" and verdict(published(2.0, "higher"), None) == "-"
    assert verdict(published(float("nan"), "lower"), 1.0) == "-"
    assert verdict(replace(published(2.0, "lower"), judged=False), 1.0) == "-"


def test_every_published_figure_finds_its_measured_one():
    measured = [one for one in PUBLISHED if one.ours is not None]
    assert measured
    for one in measured:
        assert math.isfinite(ours(one)), one


def test_methods_match_and_a_chosen_budget_gets_no_verdict():
    beside = {(one.method, one.ours[0], one.ours[1].get("method")) for one in PUBLISHED if one.ours}
    assert not any(method.startswith("Ref-NPR") and file == "edits.json" for method, file, _ in beside)
    # These seconds are budgets that we chose: learning, fine-tuning, both, a decomposition.
    keys = {"seconds.edit", "seconds.field", "seconds_after_selection", "seconds"}
    by_budget = [one for one in PUBLISHED if one.ours and one.ours[2] in keys]
    assert len(by_budget) == 4 == page().count(", not a result")
    for one in by_budget:
        (line,) = [line for line in page().splitlines() if line.startswith(f"| {one.method} | {one.what} |")]
        assert "| - |" in line and ", not a result" in line
    assert "4 without a verdict" in page()


def test_a_row_without_a_number_is_no_published_figure():
    unpublished = [one for one in PUBLISHED if math.isnan(one.value)]
    assert unpublished and f"Of {len(PUBLISHED) - len(unpublished)} published figures" in page()


def test_losses_are_counted_and_shown():
    text = page()
    tensorf = "| TensoRF VM-192 | lego, held-out PSNR | 36.46 dB |"
    (row,) = [line for line in text.splitlines() if line.startswith(tensorf)]
    assert "| worse |" in row  # full-size TensoRF is better on lego
    assert f"{text.count('| worse |')} worse" in text
    assert text.count("\n| ") == len(PUBLISHED) + 2


def test_generated_tables_and_charts_are_up_to_date(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["readme", "--check"])
    assert readme.main() == 0


def test_a_chart_of_other_rows_or_none_is_stale(monkeypatch, tmp_path):
    shutil.copytree(readme.IMAGES, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(readme, "IMAGES", tmp_path)
    monkeypatch.setattr(sys, "argv", ["readme", "--check"])
    assert readme.main() == 0
    picture, report = tmp_path / "strategies.svg", readme.result("strategies.json")
    older = readme.mark(report | {"rows": report["rows"][1:]})
    picture.write_text(picture.read_text().replace(readme.mark(report), older))
    assert readme.main() == 1
    picture.unlink()
    assert readme.main() == 1
