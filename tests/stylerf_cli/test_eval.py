"""`stylerf eval`: which field, which frames, what is printed."""

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from schemas.canonical_json import plain
from schemas.images import write_png
from schemas.work_folder import WorkFolder
from stages.configs.render import RenderConfig
from stages.pipeline import evaluation
from stages.render import SPEC, pinned
from stylerf_cli.main import main
from tests.conftest import REPOSITORY
from tests.stages import evaluation_fixture as made

POSITIONS = [-0.2, 0.2]
FAST = ("--perceptual", "none", "--device", "cpu", "--quiet")


@pytest.fixture
def work(tmp_path):
    work = WorkFolder(tmp_path / "work")
    scene = made.make_scene(work, POSITIONS)
    field = made.make_field(work, "wall", "fit", {"scene": scene})
    render(work, field, "test")
    return work


def cameras(path):
    places = POSITIONS if path == "test" else [0.05 * k for k in range(9)]
    return [made.camera(x, f"{Path(path).name}_{i}") for i, x in enumerate(places)]


def render(work, field, path, /, shift=0.0, name="", revision=SPEC.revision, **config):
    views = cameras(path)
    seen = [made.look(view) for view in views]
    seen = [made.Seen(one.rgb + shift, one.alpha, one.z) for one in seen]
    name = name or f"{field.name}-{path}"
    given = {"matched": path == "test", "config": config, "revision": revision}
    return made.make_frames(work, name, path, views, seen, field, **given)


@pytest.fixture
def renderer(monkeypatch):
    """Stands in for the chain that renders what is missing; remembers what it was asked for."""
    requested = []

    def ensure_frames(runner, field, path, name):
        requested.append((field.name, path))
        digest = pinned(RenderConfig(path=path)).path_digest
        return render(runner.work, field, path, name=name, path_digest=digest)

    monkeypatch.setattr(evaluation, "ensure_frames", ensure_frames)
    return requested


def result(capsys, *arguments):
    assert main(["eval", *map(str, arguments), "--json", *FAST]) == 0
    return json.loads(capsys.readouterr().out)


def test_frames_that_stand_are_measured_and_reported(work, renderer, capsys):
    assert main(["eval", str(work.root), *FAST]) == 0
    words = capsys.readouterr().out
    assert "wall on wall, 2 held-out views" in words and "PSNR" in words and "report.html" in words
    found = result(capsys, work.root)
    assert found["figures"]["psnr"] > 40 and found["field"] == "wall" and renderer == []
    assert "short_rmse" not in found["figures"]


def test_other_networks_measure_again(work, renderer, capsys, monkeypatch):
    requested = []
    monkeypatch.setattr(
        "stages.evaluate.available_networks", lambda *given: requested.append(given) or f"n{len(requested)}"
    )
    for number in (1, 2):
        result(capsys, work.root)
        assert work.get("report", "wall").manifest.config["networks"] == f"n{number}"
    assert [given[:3] for given in requested] == [(False, False, "")] * 2


def test_missing_and_outdated_frames_are_rendered(work, renderer, capsys):
    made.make_field(work, "wall", "fit", {"scene": work.get("scene", "wall")}, config={"other": 1})
    result(capsys, work.root)
    assert renderer == [("wall", "test")]
    found = result(capsys, work.root, "--path", "slide")
    assert renderer[1:] == [("wall", "slide")] and found["figures"]["short_rmse"] < 0.02
    assert "short_rmse" in result(capsys, work.root)["figures"]  # the film that is there now is used
    assert len(renderer) == 2


@pytest.mark.parametrize("path", ["test", "train", "views"])
def test_views_of_photos_are_no_film(work, renderer, capsys, path):
    """`fit` leaves frames of path `views`; neighbors among photos show too little of the same."""
    if path != "test":
        render(work, work.get("field", "wall"), path)
    assert "short_rmse" not in result(capsys, work.root)["figures"]
    assert main(["eval", str(work.root), "--path", path, *FAST]) == 2
    assert f"--path {path}" in capsys.readouterr().err and renderer == []


