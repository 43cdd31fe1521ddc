"""A quality over views that were trained on is never called one over held-out views."""

import json
import shutil

from stylerf_cli.main import main
from tests.stylerf_cli.conftest import FIT


def fitted(work, capsys, *options) -> tuple[dict, str, str]:
    """Figures, words and notes of a fit."""
    assert main(["fit", str(work), *FIT, *options]) == 0
    words, notes = capsys.readouterr()
    assert main(["fit", str(work), *FIT, *options, "--json", "--quiet"]) == 0
    return json.loads(capsys.readouterr().out)["figures"], words, notes


def test_without_held_out_views_the_figure_is_that_of_training_views(work, capsys):
    figures, words, notes = fitted(work, capsys, "--held-out", "0", "--budget", "30")
    assert figures["held_out_views"] == 0 and figures["held_out_psnr"] is None
    assert not any(point["held_out"] for point in figures["curve"])
    assert figures["training_psnr"] == figures["curve"][-1]["psnr"] > 5
    assert f"training views: {figures['training_psnr']:.2f} dB" in words
    assert "held-out views:" not in words and "held out," not in notes


def test_with_held_out_views_both_figures_are_reported_apart(work, capsys):
    figures, words, _ = fitted(work, capsys, "--held-out", "2", "--budget", "30")
    kept = [point["psnr"] for point in figures["curve"] if point["held_out"]]
    trained = [point["psnr"] for point in figures["curve"] if not point["held_out"]]
    assert figures["held_out_views"] == 2 and kept and trained
    assert (figures["held_out_psnr"], figures["training_psnr"]) == (kept[-1], trained[-1])
    assert f"held-out views: {kept[-1]:.2f} dB (2 training views held out)" in words


def test_what_is_rendered_after_a_fit_is_reported_before(work, capsys):
    options = ["fit", str(work), *(flag for flag in FIT if flag != "--no-buffers")]
    assert main(options) == 0
    reported = "rendering 12 views of 32x32 to EXR and PNG, about 0 MB; --no-buffers skips this"
    assert reported in capsys.readouterr().err
    assert main(options) == 0
    assert "rendering" not in capsys.readouterr().err


def test_a_scene_of_few_views_holds_none_out(photos, tmp_path, capsys):
    """Eight training views: too few to spare one. No figure is reported as of views held out."""
    shutil.copytree(photos, tmp_path / "few")
    listed = json.loads((photos / "transforms_train.json").read_text())
    (tmp_path / "few" / "transforms_train.json").write_text(json.dumps({**listed, "frames": listed["frames"][:8]}))
    assert main(["import", str(tmp_path / "few"), str(tmp_path / "work"), "--quiet"]) == 0
    capsys.readouterr()
    figures, words, notes = fitted(tmp_path / "work", capsys, "--budget", "150", "--capacity", "fixed:96x8x8")
    assert figures["held_out_views"] == 0 and len(figures["decisions"]) == 1
    assert "held-out views:" not in words and "held out," not in notes
    assert all(not one["held_out"] for one in figures["curve"])
