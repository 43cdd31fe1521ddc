"""Ref-LPIPS and Robustness on made-up renders, and the palette figures of an edit's report."""

import json
from dataclasses import replace

import numpy as np
import pytest

from schemas.errors import BadInput
from schemas.images import write_png
from schemas.work_folder import WorkFolder
from stages import evaluate
from stages.artifacts.provenance import edit_behind
from stages.configs.evaluate import EvaluateConfig
from stages.evaluate import pinned
from stages.evaluation import reference_metrics
from stages.evaluation.reference_metrics import References, measure_robustness
from stages.evaluation.test_views import FrameViews, SceneViews
from stages.evaluation.view_metrics import ViewRow
from stages.run.progress import Context
from stages.run.runner import execute
from tests.stages import evaluation_fixture as made

POSITIONS = [0.0, 0.1, 0.2, 0.3]


@pytest.fixture(scope="module")
def stylized(tmp_path_factory):
    """A field painted darker, and one made from its renders that is darker by another 0.1."""
    work = WorkFolder(tmp_path_factory.mktemp("references"))
    scene = made.make_scene(work, POSITIONS, depth=False)
    fit = made.make_field(work, "wall", "fit", {"scene": scene})
    cameras = [made.camera(x, f"test_{i}") for i, x in enumerate(POSITIONS)]
    frames = {}
    for name, shift in (("first", 0.1), ("second", 0.2)):
        field = made.make_field(work, name, "stylize", {"scene": scene, "field": fit}, config={"seed": shift})
        seen = [made.look(camera) for camera in cameras]
        darker = [replace(one, rgb=one.rgb * 0.5 + 0.3 - shift) for one in seen]
        frames[name] = made.make_frames(work, f"{name}-test", "test", cameras, darker, field)
    return work, scene, frames


def mean_difference(a, b):
    return float(np.abs(a - b).mean())


@pytest.mark.parametrize("view", ["photo_03", "#3"])
def test_a_reference_is_compared_with_the_views_nearest_to_its_camera(stylized, tmp_path, monkeypatch, view):
    _, scene, frames = stylized
    monkeypatch.setattr(reference_metrics, "NEAREST", 2)
    views = FrameViews(frames["first"], 0.0)
    picture = views.render(3).image + np.float32(0.2)
    write_png(tmp_path / "reference.png", np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8))
    found = References([f"{view}={tmp_path / 'reference.png'}"], SceneViews(scene), views)
    rows = [ViewRow(render.name) for render in views]
    for i, row in enumerate(rows):
        found.measure(row, i, views.render(i), mean_difference)
    assert [("ref_lpips" in row.values) for row in rows] == [False, False, True, True]
    assert rows[3].values["ref_lpips"] == pytest.approx(0.2, abs=3e-3)
    assert rows[2].values["ref_lpips"] == pytest.approx(mean_difference(views.render(2).image, picture), abs=3e-3)


def test_two_references_are_averaged_and_a_large_one_is_scaled(stylized, tmp_path):
    _, scene, frames = stylized
    views = FrameViews(frames["first"], 0.0)
    for name, gray, size in (("a", 100, (72, 96)), ("b", 200, (144, 192))):
        write_png(tmp_path / f"{name}.png", np.full((*size, 3), gray, np.uint8))
    requested = [f"photo_00={tmp_path / 'a.png'}", f"photo_03={tmp_path / 'b.png'}"]
    row, render = ViewRow("any"), views.render(1)
    References(requested, SceneViews(scene), views).measure(row, 1, render, mean_difference)
    wanted = np.mean([mean_difference(render.image, gray / 255) for gray in (100, 200)])
    assert row.values["ref_lpips"] == pytest.approx(wanted, rel=1e-4)


def test_unusable_references_are_refused(stylized, tmp_path):
    _, scene, frames = stylized
    views = FrameViews(frames["first"], 0.0)
    write_png(tmp_path / "square.png", np.zeros((64, 64, 3), np.uint8))
    with pytest.raises(ValueError, match="VIEW=FILE"):
        EvaluateConfig(reference=("photo_00",))
    with pytest.raises(BadInput, match="view 'nowhere' not found; the scene's 4 views are photo_00"):
        References([f"nowhere={tmp_path / 'square.png'}"], SceneViews(scene), views)
    with pytest.raises(BadInput, match=r"absent\.png not found"):
        References([f"photo_00={tmp_path / 'absent.png'}"], SceneViews(scene), views)
    found = References([f"photo_00={tmp_path / 'square.png'}"], SceneViews(scene), views)
    with pytest.raises(BadInput, match="64x64 but view test_0 is 96x72"):
        found.measure(ViewRow("any"), 0, views.render(0), mean_difference)