def test_one_frame_is_no_film(work, renderer, capsys):
    field = work.get("field", "wall")
    film = render(work, field, "slide")
    view = made.camera(0.0, "alone")
    made.make_frames(work, "wall-alone", "alone.json", [view], [made.look(view)], field, matched=False)
    found = result(capsys, work.root)
    assert {ref.role: ref.digest for ref in work.get("report", "wall").manifest.inputs}["path_frames"] == film.digest
    assert "short_rmse" in found["figures"]
    shutil.rmtree(film.path)
    assert "short_rmse" not in result(capsys, work.root)["figures"]


@pytest.mark.parametrize("config", [{"exr": False}, {"scale": 0.5}, {"frames": "0-1"}])
def test_unmeasurable_frames_are_kept_and_others_rendered_beside(work, renderer, capsys, config):
    field = work.get("field", "wall")
    kept = [render(work, field, path, **config).digest for path in ("test", "slide")]
    assert "short_rmse" not in result(capsys, work.root)["figures"]
    for _ in range(2):
        found = result(capsys, work.root, "--path", "slide")["figures"]
        assert found["psnr"] > 40 and found["short_rmse"] < 0.02
    assert renderer == [("wall", "test"), ("wall", "slide")]
    inputs = {ref.role: ref.name for ref in work.get("report", "wall").manifest.inputs}
    assert (inputs["frames"], inputs["path_frames"]) == ("wall-test-eval", "wall-slide-eval")
    assert [work.get("frames", name).digest for name in ("wall-test", "wall-slide")] == kept


@pytest.mark.parametrize("wanted", [True, False])
def test_frames_of_an_earlier_render_are_not_measured(work, renderer, capsys, wanted):
    """They are 0.3 too bright. Made by the options that would be asked for they are replaced, others are kept."""
    field = work.get("field", "wall")
    config = plain(pinned(RenderConfig(path="test", count=30))) if wanted else {"count": 7}
    old = render(work, field, "test", shift=0.3, revision=SPEC.revision - 1, **config).digest
    film = render(work, field, "slide", revision=SPEC.revision - 1).digest
    found = result(capsys, work.root)
    assert found["figures"]["psnr"] > 40 and "short_rmse" not in found["figures"] and renderer == [("wall", "test")]
    inputs = {ref.role: ref.name for ref in work.get("report", "wall").manifest.inputs}
    assert inputs["frames"] == ("wall-test" if wanted else "wall-test-eval")
    assert (work.get("frames", "wall-test").digest != old) is wanted
    assert work.get("frames", "wall-slide").digest == film


@pytest.mark.parametrize("file", ["manifest.json", "frames.json"])
def test_damaged_frames_are_passed_over_and_said_once(work, renderer, capsys, file):
    other = made.make_field(work, "other", "fit", {"scene": work.get("scene", "wall")}, config={"other": 1})
    damaged = [render(work, field, "orbit") for field in (other, work.get("field", "wall"))]
    for one in damaged:
        (one.path / file).write_text("{")
    assert main(["eval", str(work.root), "--of", "wall", *FAST[:-1]]) == 0
    reported = capsys.readouterr().err
    assert [reported.count(f"skipping frames {one.name}: ") for one in damaged] == [1, 1]
    # In the place of those that are to be made, it may be of a newer stylerf: not replaced unasked.
    assert main(["eval", str(work.root), "--of", "wall", *FAST[:-1], "--path", "orbit"]) == 4
    assert "wall-orbit" in capsys.readouterr().err and renderer == []


def test_frames_along_a_file_of_cameras_stand_until_it_changes(work, renderer, capsys, tmp_path):
    path = tmp_path / "walk.json"
    for content, count in (("one", 1), ("one", 1), ("two", 2), ("two", 2)):
        path.write_text(content)
        found = result(capsys, work.root, "--path", path)
        assert "short_rmse" in found["figures"] and len(renderer) == count
        digest = hashlib.sha256(content.encode()).hexdigest()
        assert f"the path walk.json ({digest[:8]}) of 9 frames" in found["protocols"]["short_rmse"]


def test_a_film_of_another_length_is_another_protocol(work, renderer, capsys, tmp_path):
    kept = render(work, work.get("field", "wall"), "orbit").digest
    (tmp_path / "nine.toml").write_text("[render]\ncount = 9\n")
    found = result(capsys, work.root, "--path", "orbit", "--config", tmp_path / "nine.toml")
    assert renderer == []
    for key in ("short_rmse", "long_rmse", "short_share"):
        assert "the path orbit of 9 frames" in found["protocols"][key]
    result(capsys, work.root, "--path", "orbit")
    assert renderer == [("wall", "orbit")] and work.get("frames", "wall-orbit").digest == kept


