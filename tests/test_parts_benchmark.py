"""benchmarks/parts.py: every command is understood, and each method gets its row and its own seconds."""

import json

import pytest

from benchmarks import parts, readme
from tests.test_gpu_benchmark import understood


@pytest.fixture
def commands(monkeypatch, tmp_path):
    """Instead of running stylerf: its arguments, checked by its own parser, and artifacts as it would leave them."""
    seen, field = [], tmp_path / "kept" / "lego-400x400" / "field" / "within"
    figures = {"background_mse": 0.002, "background_ratio": 2.0, "change_lab": 50.0, "bleeding": 0.01}

    def run(*arguments: str) -> dict:
        understood([*arguments, "--json"])
        seen.append(arguments)
        more = {"references": [{"view": "r_7", "file": "reference-7.png"}]}
        return {"figures": figures | more, "field": str(field), "seconds": {"region": 10.0, "edit": 1.0, "field": 3.0}}

    monkeypatch.setattr(parts, "stylerf", run)
    for name, seconds in (("within", 41.0), ("whole", 42.0)):
        folder = field.parent / name
        folder.mkdir(parents=True)
        (folder / "manifest.json").write_text(json.dumps({"seconds": seconds}))
    (field / "reference-7.png").write_bytes(b"picture")
    return seen


def test_a_row_a_method(commands, monkeypatch, tmp_path):
    for folder in ("scene", "field/fit-60s"):
        (tmp_path / "fitted" / "lego-400x400" / folder).mkdir(parents=True)
    monkeypatch.setenv("STYLERF_BENCH_WORK", str(tmp_path / "kept"))
    out = tmp_path / "parts.json"
    monkeypatch.setattr("sys.argv", ["parts", str(tmp_path / "fitted"), str(out), "night.jpg", "lego shovel"])
    parts.main()
    assert [arguments[0] for arguments in commands] == ["edit", "stylize", "stylize", "eval", "eval", "eval"]
    assert "--region" in commands[1] and "--region" not in commands[2]
    picture = tmp_path / "kept" / "lego-400x400" / "r_7.png"
    assert f"r_7={picture}" in commands[2] and picture.read_bytes() == b"picture"
    rows = json.loads(out.read_text())["rows"]
    assert [row["seconds"] for row in rows] == [4.0, 41.0, 42.0]
    monkeypatch.setattr(readme, "RESULTS", tmp_path)
    assert readme.parts().count("| lego shovel |") == 3 and "(0.00100)" in readme.parts()


def test_the_block_of_the_readme_is_empty_until_it_is_measured(monkeypatch, tmp_path):
    monkeypatch.setattr(readme, "RESULTS", tmp_path)
    assert readme.parts() == ""
