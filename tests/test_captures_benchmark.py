"""benchmarks/captures.py: what concerns a layout is left out in turn, and near pixels are counted."""

import json

import numpy as np
import pytest

from benchmarks import captures, readme
from tests.test_gpu_benchmark import understood


@pytest.fixture
def commands(monkeypatch):
    """Instead of running stylerf: its arguments, checked by its own parser; fern is forward-facing, fox is not."""
    seen = []

    def run(*arguments: str) -> dict:
        understood([*arguments, "--json"])
        seen.append(arguments)
        return {"figures": {"psnr": 20.0, "ssim": 0.5, "parameters": 9, "train_seconds": 1.0, "occupied_share": 0.25}}

    monkeypatch.setattr(captures, "stylerf", run)
    monkeypatch.setattr(captures, "layout_of", lambda work: "forward" if "fern" in str(work) else "unbounded")
    monkeypatch.setattr(captures, "depths_of", lambda work, name: [np.array([[1.0, 9.0], [9.0, 0.0]])])
    monkeypatch.setattr(captures, "heavy_samples", lambda work, name: 3.4567)
    return seen


def test_each_capture_is_fitted_as_it_is_and_without_each_measure(commands, monkeypatch, tmp_path):
    out = tmp_path / "captures.json"
    monkeypatch.setattr("sys.argv", ["captures", str(tmp_path), str(out), "7", "fern 504x378", "fox 270x480"])
    captures.main()
    rows = json.loads(out.read_text())["rows"]
    scenes = ("fern 504x378", "fox 270x480")
    by_scene = {one: [row["measure"] for row in rows if row["scene"] == one] for one in scenes}
    assert "defaults" in by_scene["fern 504x378"] and "space: contraction" in by_scene["fern 504x378"]
    assert "no near-camera gradient scaling" not in by_scene["fern 504x378"]  # nothing of a forward-facing capture does
    fox = by_scene["fox 270x480"]
    assert "no near-camera gradient scaling" in fox and "space: contraction" not in fox
    fits = [arguments for arguments in commands if arguments[0] == "fit"]
    assert len(fits) == len(rows) and all("7" in arguments for arguments in fits)
    assert rows[0]["near"] == pytest.approx(100 / 3, abs=1e-3)
    assert rows[0]["heavy"] == 3.46 and rows[0]["occupied"] == 25.0
    monkeypatch.setattr(readme, "RESULTS", tmp_path)
    assert readme.captures().count("fern 504x378") == len(by_scene["fern 504x378"])


def test_a_view_in_which_nothing_is_seen_has_no_near_share():
    assert np.isnan(captures.near_share([np.zeros((4, 4))]))
    assert captures.near_share([np.full((4, 4), 5.0), np.zeros((4, 4))]) == 0.0
