"""benchmarks/fits.py and edits.py: a row records the load before its run; the chart marks objects and captures."""

import json
import os

import pytest

from benchmarks import charts, edits, fits


@pytest.fixture
def ran(monkeypatch):
    """Instead of running stylerf: the verbs that ran; the machine's load is their number."""
    seen = []

    def run(verb: str, *_: str) -> dict:
        seen.append(verb)
        figures = {"psnr": 30.0, "ssim": 0.9, "parameters": 1, "steps": 1, "resolution": 1, "train_seconds": 1.0}
        return {"figures": figures, "seconds": {"region": 1.0, "edit": 1.0}}

    monkeypatch.setattr(fits, "stylerf", run)
    monkeypatch.setattr(edits, "stylerf", run)
    monkeypatch.setattr(os, "getloadavg", lambda: (float(len(seen)), 0.0, 0.0))
    return seen


def manifest(folder) -> None:
    folder.mkdir(parents=True)
    figures = {"colors": 4, "sparsity": 0.5, "palette_variation": 0.1, "psnr": 30.0}
    reported = {"seconds": 1.0, "peak_memory_mb": 1.0, "figures": figures}
    (folder / "manifest.json").write_text(json.dumps(reported))


def test_load_is_that_of_before_the_run(ran, tmp_path):
    manifest(tmp_path / "field" / "fit-60s")
    assert fits.measure(tmp_path, "lego 200x200", "60s", tmp_path)["load_before"] == ran.index("fit") == 1
    ran.clear()
    manifest(tmp_path / "lego-400x400" / "edit" / "lego-shovel-recolored-learned")
    row = edits.measure(tmp_path, tmp_path, "lego shovel, recolored", tmp_path)
    assert row["load_before"] == ran.index("edit") == 0


def test_the_chart_draws_a_line_for_each_scene_in_order_of_time():
    def drawn(*seconds: int) -> str:
        scenes = ("lego 200x200", "fern 504x378")
        rows = [{"scene": of, "train_seconds": s, "psnr": 20.0 + s, "ssim": 0.8} for of in scenes for s in seconds]
        return charts.fits_chart({"rows": rows})

    chart = drawn(60, 300)
    assert chart.startswith("<?xml") and chart == drawn(300, 60)
    # Dashed for the object, in each of the two panels and in the legend.
    assert chart.count("stroke-dasharray") == 3 and "lego 200x200" in chart and "fern 504x378" in chart
