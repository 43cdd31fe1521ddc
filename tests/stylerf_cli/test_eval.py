"""`stylerf eval`: which field, which frames, what is printed."""

import json
import subprocess
import sys

import pytest

from schemas.store import Work
from stylerf_cli import chains
from stylerf_cli.main import main
from tests.conftest import REPOSITORY
from tests.stages import evaluation_fixture as made

POSITIONS = [-0.2, 0.2]
FAST = ("--perceptual", "none", "--device", "cpu", "--quiet")


@pytest.fixture
def work(tmp_path):
    work = Work(tmp_path / "work")
    scene = made.make_scene(work, POSITIONS)
    field = made.make_field(work, "wall", "fit", {"scene": scene})
    render(work, field, "test")
    return work


def cameras(path):
    places = POSITIONS if path == "test" else [0.05 * k for k in range(9)]
    return [made.camera(x, f"{path}_{i}") for i, x in enumerate(places)]


def render(work, field, path, shift=0.0):
    views = cameras(path)
    seen = [made.look(view) for view in views]
    seen = [made.Seen(one.rgb + shift, one.alpha, one.z) for one in seen]
    return made.make_frames(work, f"{field.name}-{path}", path, views, seen, field, matched=path == "test")


@pytest.fixture
def renderer(monkeypatch):
    """Stands in for the chain that renders what is missing; remembers what it was asked for."""
    asked = []

    def ensure_frames(session, field, path="test"):
        asked.append((field.name, path))
        return render(session.work, field, path)

    monkeypatch.setattr(chains, "ensure_frames", ensure_frames)
    return asked


def result(capsys, *arguments):
    assert main(["eval", *map(str, arguments), "--json", *FAST]) == 0
    return json.loads(capsys.readouterr().out)


def test_frames_that_stand_are_measured_and_told(work, renderer, capsys):
    assert main(["eval", str(work.root), *FAST]) == 0
    words = capsys.readouterr().out
    assert "wall on wall, 2 held-out views" in words and "PSNR" in words and "report.html" in words
    found = result(capsys, work.root)
    assert found["figures"]["psnr"] > 40 and found["field"] == "wall" and renderer == []
    assert "short_rmse" not in found["figures"]


def test_missing_and_outdated_frames_are_rendered(work, renderer, capsys):
    made.make_field(work, "wall", "fit", {"scene": work.get("scene", "wall")}, config={"other": 1})
    result(capsys, work.root)
    assert renderer == [("wall", "test")]
    found = result(capsys, work.root, "--path", "slide")
    assert renderer[1:] == [("wall", "slide")] and found["figures"]["short_rmse"] < 0.02
    assert "short_rmse" in result(capsys, work.root)["figures"]  # the film that is there now is used
    assert len(renderer) == 2


def test_a_stylised_field_is_set_against_the_fit_it_came_from(work, renderer, capsys):
    fit = work.get("field", "wall")
    stylised = made.make_field(work, "red", "stylize", {"field": fit})
    render(work, stylised, "test", shift=0.1)
    found = result(capsys, work.root, "--of", "red")
    assert found["stylised"] and found["figures"]["shape_change"] == pytest.approx(0, abs=1e-6)
    assert renderer == []
    roles = {ref.role for ref in work.get("report", "red").manifest.inputs}
    assert roles == {"scene", "field", "frames", "base_frames"}


def test_the_field_made_last_is_the_default(work, renderer, capsys):
    made.make_field(work, "abstract", "stylize", {"field": work.get("field", "wall")})
    assert result(capsys, work.root)["field"] == "abstract"
    assert renderer == [("abstract", "test")]


def test_a_work_folder_without_a_field_says_how_to_make_one(tmp_path, capsys):
    assert main(["eval", str(tmp_path), *FAST]) == 4
    assert f"stylerf fit {tmp_path}" in capsys.readouterr().err


def test_help_imports_no_torch():
    code = "import sys; from stylerf_cli.main import main; main(['eval', '--help']); sys.exit('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=REPOSITORY, check=False)
    assert done.returncode == 0 and "--of" in done.stdout and "--depth-tolerance" in done.stdout
