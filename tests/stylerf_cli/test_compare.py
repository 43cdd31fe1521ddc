"""`stylerf compare`: what it writes, what it tells, what it refuses."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from schemas.images import write_png
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
    assert main(["verify", str(work.root), "--quiet"]) == 0  # what it writes is not an artifact and spoils none


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


@pytest.fixture
def stylized(tmp_path):
    """Two stylizations of one scene by one style image, in red and in blue, with their frames."""
    work = WorkFolder(tmp_path / "room")
    scene = made.make_scene(work, [0.0, 0.1], depth=False)
    base = runs.fit(work, scene, "fit", 10.0, None)
    write_png(tmp_path / "starry.png", np.full((20, 30, 3), 90, np.uint8))
    for name, tint, sifid in (("red", (1, 0.2, 0.2), 1.0), ("blue", (0.2, 0.2, 1), 2.0)):
        config = {"style": str(tmp_path / "starry.png"), "method": name}
        field = runs.stylized(work, scene, base, name, 20.0, {"sifid": sifid, "edges_kept": 0.5}, **config)
        cameras = [made.camera(x, f"photo_{i:02d}") for i, x in enumerate((0.0, 0.1))]
        seen = [replace(one, rgb=one.rgb * np.float32(tint)) for one in map(made.look, cameras)]
        made.make_frames(work, f"{name}-test", "test", cameras, seen, field)
    return work


def test_votes_on_a_page_of_pairs_are_counted(stylized, tmp_path, capsys):
    root = str(stylized.root)
    assert main(["compare", root, "--pairs", "--json"]) == 0
    reported_text = json.loads(capsys.readouterr().out)
    key = json.loads((stylized.root / "comparison" / "pairs" / f"{Path(reported_text['key']).stem}.json").read_text())
    assert reported_text["pairs"] == 2 and Path(reported_text["page"]).is_file() and {*key["pairs"]} == {"0", "1"}
    labels = [one["label"] for one in key["contenders"]]
    choices = ["left" if labels[pair["left"]] == "red" else "right" for pair in key["pairs"].values()]
    votes = [{"pair": number, "choice": choice, "seconds": 1} for number, choice in enumerate(choices)]
    files = [tmp_path / "one.json", tmp_path / "two.json"]
    for people, path in enumerate(files):
        votes[1] |= {"choice": "same"} if people else {}
        path.write_text(json.dumps({"format": "stylerf votes", "version": 1, "page": key["page"], "votes": votes}))
    assert main(["compare", root, "--votes", *map(str, files)]) == 0
    words = capsys.readouterr().out
    assert "4 votes" in words and "red: won 3 of 3, 100% (44% to 100%), 1 the same" in words
    assert "blue: won 0 of 3, 0% (0% to 56%), 1 the same" in words
    assert "SIFID-style distance, st-vgg16: 3 of 3" in words and "Edges" not in words  # equal edges decide nothing
    page = (stylized.root / "comparison" / "votes.html").read_text()
    assert "room, starry.png" in page and "1.000" in page and "2.000" in page
    kept = json.loads((stylized.root / "comparison" / "votes.json").read_text())
    assert kept["votes"] == 4 and kept["agreement"][0]["won"] == 3
    assert main(["verify", root, "--quiet"]) == 0  # nothing of it is an artifact


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--pairs", "--votes", "a.json"], 2, "give one of them"),
        (["--max-pairs", "5"], 2, "add --pairs"),
        (["--of", "red"], 2, "add --pairs"),
        (["--pairs", "--max-pairs", "0"], 2, "--max-pairs 0: expected 1 to"),
        (["--pairs", "--of", "green"], 2, "--of green: unknown stylization"),
        (["--pairs", "--of", "red"], 4, "no two stylizations"),
        (["--votes", "gone.json"], 3, "gone.json: no such file"),
    ],
)
def test_pairs_and_votes_that_cannot_be_are_refused(stylized, capsys, arguments, code, words):
    assert main(["compare", str(stylized.root), *arguments]) == code
    reported_text = capsys.readouterr().err
    assert words in reported_text and "Traceback" not in reported_text
    assert not (stylized.root / "comparison" / "pairs.html").exists()