def test_robustness_is_the_psnr_between_the_two_fields(stylized):
    work, scene, frames = stylized
    row = ViewRow("any")
    measure_robustness(row, FrameViews(frames["second"], 0.0).render(0), FrameViews(frames["first"], 0.0))
    assert row.values["robustness"] == pytest.approx(20, abs=0.1)  # 0.1 apart everywhere
    inputs = {"scene": scene, "frames": frames["second"], "reference_frames": frames["first"]}
    inputs["field"] = work.get("field", "second")
    config = EvaluateConfig(perceptual="none", sheet=1)
    artifact, _ = execute(evaluate.SPEC, evaluate.run, work, "second", inputs, config, Context())
    report = json.loads(artifact.file("report.json").read_text())
    reported = next(item for item in report["metrics"] if item["key"] == "robustness")
    assert (
        reported["mean"] == pytest.approx(20, abs=0.1)
        and reported["count"] == 4
        and "field first" in reported["protocol"]
    )
    notes = {note["what"]: note["why"] for note in report["not_measured"]}
    assert "Robustness" not in notes and "Ref-LPIPS" in notes and "art_inception.pth" in notes["ArtFID"]


@pytest.mark.parametrize(("damaged", "remark"), [("second", "of the render"), ("first", "reference field:")])
def test_a_render_with_nan_is_left_out_and_counted(stylized, monkeypatch, tmp_path, damaged, remark):
    """A NaN pixel in view 1: Robustness and see-through leave the view out, with a remark."""
    work, scene, frames = stylized
    real = FrameViews.render

    def render(self, index):
        found = real(self, index)
        return replace(found, nonfinite=1) if index == 1 and self.frames.field == damaged else found

    monkeypatch.setattr(FrameViews, "render", render)
    inputs = {"scene": scene, "frames": frames["second"], "field": work.get("field", "second")}
    inputs |= dict.fromkeys(("reference_frames", "base_frames"), frames["first"])
    config = EvaluateConfig(perceptual="none", sheet=1)
    artifact, _ = execute(evaluate.SPEC, evaluate.run, WorkFolder(tmp_path), "second", inputs, config, Context())
    report = json.loads(artifact.file("report.json").read_text())
    counts = {item["key"]: (item["count"], item["left_out"]) for item in report["metrics"]}
    assert counts["robustness"] == counts["shape_change"] == (3, 1)
    assert counts["see_through"] == ((1, 2) if damaged == "second" else (3, 0))  # of the view and of the one after it
    assert remark in report["views"][1]["remark"]


def test_a_reference_is_not_compared_with_a_view_with_nan(stylized, tmp_path):
    _, scene, frames = stylized
    views, row = FrameViews(frames["first"], 0.0), ViewRow("any")
    write_png(tmp_path / "reference.png", np.zeros((72, 96, 3), np.uint8))
    found = References([f"photo_00={tmp_path / 'reference.png'}"], SceneViews(scene), views)
    found.measure(row, 1, replace(views.render(1), nonfinite=2), mean_difference)
    assert row.values == {"ref_lpips": None} and "2 of" in row.remarks[0]


def test_a_changed_reference_makes_the_report_stale(tmp_path):
    for name in ("r.png", "s.png"):
        write_png(tmp_path / name, np.zeros((4, 4, 3), np.uint8))
    config = EvaluateConfig(reference=(f"a={tmp_path / 'r.png'}", f"a={tmp_path / 's.png'}"))
    first = pinned(config).reference_digest
    write_png(tmp_path / "r.png", np.ones((4, 4, 3), np.uint8))
    assert first and pinned(config).reference_digest != first


def test_an_edit_is_found_through_the_scene_of_edited_images(tmp_path):
    work = WorkFolder(tmp_path / "work")
    photos = made.make_scene(work, [0.0], depth=False)
    fit = made.make_field(work, "wall", "fit", {"scene": photos})
    nothing = {"write": lambda folder: (folder / "a").write_text("a")}
    learned = made.commit(work, "edit", "blue", "edit_learn", {}, **nothing, figures={"sparsity": 0.5})
    painted = made.commit(work, "scene", "blue", "distill", {"scene": photos, "edit": learned}, **nothing)
    field = made.make_field(work, "blue", "finetune", {"scene": painted, "field": fit})
    assert edit_behind(field).name == "blue" and edit_behind(field).manifest.figures == {"sparsity": 0.5}
    assert edit_behind(fit) is None
