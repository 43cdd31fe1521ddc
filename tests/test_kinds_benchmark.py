"""benchmarks/kinds.py: its commands are understood, and the table follows from the rows."""

import json

from benchmarks import kinds, readme
from tests.test_gpu_benchmark import understood


def test_every_kind_is_fitted_and_becomes_a_row(monkeypatch, tmp_path):
    seen = []

    def run(*arguments: str) -> dict:
        understood([*arguments, "--json"])
        seen.append(arguments)
        if arguments[0] == "fit":
            folder = tmp_path / "work" / "lego-200x200" / "field" / arguments[arguments.index("--name") + 1]
            folder.mkdir(parents=True)
            (folder / "manifest.json").write_text(json.dumps({"peak_memory_mb": 900.0}))
        return {"figures": {"psnr": 30.0, "ssim": 0.9, "parameters": 2_500_000, "steps": 9, "train_seconds": 7.0}}

    monkeypatch.setattr(kinds, "stylerf", run)
    monkeypatch.setattr("benchmarks.capacity.stylerf", run)
    monkeypatch.setattr(kinds, "rays_a_second", lambda work, name: 1.25e6)
    monkeypatch.setenv("STYLERF_BENCH_WORK", str(tmp_path / "work"))
    monkeypatch.setattr("sys.argv", ["kinds", str(tmp_path), str(tmp_path / "kinds.json"), "7s", "lego 200x200"])
    kinds.main()
    fits = [arguments for arguments in seen if arguments[0] == "fit"]
    fields = [arguments[arguments.index("--field") + 1] for arguments in fits]
    assert fields == ["vm", "hash", "voxel", "vm+hash", "hash+vm", "hash"]
    monkeypatch.setattr(readme, "RESULTS", tmp_path)
    table = readme.kinds()
    assert table.count("lego 200x200") == len(kinds.KINDS) and "2.50 M" in table and "1.25 Mrays/s" in table
