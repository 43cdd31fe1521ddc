"""`show`, `verify` and `doctor` on real artifacts."""

import json
import sys
import types

import pytest

from schemas.work_folder import InputRef, Recipe, WorkFolder
from stages.exporting import libraries
from stylerf_cli.main import main
from stylerf_cli.verbs.doctor import HOW, PACKAGES


@pytest.fixture
def work(tmp_path):
    work = WorkFolder(tmp_path / "w")
    inputs: list[InputRef] = []
    for kind, name in (("scene", "fox"), ("field", "fox")):
        begun = work.begin(kind, name, Recipe("toy", 2, {"steps": 3}, inputs, 7))
        (begun.path / "images").mkdir()
        (begun.path / "images" / "a.bin").write_bytes(b"abc" * 1000)
        curve = {"psnr": 27.123456, "curve": list(range(50)), "nested": {"a": 1.0, "b": [1, 2]}}
        artifact = begun.commit(seconds=61, peak_memory_mb=512, figures=curve, versions={"torch": "2.13.0"})
        inputs = [artifact.reference("scene")]
    return work


def test_show_tells_an_artifact_in_words(work, capsys):
    assert main(["show", str(work.root / "field" / "fox")]) == 0
    out = capsys.readouterr().out
    for words in ("field fox", "toy revision 2", "seed 7", "1 min 01 s", "512 MB", "from       scene fox",
                  "psnr    27.1235", "(50 in all)", "3,000  images/a.bin", "torch 2.13.0", "steps  3"):  # fmt: skip
        assert words in out, words


def test_show_lists_the_views_of_a_scene(posed, tmp_path, capsys):
    assert main(["import", str(posed), str(tmp_path / "work"), "--quiet"]) == 0
    capsys.readouterr()
    assert main(["show", str(tmp_path / "work/scene/main")]) == 0
    assert "#1    p01  48x36  train  images/001.png" in capsys.readouterr().out
    assert main(["show", str(tmp_path / "work/scene/main"), "--json"]) == 0
    views = json.loads(capsys.readouterr().out)["views"]
    assert views[0] == {"name": "p00", "image": "images/000.png", "width": 48, "height": 36, "split": "test"}


def test_a_work_folder_in_a_folder_that_is_called_as_a_kind(work, tmp_path, capsys):
    for kind in ("scene", "report"):
        work.root.rename(tmp_path / kind)
        (tmp_path / "w").mkdir()
        (tmp_path / kind).rename(tmp_path / "w" / "fox")
        (tmp_path / "w").rename(tmp_path / kind)
        assert main(["verify", str(tmp_path / kind / "fox")]) == 0
        assert "field fox: sound" in capsys.readouterr().out
        (tmp_path / kind / "fox").rename(work.root)
        (tmp_path / kind).rmdir()


def test_show_json_is_the_manifest(work, capsys):
    for path in ("field/fox", "field/fox/manifest.json"):
        assert main(["show", str(work.root / path), "--json"]) == 0
        shown = json.loads(capsys.readouterr().out)
        assert shown["digest"] == work.get("field", "fox").digest and shown["figures"]["psnr"] == 27.123456
        assert shown["files"][0]["bytes"] == shown["bytes"] == 3000 and shown["outdated"] == []


def test_show_tells_a_work_folder(work, capsys):
    work.begin("frames", "turn", Recipe("render", 1, {}, [])).release()
    (work.root / "scene" / "fox" / "manifest.json").write_text("{}")
    assert main(["show", str(work.root)]) == 0
    out = capsys.readouterr().out
    assert "scene fox  NOT READABLE" in out and "frames turn: interrupted" in out
    assert "field fox" in out and "OUT OF DATE: scene fox, from which fox was made, is not readable" in out
    assert main(["show", str(work.root), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in shown["unfinished"]] == ["turn"] and len(shown["artifacts"]) == 2


@pytest.mark.parametrize("path", ["", "absent", "w/field/fox/images/a.bin", "empty"])
@pytest.mark.parametrize("verb", ["show", "verify"])
def test_paths_that_are_neither_are_refused(work, tmp_path, path, verb, capsys):
    (tmp_path / "empty").mkdir()
    assert main([verb, str(tmp_path / path)]) == 3
    assert capsys.readouterr().err.count("\n") == 1


def test_verify_passes_a_sound_folder_and_a_sound_artifact(work, capsys):
    assert main(["verify", str(work.root)]) == 0
    assert capsys.readouterr().out == "scene fox: sound, 1 files, 0.0 MB\nfield fox: sound, 1 files, 0.0 MB\n"
    assert main(["verify", str(work.root / "field/fox"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["sound"] == 1


@pytest.mark.parametrize("which", ["images/a.bin", "manifest.json"])
def test_verify_finds_a_flipped_bit(work, which, capsys):
    path = work.root / "field" / "fox" / which
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 16
    path.write_bytes(data)
    assert main(["verify", str(work.root / "field/fox")]) == 4
    out, err = capsys.readouterr()
    assert out == "" and which.rpartition("/")[2] in err and err.count("\n") == 1
    assert main(["verify", str(work.root), "--json", "--quiet"]) == 4
    out, err = capsys.readouterr()
    assert err.count("\n") == 1
    result = json.loads(out)
    assert result["exit_code"] == 4 and (result["sound"], result["damaged"]) == (1, 1)
    assert [row["sound"] for row in result["artifacts"]] == [True, False]


def test_verify_refuses_a_folder_of_an_artifact_without_its_manifest(work, capsys):
    (work.root / "field" / "fox" / "manifest.json").unlink()
    assert main(["verify", str(work.root / "field/fox")]) == 4
    assert "no manifest.json" in capsys.readouterr().err


ROWS = [
    {"use": "features", "name": "vgg16", "what": "ImageNet", "found": False, "path": None, "cached": False,
     "chosen": False, "obtain": "run once with internet"},
    {"use": "features", "name": "st-vgg16", "what": "from ST-LPIPS", "found": True, "path": "/x/vgg.pth",
     "cached": False, "chosen": True, "obtain": ""},
]  # fmt: skip


def test_doctor_tells_what_is_here_and_how_to_get_the_rest(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "stages.weights.resolve", types.SimpleNamespace(describe=lambda: ROWS))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    monkeypatch.setattr("stylerf_cli.verbs.doctor.PACKAGES", {"numpy": ("numbers", True), "nosuchthing": ("x", True)})
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert "MISSING  nosuchthing" in out and "-> pip install nosuchthing" in out and "problems found: 1" in out
    assert "-> run once with internet" in out and "/x/vgg.pth (used unless" in out
    assert str(tmp_path / "kernels") in out
    assert main(["doctor", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["problems"] == 1
    assert {check["topic"] for check in result["checks"]} == {
        "python", "packages", "device", "kernels", "weights", "disk"
    }  # fmt: skip


def test_doctor_looks_for_everything_that_exports_and_the_viewer_import():
    assert {*libraries.PACKAGES.values(), "viser"} <= set(PACKAGES) and set(libraries.PACKAGES.values()) <= set(HOW)


def test_doctor_tells_a_cache_that_cannot_be_written(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "stages.weights.resolve", types.SimpleNamespace(describe=list))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc/kernels")
    assert main(["doctor", "--json"]) == 0
    checks = {check["name"]: check for check in json.loads(capsys.readouterr().out)["checks"]}
    assert not checks["cache"]["ok"] and "STYLERF_CACHE" in checks["cache"]["how"]