def test_a_bent_field_is_no_measure_of_its_own_bending(work, renderer, capsys):
    """The stylized field keeps the shape of the deformed one, whose depth is a fifth less than the fit's."""
    bent = made.make_field(work, "bent", "deform_init", {"field": work.get("field", "wall")})
    stylized = made.make_field(work, "red", "stylize", {"field": bent})
    views = cameras("test")
    seen = [made.Seen(one.rgb, one.alpha, one.z * 0.8) for one in map(made.look, views)]
    for field in (bent, stylized):
        made.make_frames(work, f"{field.name}-test", "test", views, seen, field)
    found = result(capsys, work.root, "--of", "red")
    assert found["figures"]["shape_change"] == pytest.approx(0.2, abs=1e-3) and renderer == []
    assert "of field wall" in found["protocols"]["shape_change"]


@pytest.mark.parametrize(
    ("options", "code", "reported"),
    [
        (("--gap", "1"), 2, "--gap 1: expected at least 2"),
        (("--style-side", "63"), 2, "--style-side 63: expected at least 64"),
        (("--depth-tolerance", "0"), 2, "--depth-tolerance 0"),
        (("--style", "/nowhere.png"), 3, "--style /nowhere.png: no such file"),
        (("--style", __file__), 3, "test_eval.py"),
        (("--masks", "/nowhere"), 3, "--masks /nowhere"),
        (("--flow", "/nowhere"), 3, "--flow /nowhere"),
        (("--region", "cup"), 4, "no region"),
        (("--robust-to", "red"), 2, "need a stylized field"),
    ],
)
def test_what_cannot_be_measured_is_refused_before_anything_is_rendered(
    work, renderer, capsys, options, code, reported
):
    (work.get("frames", "wall-test").path / "manifest.json").unlink()
    assert main(["eval", str(work.root), *options, *FAST]) == code
    err = capsys.readouterr().err
    assert reported in err and err.count("\n") == 1 and renderer == []


def test_options_without_an_effect_are_named(work, renderer, capsys):
    options = ("--features", "hed-vgg16", "--ring", "20", "--gap", "5")
    assert main(["eval", str(work.root), *options, *FAST[:-1]]) == 0
    said = capsys.readouterr().err
    for words in ("--features, without a style image", "--ring, without a local edit", "--gap, without a camera path"):
        assert f"not used: {words}" in said


def test_a_field_is_not_the_one_before_its_own_edit(work, renderer, capsys):
    made.commit(work, "region", "cup", "region_select", {"field": work.get("field", "wall")}, lambda path: None)
    assert main(["eval", str(work.root), "--of", "wall", "--region", "cup", "--base", "wall", *FAST]) == 2
    assert "--base wall is the edited field itself; name the one before the edit" in capsys.readouterr().err


def test_a_reference_is_of_a_view_of_the_scene_by_name_or_number(work, renderer, capsys, tmp_path):
    made.make_field(work, "red", "stylize", {"field": work.get("field", "wall")})
    write_png(tmp_path / "red.png", np.zeros((72, 96, 3), np.uint8))
    requested = [str(work.root), "--of", "red", *FAST, "--reference"]
    for reference, code, reported in (
        (f"2={tmp_path}/red.png", 3, "--reference: view '2' not found; the scene's 2 views are photo_00, photo_01"),
        ("1=/nowhere.png", 3, "/nowhere.png not found"),
        ("photo_01", 2, "written VIEW=FILE"),
    ):
        assert main(["eval", *requested, reference]) == code
        assert reported in capsys.readouterr().err and renderer == []
    assert main(["eval", *requested, f"#1={tmp_path}/red.png"]) == 0


def test_a_stylized_field_is_set_against_the_fit_it_came_from(work, renderer, capsys):
    fit = work.get("field", "wall")
    stylized = made.make_field(work, "red", "stylize", {"field": fit})
    render(work, stylized, "test", shift=0.1)
    found = result(capsys, work.root, "--of", "red")
    assert found["stylized"] and found["figures"]["shape_change"] == pytest.approx(0, abs=1e-6)
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
    assert done.returncode == 0 and "--of" in done.stdout and "--consistency" in done.stdout
