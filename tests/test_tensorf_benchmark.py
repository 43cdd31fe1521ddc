"""benchmarks/beside_tensorf.py: times follow from the curves, ours stops when it gets there, the table tells ratios."""

import json

from benchmarks import beside_tensorf, charts, readme, tensorf
from tests.test_gpu_benchmark import understood

SHIPPED = {
    "name": "shipped", "command": "python -m benchmarks.tensorf CHECKOUT LEGO OUT.json shipped 100", "parameters": 9,
    "peak_memory_mb": 5900, "curve": [{"seconds": 400, "psnr": 20.0}, {"seconds": 800, "psnr": 24.5}],
}  # fmt: skip
SHORT = SHIPPED | {"name": "short", "command": "... short 300", "curve": [{"seconds": 90, "psnr": 28.5}]}


def test_ours_is_fitted_until_it_gets_there_and_set_beside_theirs(monkeypatch, tmp_path):
    fits = []

    def run(*arguments: str) -> dict:
        understood([*arguments, "--json"])
        if arguments[0] == "fit":
            fits.append(int(arguments[arguments.index("--budget") + 1].rstrip("s")))
            folder = tmp_path / "lego-200x200" / "field" / arguments[arguments.index("--name") + 1]
            folder.mkdir(parents=True)
            (folder / "manifest.json").write_text(json.dumps({"peak_memory_mb": 800.2}))
        return (
            {"figures": {"psnr": 22.0 + fits[-1], "train_seconds": fits[-1], "steps": 5, "parameters": 7}}
            if fits
            else {}
        )

    for name, report in (("shipped.json", SHIPPED), ("short.json", SHORT)):
        (tmp_path / name).write_text(json.dumps(report))
    monkeypatch.setattr(beside_tensorf, "stylerf", run)
    monkeypatch.setenv("STYLERF_BENCH_WORK", str(tmp_path))
    monkeypatch.setattr(
        "sys.argv", ["beside", *(str(tmp_path / n) for n in ("", "tensorf.json", "shipped.json", "short.json"))]
    )
    beside_tensorf.main()
    assert fits == [1, 2, 3, 4, 5, 6, 60]
    report = json.loads((tmp_path / "tensorf.json").read_text())
    assert [row["seconds_to_24_db"] for row in report["rows"]] == [2, 800, 90]
    assert [row["seconds_to_28_db"] for row in report["rows"]] == [6, None, 90]
    monkeypatch.setattr(readme, "RESULTS", tmp_path)
    table = readme.tensorf().splitlines()
    assert "| 800 s (400x) | over 800 s (133x) |" in table[5] and "compressed to 300 steps | 90 s (45x) |" in table[6]
    assert "| 2 s | 6 s | 82.00 dB, 60 s | 0.8 GB |" in table[4]
    assert "mean over all test views for stylerf, over a few" in table[-1]
    assert charts.tensorf_chart(report) == charts.tensorf_chart(report)


def test_as_many_views_are_looked_at_as_the_protocol_tells():
    for count in (3, 25, 200):
        views = tensorf.looked_at(count)
        assert len({*views}) == tensorf.VIEWS == 3 and (views[0], views[-1]) == (0, count - 1)
