"""A palette of the whole scene, command by command: learned, changed, around a place, rendered, evaluated."""

import json
from pathlib import Path

import numpy as np
import pytest

from schemas.exr import read_exr
from schemas.work_folder import WorkFolder
from stages.artifacts.field import load_field
from stylerf_cli.main import main

LEARN = ("--method", "palettenerf", "--budget", "120", "--refit-steps", "60", "--pixels", "512", "--levels", "4",
         "--finest", "64", "--table-bits", "12")  # fmt: skip


def said(capsys, *arguments: object) -> dict:
    """The --json object of one command that must succeed."""
    assert main([*map(str, arguments), "--json", "--quiet"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def refused(capsys, code: int, *arguments: object) -> str:
    assert main([*map(str, arguments), "--quiet"]) == code
    return capsys.readouterr().err


def pictures(capsys, work: Path, name: str) -> np.ndarray:
    """[views, h, w, 4] linear: the test views of a field."""
    said(capsys, "render", work, "--of", name, "--path", "test", "--no-regions")
    views = [read_exr(path) for path in sorted((work / "frames" / f"{name}-test" / "exr").glob("*.exr"))]
    return np.stack([np.concatenate([view.rgb, view.alpha[..., None]], -1) for view in views])


@pytest.mark.slow
def test_a_palette_is_learned_once_and_changed_without_learning(work, capsys):
    learned = said(capsys, "stylize", work, "--of", "fit", *LEARN, "--name", "palette")
    assert learned["name"] == "palette" and learned["figures"]["colors"] == 4
    entries = json.loads((Path(learned["field"]) / "palette.json").read_text())["colors"]
    assert [one["share"] for one in entries] == sorted((one["share"] for one in entries), reverse=True)
    requested = ("--method", "palettenerf", "--palette", "0=#10e020")
    everywhere = said(capsys, "stylize", work, "--of", "palette", *requested, "--name", "green")
    here = said(
        capsys, "stylize", work, "--of", "palette", *requested, "--at", "#0:16,16", "--reach", "0.2", "--name", "here"
    )
    assert everywhere["seconds"] < 20 and here["figures"]["learned"] == "palette"
    plain, green, local = (pictures(capsys, work, name) for name in ("palette", "green", "here"))
    assert np.array_equal(plain[..., 3], green[..., 3]) and np.array_equal(plain[..., 3], local[..., 3])
    changed, less = (np.abs(one - plain).max(-1) > 0.02 for one in (green, local))
    assert changed.sum() > 20 and less.sum() < changed.sum()
    report = said(capsys, "eval", work, "--of", "green", "--perceptual", "none")
    assert report["figures"]["sparsity"] == learned["figures"]["sparsity"] and report["figures"]["psnr"] > 5
    assert "pixels that show the scene" in report["protocols"]["sparsity"]
    assert "already has a palette" in refused(capsys, 2, "stylize", work, "--of", "green", "--method", "palettenerf")
    assert "options for learning" in refused(capsys, 2, "stylize", work, "--of", "palette", *requested, "--bases", "5")
    densities = [load_field(WorkFolder(work).get("field", name))[0].density.values for name in ("fit", "green")]
    assert np.array_equal(*densities)


@pytest.mark.slow
def test_what_is_learned_for_a_change_stands_beside_it(work, capsys):
    few = (*LEARN[:2], "--budget", "6", "--refit-steps", "4", *LEARN[6:])
    made = said(capsys, "stylize", work, "--of", "fit", *few, "--palette", "all=#2030f0", "--name", "blue")
    learned = WorkFolder(work).get("field", "fit-palettenerf")
    assert made["name"] == "blue" and learned.manifest.stage == "decompose"
    other = said(capsys, "stylize", work, "--of", "fit", *few, "--palette", "0=#ff0000", "--name", "red")
    assert other["figures"]["learned"] == "fit-palettenerf"
    assert WorkFolder(work).get("field", "fit-palettenerf").manifest.created == learned.manifest.created


def test_a_file_can_choose_the_method_and_its_options(work, tmp_path, capsys):
    options = tmp_path / "options.toml"
    options.write_text(
        '[stylize]\nmethod = "palettenerf"\nbases = 4\nbudget = "4"\nrefit_steps = 2\nfinest = 64\ntable_bits = 12\n'
    )
    made = said(capsys, "stylize", work, "--config", options, "--name", "by-file")
    assert WorkFolder(work).get("field", "by-file").manifest.stage == "decompose" and made["figures"]["colors"] == 4
