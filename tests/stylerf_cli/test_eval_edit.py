"""`stylerf eval --region`: which field stands for the unedited one, which photos, which frames; what is refused."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from schemas.images import write_png
from stages.artifacts.provenance import original_scene
from stylerf_cli.main import main
from tests.stages import evaluation_fixture as made
from tests.stylerf_cli import test_eval
from tests.stylerf_cli.test_eval import FAST, result

renderer, work = test_eval.renderer, test_eval.work


@pytest.fixture
def edited(work):
    """A field fine-tuned on edited pictures of the scene, a little brighter in the left half of its views."""
    scene, fit = work.get("scene", "wall"), work.get("field", "wall")
    region = made.commit(work, "region", "left", "select", {"field": fit}, lambda folder: (folder / "r").write_text(""))
    data = made.commit(work, "edit-dataset", "left", "extract", {"scene": scene, "region": region}, blank)
    edit = made.commit(work, "edit", "blue", "stylize", {"dataset": data}, blank)
    pictures = made.commit(work, "scene", "blue", "distill", {"edit": edit, "dataset": data}, blank)
    field = made.make_field(work, "blue", "finetune", {"scene": pictures, "field": fit})
    for path in ("test", "train"):
        views = [replace(view, name=f"{path}_{i}") for i, view in enumerate(test_eval.cameras("test"))]
        for of, shift in ((fit, 0.0), (field, 0.1)):
            seen = [made.look(view) for view in views]
            seen = [made.Seen(one.rgb + shift * left()[..., None], one.alpha, one.z) for one in seen]
            made.make_frames(work, f"{of.name}-{path}", path, views, seen, of)
    return field


def blank(folder):
    (folder / "numbers").write_bytes(b"\0")


def left() -> np.ndarray:
    return (np.arange(96) < 48) & np.ones((72, 1), bool)


@pytest.fixture
def masks(tmp_path):
    """Of the left half, for all views."""
    for path in ("test", "train"):
        for i in range(2):
            write_png(tmp_path / "masks" / f"{path}_{i}.png", left().astype(np.uint8) * 255)
    return tmp_path / "masks"


def test_an_edited_field_is_set_against_the_one_it_started_from(work, edited, masks, renderer, capsys):
    found = result(capsys, work.root, "--of", "blue", "--region", "left", "--masks", masks)
    assert not found["stylized"] and renderer == []
    assert found["figures"]["background_ratio"] == pytest.approx(1, abs=0.02)
    assert found["figures"]["change_inside"] == pytest.approx(0.1, abs=0.003)
    assert found["figures"]["bleeding"] < 1e-3 and found["figures"]["background_mse"] < 1e-4
    inputs = {ref.role: ref.name for ref in work.get("report", "blue").manifest.inputs}
    assert inputs == {
        "scene": "wall", "field": "blue", "base_field": "wall", "frames": "blue-test", "unedited_frames": "wall-test",
        "region.left": "left",
    }  # fmt: skip


def test_a_recolored_palette_is_set_against_what_it_was_learned_of(work, edited, masks, renderer, capsys):
    palette = made.make_field(work, "palette", "decompose", {"field": work.get("field", "wall")})
    made.make_field(work, "red", "recolor", {"field": palette})
    for of, base in (("blue", "wall"), ("red", "wall")):
        found = result(capsys, work.root, "--of", of, "--region", "left", "--masks", masks)
        inputs = {ref.role: ref.name for ref in work.get("report", of).manifest.inputs}
        assert inputs["base_field"] == base
        for key in ("background_ratio", "change_inside", "change_lab", "bleeding"):
            assert f"field {base}" in found["protocols"][key], key
    assert renderer == [("red", "test")]


def test_words_tell_the_edit_beside_the_unedited_field(work, edited, masks, renderer, capsys):
    assert main(["eval", str(work.root), "--of", "blue", "--masks", str(masks), *FAST]) == 0
    words = capsys.readouterr().out
    assert "Background MSE" in words and "the unedited renders: 0.0000" in words and "Change in the region" in words


def test_training_views_are_measured_where_wanted(work, edited, masks, renderer, capsys):
    found = result(capsys, work.root, "--of", "blue", "--masks", masks, "--train-views")
    assert found["figures"]["train_change_inside"] == pytest.approx(0.1, abs=0.003)
    names = {ref.role: ref.name for ref in work.get("report", "blue").manifest.inputs}
    assert (names["train_frames"], names["unedited_train_frames"]) == ("blue-train", "wall-train")


def test_frames_of_the_unedited_field_are_rendered_where_they_are_missing(work, edited, masks, renderer, capsys):
    shutil.rmtree(work.get("frames", "wall-test").path)
    result(capsys, work.root, "--of", "blue", "--masks", masks)
    assert renderer == [("wall", "test")]


def test_another_base_may_be_named(work, edited, masks, renderer, capsys):
    made.make_field(work, "other", "nerf_fit", {"scene": work.get("scene", "wall")})
    result(capsys, work.root, "--of", "blue", "--masks", masks, "--base", "other")
    assert renderer == [("other", "test")]


@pytest.mark.parametrize(
    ("options", "code", "reported"),
    [
        (("--region", "left"), 2, "is not derived from another field"),
        (("--base", "blue"), 2, "--region"),
        (("--train-views",), 2, "--region"),
        (("--region", "right"), 2, "expected one region called 'right'"),
        (("--of", "blue", "--masks", "/nowhere"), 3, "--masks /nowhere"),
    ],
)
def test_what_makes_no_sense_is_one_line(work, edited, renderer, capsys, options, code, reported):
    of = () if "--of" in options else ("--of", "wall")
    assert main(["eval", str(work.root), *of, *options, *FAST]) == code
    err = capsys.readouterr().err
    assert reported in err and err.count("\n") == 1


def test_photos_of_an_edit_of_an_edit_are_those_of_the_original_scene(work, edited):
    second = made.commit(work, "scene", "red", "distill", {"scene": work.get("scene", "blue")}, blank)
    assert original_scene(second).name == "wall"
    assert original_scene(work.get("scene", "wall")).name == "wall"
