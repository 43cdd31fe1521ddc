"""benchmarks/palettes.py: every command is understood, and each method gets its row and its own seconds."""

import json

import pytest

from benchmarks import palettes, readme
from tests.test_gpu_benchmark import understood

SECONDS = {"edit/lego-shovel-learned": 7.0, "field/palette": 60.0, "field/palette-everywhere": 1.5,
           "field/palette-within": 2.5}  # fmt: skip


@pytest.fixture
def commands(monkeypatch):
    """Instead of running stylerf: its arguments, checked by its own parser, and manifests as it would leave them."""
    seen = []

    def run(*arguments: str) -> dict:
        understood([*arguments, "--json"])
        seen.append(arguments)
        return {"figures": {"background_mse": 0.002, "background_ratio": 2.0, "change_lab": 50.0, "bleeding": 0.01},
                "seconds": {"region": 10.0, "edit-dataset": 3.0, "edit": 1.0}}  # fmt: skip

    monkeypatch.setattr(palettes, "stylerf", run)
    return seen


def test_a_row_a_method(commands, monkeypatch, tmp_path):
    scene = tmp_path / "fitted" / "lego-400x400"
    for folder in (scene / "scene", scene / "field" / "fit-60s"):
        folder.mkdir(parents=True)
    kept = tmp_path / "kept" / "lego-400x400"
    for name, seconds in SECONDS.items():
        (kept / name).mkdir(parents=True)
        figures = {"colors": 4, "sparsity": 0.5, "palette_variation": 0.1}
        (kept / name / "manifest.json").write_text(json.dumps({"seconds": seconds, "figures": figures}))
    monkeypatch.setenv("STYLERF_BENCH_WORK", str(tmp_path / "kept"))
    out = tmp_path / "palettes.json"
    monkeypatch.setattr("sys.argv", ["palettes", str(tmp_path / "fitted"), str(out), "lego shovel"])
    palettes.main()
    palettes.main()  # on folders that stand
    del commands[:7]
    assert [arguments[0] for arguments in commands] == ["edit", "eval", "stylize", "stylize", "eval", "stylize", "eval"]
    assert "--at" not in commands[3] and "--at" in commands[5]
    rows = json.loads(out.read_text())["rows"]
    # Without the selection, with the learning that a changed palette had before it.
    assert [row["seconds"] for row in rows] == [3 + 1 + 7, 61.5, 62.5]
    monkeypatch.setattr(readme, "RESULTS", tmp_path)
    assert readme.palettes().count("| lego shovel |") == 3 and "(0.00100)" in readme.palettes()


def test_the_block_of_the_readme_is_empty_until_it_is_measured(monkeypatch, tmp_path):
    monkeypatch.setattr(readme, "RESULTS", tmp_path)
    assert readme.palettes() == ""
