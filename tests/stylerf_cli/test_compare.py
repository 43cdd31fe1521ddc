"""`stylerf compare`: what it writes, what it tells, what it refuses."""

import csv
import json

import pytest

from schemas.work_folder import WorkFolder
from stylerf_cli.main import main
from tests.stages import comparison_fixture as runs
from tests.stages import evaluation_fixture as made


@pytest.fixture
def work(tmp_path):
    work = WorkFolder(tmp_path / "room")
    scene = made.make_scene(work, [0.0], depth=False)
    base = runs.fit(work, scene, "fit-10s", 10.0, 25.0)
    runs.fit(work, scene, "fit-60s", 60.0, 28.0)
    runs.stylized(work, scene, base, "starry", 20.0, {})
    return work


def test_files_and_json_tell_the_same_and_nothing_else_changes(work, capsys):
    before = {path: path.stat().st_mtime_ns for path in work.root.rglob("*")}
    assert main(["compare", str(work.root), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    out = work.root / "comparison"
    assert result["page"] == str(out / "compare.html") and (out / "compare.html").is_file()
    kept = json.loads((out / "compare.json").read_text())
    assert {key: result[key] for key in kept} == kept
    fits = {run["name"]: run for run in kept["runs"]}
    assert fits["fit-60s"]["metrics"]["psnr"]["mean"] == 28.0 and "psnr/seconds" in fits["fit-60s"]["fronts"]
    assert any("room/starry: all metrics" == gap["what"] for gap in kept["missing"])
    for name in kept["charts"]:
        assert (out / name).is_file() and (out / name).with_suffix(".png").is_file()
    with open(out / "runs.csv", newline="") as stream:
        rows = {row["name"]: row for row in csv.DictReader(stream)}
    assert rows["fit-10s"]["psnr"] == "25.0" and rows["starry"]["psnr"] == "" and rows["starry"]["seconds"] == "20.0"
    for path, time in before.items():
        if path != work.root:
            assert path.stat().st_mtime_ns == time
    assert main(["verify", str(work.root), "--quiet"]) == 0  # what it writes is no artifact and spoils none


def test_words_and_another_place(work, tmp_path, capsys):
    assert main(["compare", str(work.root), str(work.root), "--out", str(tmp_path / "here")]) == 0
    words = capsys.readouterr().out
    assert "* fit           room/fit-60s: 60 s, PSNR 28 dB" in words
    assert "room/starry: 20 s, not evaluated" in words and "missing: room/starry: all metrics" in words
    assert (tmp_path / "here" / "charts" / "fits_seconds.png").is_file()
    assert not (work.root / "comparison").exists()


def test_a_folder_written_in_two_ways_is_compared_once(work, monkeypatch, capsys):
    monkeypatch.chdir(work.root.parent)
    assert main(["compare", "room", str(work.root), "room/../room", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["works"] == ["room"] and len(reported["runs"]) == 3


def test_what_is_no_work_folder_is_refused(work, tmp_path, capsys):
    assert main(["compare", str(tmp_path / "absent")]) == 3
    assert main(["compare", str(work.root / "field" / "fit-10s")]) == 2
    bare = WorkFolder(tmp_path / "bare")
    made.make_scene(bare, [0.0], depth=False)
    assert main(["compare", str(bare.root)]) == 4
    assert f"stylerf fit {bare.root}" in capsys.readouterr().err
    assert main(["compare"]) == 2


def test_leftovers_of_a_killed_comparison_are_deleted(work):
    out = work.root / "comparison"
    (out / "charts").mkdir(parents=True)
    left = [out / ".compare.0a1b2c3d.tmp.html", out / "charts" / ".fits_seconds.0a1b2c3d.tmp.svg"]
    for path in left:
        path.write_text("half")
    assert main(["compare", str(work.root), "--quiet"]) == 0
    assert not any(path.exists() for path in left) and (out / "charts" / "fits_seconds.svg").is_file()
