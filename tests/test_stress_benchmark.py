"""benchmarks/stress.py: its commands are understood, rows are cells, and documents and heat map follow from them."""

import json

import pytest

from benchmarks import charts, readme, stress
from stages.configs.faults import FAULTS, MADE
from tests.test_gpu_benchmark import understood

MADE_ONES = {name for name, fault in FAULTS.items() if fault.of == MADE}


def cell(method: str, fault: str, successes: int, median: float | None) -> dict:
    more = {"rate": successes / 5, "spread": 0.5, "lowest": median, "seconds": 9.0, "whys": [], "worst": {}}
    return {"method": method, "fault": fault, "successes": successes, "count": 5, "median": median, **more}


@pytest.fixture
def commands(monkeypatch):
    """Instead of running stylerf: its arguments, checked by its own parser, and two cells before and after."""
    seen = []

    def run(*arguments: str) -> dict:
        understood([*arguments, "--json"])
        seen.append(arguments)
        cells = [cell("fit", "views-3", 2, 14.0), cell("fit + remedies", "views-3", 4, 15.5)]
        cells += [cell("arf", "seeds", 5, 0.6), cell("arf + remedies", "seeds", 5, None)]
        reported = {"fault": "views-8", "why": "8 training views: 8 are no fewer"}
        conditions = {"seeds": 5, "side": 64, "budget": "150", "style_budget": "15", "quick": True, "scene": "digest"}
        return {"cells": cells, "missing": [reported], "conditions": conditions}

    monkeypatch.setattr(stress, "stylerf", run)
    return seen


def test_rows_are_cells_by_scene_and_made_scenes_are_run_once(commands, tmp_path):
    out = tmp_path / "stress.json"
    stress.main([str(out), "a/lego", "b/fern", "--methods", "fit", "arf", "--quick", "--seeds", "5"])
    assert [one[1] for one in commands] == ["a/lego", "b/fern"]
    faults = [{*one[one.index("--faults") + 1 : one.index("--remedies")]} for one in commands]
    assert faults[0] == {*FAULTS} and faults[1] == {*FAULTS} - MADE_ONES
    assert all(one[one.index("--methods") + 1 :][:2] == ("fit", "arf") for one in commands)
    report = json.loads(out.read_text())
    assert [row["work"] for row in report["rows"]] == ["lego"] * 4 + ["fern"] * 4
    assert report["rows"][0]["median"] == 14.0 and "scene" not in report["conditions"]
    assert report["missing"][1]["work"] == "fern" and "--methods fit arf --quick --seeds 5" in report["command"]


def test_faults_that_are_requested_are_those_that_run(commands, tmp_path):
    stress.main([str(tmp_path / "o.json"), "lego", "fern", "--faults", "thin", "blur", "--quick"])
    stress.main([str(tmp_path / "o.json"), "lego", "fern", "--faults", "thin"])
    faults = [one[one.index("--faults") + 1 : one.index("--remedies")] for one in commands]
    assert faults == [("blur", "thin"), ("blur",), ("thin",)]


def test_blocks_and_picture_follow_from_the_rows(commands, monkeypatch, tmp_path):
    monkeypatch.setattr(readme, "RESULTS", tmp_path)
    assert readme.stress() == readme.remedies() == ""
    stress.main([str(tmp_path / "stress.json"), "lego", "fern", "--quick", "--seeds", "5"])
    assert "images/stress.svg" in readme.stress() and "64 pixels, 150 steps a fit" in readme.stress()
    reported = "of the 4 cells run both ways 14 of 20 runs succeed without remedies, 18 of 20 with them (70 % and 90 %"
    assert reported in readme.stress() and "alone" not in readme.stress()
    lines = readme.remedies().splitlines()
    assert "| fern | views-3 | fit | 2 of 5, 14.00 dB | 4 of 5, 15.50 dB |" in lines
    assert "| lego | seeds | arf | 5 of 5, 0.600 | 5 of 5, – |" in lines
    assert any(line.startswith("Left out: 0 cells") for line in lines)
    report = json.loads((tmp_path / "stress.json").read_text())
    whole, scenes = charts.stress_chart(report), charts.stress_scenes_chart(report)
    assert whole.startswith("<?xml") and whole == charts.stress_chart(report)
    assert "views-3" in whole and "4/10" in whole and "lego" not in whole
    assert all(word in scenes for word in ("views-3", "lego", "fern", "2/5"))
    assert "images/stress-scenes.svg" in readme.scenes_under_stress()


def test_cells_that_remedies_do_not_touch_are_counted_alone(commands, monkeypatch, tmp_path):
    monkeypatch.setattr(readme, "RESULTS", tmp_path)
    stress.main([str(tmp_path / "stress.json"), "lego", "--quick", "--seeds", "5"])
    report = json.loads((tmp_path / "stress.json").read_text())
    report["rows"][1] |= {"successes": 2, "rate": 0.4, "median": 14.4}
    report["rows"][3] |= {"median": 0.58}
    (tmp_path / "stress.json").write_text(json.dumps(report))
    assert not any(line.startswith("| lego") for line in readme.remedies().splitlines())
    assert "Left out: 2 cells" in readme.remedies()


def test_runs_that_have_no_second_with_remedies_are_summed_apart():
    """Five seeds without and one with in one cell, one and one in another: each cell counts alike in the means."""
    one = {"count": 1, "rate": 1.0}
    rows = [cell("fit", "seeds", 5, 20.0), cell("fit + remedies", "seeds", 1, 20.0) | one,
            cell("arf", "seeds", 0, 0.1) | {"count": 1}, cell("arf + remedies", "seeds", 1, 0.3) | one,
            cell("snerf", "blur", 1, 0.4), cell("refnpr", "blur", 2, 0.4)]  # fmt: skip
    rows = [{"work": "lego", **row} for row in rows]
    assert readme.successes(rows) == (
        "of the 2 cells run both ways 5 of 6 runs succeed without remedies, 2 of 2 with them (50 % and 100 % "
        "averaged over cells); of the cells run without remedies alone 3 of 10 runs"
    )
    assert readme.successes(rows[4:]) == "of the cells run without remedies alone 3 of 10 runs"
