"""benchmarks/pareto.py: its commands are understood, failures are kept, and the chart follows from it."""

import json

import pytest

from benchmarks import charts, pareto, readme
from tests.test_gpu_benchmark import understood


@pytest.fixture
def commands(monkeypatch):
    """Instead of running stylerf: its arguments, checked by its own parser; desrf fails, as any method may."""
    seen = []

    def run(*arguments: str) -> dict:
        understood([*arguments, "--json"])
        seen.append(arguments)
        if "desrf" in arguments:
            raise pareto.Failed("the stylization does not converge")
        if arguments[0] != "compare":
            return {}
        runs = []
        reported = (("fits", "fit-grow-10s", "psnr", 10.0), ("stylizations", "arf", "nnfm", 5.0))
        for family, name, key, seconds in reported:
            costs = {"seconds": seconds, "peak_memory_mb": 100.0, "parameters": 5e5}
            more = {"group": "lego", "work": "lego", "method": "vm", "settings": "", "stages": ["fit"]}
            figures = {key: {"mean": 0.25, "label": key}}
            fronts = [f"{key}/seconds"]
            runs.append({"family": family, "name": name, "costs": costs, "metrics": figures, "fronts": fronts, **more})
        return {"runs": runs}

    monkeypatch.setattr(pareto, "stylerf", run)
    return seen


def test_every_combination_is_run_and_what_failed_is_kept(commands, tmp_path):
    out = tmp_path / "pareto.json"
    flags = ["--scenes", "lego,fern", "--capacities", "grow,fixed:64", "--budgets", "5s,10s", "--rays", "auto,dilated"]
    flags += ["--methods", "arf,desrf,snerf", "--style-budgets", "5s", "--flags", "arf=--layers conv2"]
    flags += ["--stylized", "grow"]
    pareto.main([str(tmp_path), str(tmp_path), str(out), *flags])
    verbs = [arguments[0] for arguments in commands]
    assert verbs.count("fit") == 2 * 2 * 2 and verbs.count("stylize") == 2 * (2 * 2 + 1)
    assert verbs.count("eval") == 8 + 6 and verbs.count("compare") == 2  # none of desrf, which failed
    styled = next(arguments for arguments in commands if arguments[0] == "stylize")
    assert styled[styled.index("--of") + 1] == "fit-grow-10s" and styled[-2:] == ("--layers", "conv2")
    snerf = next(arguments for arguments in commands if arguments[0] == "stylize" and "snerf" in arguments)
    assert "--rays" in styled and "--rays" not in snerf  # SNeRF has no such option
    report = json.loads(out.read_text())
    assert len(report["failed"]) == 4 and "converge" in report["failed"][0]["failed"]
    assert report["rows"][0]["figures"] == {"psnr": 0.25} and report["rows"][0]["costs"]["seconds"] == 10.0
    chart = charts.pareto_chart(report)
    assert chart.startswith("<?xml") and chart == charts.pareto_chart(report)


def test_the_block_of_the_readme_is_empty_until_it_is_measured(monkeypatch, tmp_path):
    monkeypatch.setattr(readme, "RESULTS", tmp_path)
    assert readme.pareto() == ""
    row = {"scene": "lego", "name": "desrf-auto", "failed": "it fell over"}
    reported = {"painting": "a.jpg", "machine": {"cores": 2}, "date": "2026-01-01", "command": "c", "failed": [row]}
    (tmp_path / "pareto.json").write_text(json.dumps(reported))
    assert "images/pareto.svg" in readme.pareto() and "Failed: lego desrf-auto: it fell over" in readme.pareto()


def test_a_fault_of_a_command_is_reported_in_its_own_words(tmp_path):
    with pytest.raises(pareto.Failed, match="is not a folder"):
        pareto.stylerf("show", str(tmp_path / "absent"))


def test_labels_of_the_chart_leave_out_what_all_share():
    assert charts.unlike(["arf-patch-40s-of-grow", "desrf-auto-40s-of-grow"]) == ["arf-patch", "desrf-auto"]
    assert charts.unlike(["arf-auto-15s-of-grow", "desrf-auto-40s-of-grow"]) == ["arf-15s", "desrf-40s"]
    assert charts.unlike(["fit-grow-60s", "fit-fixed128x8x16-60s"]) == ["grow", "fixed128x8x16"]
    assert charts.unlike(["fit-a", "fit-a-b"]) == ["a", "a-b"] and charts.unlike(["fit-60s"]) == ["fit-60s"]
