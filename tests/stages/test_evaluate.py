"""The evaluate stage end to end on a made-up scene whose answers are known."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from schemas.errors import UsageError
from schemas.images import write_png
from schemas.work_folder import WorkFolder
from stages import evaluate
from stages.configs.evaluate import EvaluateConfig
from stages.evaluate import pinned
from stages.evaluation.path_consistency import PathConsistency, pairs_of
from stages.evaluation.perceptual_metrics import PerceptualMetrics
from stages.evaluation.test_views import SceneViews
from stages.evaluation.view_metrics import measure_content
from stages.run.progress import Context
from stages.run.runner import execute, recipe_of
from stages.weights import resolve
from tests.stages import evaluation_fixture as made

POSITIONS = [-0.3, 0.0, 0.3]
QUIET = EvaluateConfig(perceptual="none", sheet=3)


def evaluated(work, inputs, config=QUIET, name="report"):
    report, _ = execute(evaluate.SPEC, evaluate.run, work, name, inputs, config, Context(), force=True)
    return report, json.loads(report.file("report.json").read_text())


def metric(report, key):
    return next(item for item in report["metrics"] if item["key"] == key)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A fit that is brighter than the photos by 0.1 and one tenth too deep."""
    work = WorkFolder(tmp_path_factory.mktemp("fitted"))
    scene = made.make_scene(work, POSITIONS)
    curve = [
        {"seconds": s, "step": s * 10, "parameters": 1e5 * s, "psnr": 10 + s, "held_out": s < 9} for s in (1, 3, 9)
    ]
    field = made.make_field(
        work, "wall", "fit", {"scene": scene}, seconds=65.0, peak_memory_mb=900,
        figures={"parameters": 1_200_000, "curve": curve},
    )  # fmt: skip
    cameras = [made.camera(x, f"test_{i}") for i, x in enumerate(POSITIONS)]
    seen = [made.look(view) for view in cameras]
    off = [replace(one, rgb=one.rgb + 0.1, z=one.z * 1.1) for one in seen]
    frames = made.make_frames(work, "wall-test", "test", cameras, off, field)
    path = [made.camera(-0.5 + 0.1 * k, f"path_{k:03d}") for k in range(10)]
    path_frames = made.make_frames(work, "wall-path", "slide", path, [made.look(v) for v in path], field, matched=False)
    inputs = {"scene": scene, "frames": frames, "path_frames": path_frames, "field": field}
    return work, inputs, *evaluated(work, inputs)


def test_a_known_error_gives_the_known_metrics(fitted):
    *_, report = fitted
    # 0.1 too bright in sRGB: -10 log10(0.01) = 20 dB, less what half precision and 8 bit photos take away.
    assert metric(report, "psnr")["mean"] == pytest.approx(20.0, abs=0.05)
    assert metric(report, "psnr")["count"] == 3 and metric(report, "psnr")["left_out"] == 0
    assert metric(report, "depth_abs_rel")["mean"] == pytest.approx(0.1, abs=1e-5)
    assert metric(report, "depth_delta")["mean"] == 1.0
    assert metric(report, "depth_share")["mean"] == 1.0
    assert 0.9 < metric(report, "ssim")["mean"] < 1.0
    assert metric(report, "short_rmse")["mean"] < 0.02 and metric(report, "long_rmse")["mean"] < 0.03
    assert metric(report, "short_share")["mean"] > metric(report, "long_share")["mean"] > 0.5
    assert all("composited" in item["protocol"] for item in report["metrics"] if item["key"] in ("psnr", "ssim"))
    assert not any("{" in item["protocol"] + item["label"] for item in report["metrics"])


def test_costs_are_those_of_the_manifests(fitted):
    *_, report = fitted
    stages = {(made_by["kind"], made_by["name"]): made_by for made_by in report["stages"]}
    assert [made_by["kind"] for made_by in report["stages"]][:2] == ["scene", "field"]  # sources first
    field = stages["field", "wall"]
    assert (field["seconds"], field["peak_memory_mb"]) == (65, 900)
    assert (field["parameters"], field["bytes"]) == (1_200_000, 4096)
    assert stages["frames", "wall-path"]["seconds"] == 3.0
    assert report["curve"]["of"] == "wall"
    assert [point["held_out"] for point in report["curve"]["points"]] == [True, True, False]


def test_csv_and_json_hold_the_same_values(fitted):
    _, _, artifact, report = fitted
    with open(artifact.file("views.csv"), newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["name"] for row in rows] == ["test_0", "test_1", "test_2"]
    for row, view in zip(rows, report["views"], strict=True):
        for key, value in view.items():
            assert row[key] == value if isinstance(value, str) else float(row[key]) == value, key
    with open(artifact.file("pairs.csv"), newline="") as stream:
        assert len(list(csv.DictReader(stream))) == 9 + 3


def test_all_files_stand_in_the_manifest(fitted):
    _, _, artifact, report = fitted
    artifact.verify()
    names = {record.path for record in artifact.manifest.files}
    charts = {f"charts/{name}.{end}" for name in ("psnr_views", "quality_seconds", "consistency_pairs")
              for end in ("svg", "png")}  # fmt: skip
    assert names == charts | {"report.json", "report.html", "views.csv", "pairs.csv"}
    assert artifact.manifest.figures["psnr"] == metric(report, "psnr")["mean"]
    assert artifact.file("charts/psnr_views.png").read_bytes().startswith(b"\x89PNG")


def test_what_was_not_measured_is_listed(fitted):
    work, inputs, _, report = fitted
    assert {"LPIPS and ST-LPIPS"} <= {note["what"] for note in report["not_measured"]}
    assert report["warnings"] == []
    _, bare = evaluated(work, {key: inputs[key] for key in ("scene", "frames")})
    reported = {note["what"] for note in bare["not_measured"]}
    assert {"Multi-view consistency", "Parameters of the field"} <= reported
    assert bare["pairs"] == [] and bare["curve"] is None


def test_the_same_evaluation_gives_the_same_bytes(fitted):
    work, inputs, artifact, _ = fitted
    again, _ = evaluated(work, inputs, name="again")
    assert [(r.path, r.sha256) for r in again.manifest.files] == [(r.path, r.sha256) for r in artifact.manifest.files]


def test_a_report_is_stale_after_a_network_is_installed(tmp_path, monkeypatch):
    here = {}

    def resolved(name=None):
        if (name or "vgg") not in here:
            raise UsageError("not here")
        return resolve.ResolvedExtractor(name or "vgg", here[name or "vgg"], tmp_path, "", {}, "")

    def recipe(field=None, **options):
        return recipe_of(evaluate.SPEC, {}, pinned(EvaluateConfig(**options), field), 0).digest

    monkeypatch.setattr(resolve, "available_metrics", lambda: [one for one in here if "lpips" in one])
    monkeypatch.setattr(resolve, "resolve_metric", resolved)
    monkeypatch.setattr(resolve, "resolve", resolved)
    without, silent = recipe(), recipe(perceptual="none")
    here["st-lpips-vgg"] = "1" * 64
    tolerant = recipe()
    here["lpips-alex"] = "2" * 64
    both = recipe()
    here["lpips-alex"] = "3" * 64
    assert len({without, tolerant, both, recipe()}) == 4 and recipe(perceptual="none") == silent
    write_png(tmp_path / "style.png", np.zeros((4, 4, 3), np.uint8))
    given = {"config": {"style": str(tmp_path / "style.png")}}
    field = made.make_field(WorkFolder(tmp_path / "work"), "red", "stylize", {}, **given)
    with pytest.raises(UsageError):
        recipe(field)
    here["vgg"] = "4" * 64
    first = recipe(field)
    here["vgg"] = "5" * 64
    assert recipe(field) != first and "vgg 5555" in pinned(EvaluateConfig(), field).networks


def test_nan_in_a_render_is_reported_and_left_out(fitted, tmp_path, monkeypatch):
    _, inputs, _, report = fitted
    real = evaluate.FrameViews.render

    def with_nan(self, index):
        found = real(self, index)
        if index != 1:
            return found
        image = found.image.copy()
        image[5, 7:10] = np.nan
        return replace(found, image=image, nonfinite=3)

    monkeypatch.setattr(evaluate.FrameViews, "render", with_nan)
    artifact, found = evaluated(WorkFolder(tmp_path), {key: inputs[key] for key in ("scene", "frames", "path_frames")})
    assert found["views"][1]["psnr"] is None and "3 of 6912 pixels" in found["views"][1]["remark"]
    psnr = metric(found, "psnr")
    assert (psnr["count"], psnr["left_out"]) == (2, 1)
    assert psnr["mean"] == pytest.approx((report["views"][0]["psnr"] + report["views"][2]["psnr"]) / 2)
    assert any("test_1" in text and "NaN or infinite" in text for text in found["warnings"])
    page = artifact.file("report.html").read_text()
    assert "NaN or infinite" in page and "1 left out" in page
    assert sum("path_001: 3 of 6912 pixels" in row["remark"] for row in found["pairs"]) == 3
    assert metric(found, "short_rmse")["left_out"] == 2


def test_a_frame_with_nan_in_its_file_is_counted_not_refused(fitted, tmp_path, monkeypatch):
    """Frames written by another tool may hold what our own writer refuses."""
    _, inputs, *_ = fitted
    views = evaluate.FrameViews(inputs["frames"], 0.0)
    channels = {name: np.ones((72, 96), np.float32) for name in "RGBAZ"}
    channels["G"][3, 4], channels["Z"][0, 0] = np.nan, np.inf
    monkeypatch.setattr("stages.evaluation.test_views.read_channels", lambda path, required: (channels, {}))
    render = views.render(0)
    assert render.nonfinite == 2
    assert np.isnan(render.image).all(axis=-1).sum() == 2


def test_alpha_scenes_are_composited_on_white_and_measured_on_the_object(tmp_path):
    work = WorkFolder(tmp_path)
    scene = made.make_scene(work, POSITIONS, background="alpha")
    field = made.make_field(work, "ball", "fit", {"scene": scene})
    cameras = [made.camera(x, f"test_{i}") for i, x in enumerate(POSITIONS)]
    seen = [made.look(view, wall=False) for view in cameras]
    off = [replace(one, rgb=np.clip(one.rgb, 0.1, 0.8) + 0.1) for one in seen]
    frames = made.make_frames(work, "ball-test", "test", cameras, off, field)
    _, report = evaluated(work, {"scene": scene, "frames": frames})
    photo, render = SceneViews(scene).photo(0, 96, 72), evaluate.FrameViews(frames, 1.0).render(0)
    assert (photo.image[0, 0] == 1).all() and (render.image[0, 0] == 1).all() and not photo.mask[0, 0]
    share = np.mean([one.alpha.mean() for one in seen])
    whole, on_object = metric(report, "psnr")["mean"], metric(report, "psnr_object")["mean"]
    # The background is equal in both, so that all of the error is on the object's share of the pixels.
    assert whole - on_object == pytest.approx(-10 * np.log10(share), abs=0.1)
    assert "white" in metric(report, "psnr")["protocol"]


def test_photos_of_another_size_are_resampled_with_a_warning(tmp_path):
    work = WorkFolder(tmp_path)
    scene = made.make_scene(work, POSITIONS, size=(192, 144))
    field = made.make_field(work, "wall", "fit", {"scene": scene})
    cameras = [made.camera(x, f"test_{i}", (192, 144)).scaled(0.5) for i, x in enumerate(POSITIONS)]
    frames = made.make_frames(work, "wall-test", "test", cameras, [made.look(v) for v in cameras], field)
    _, report = evaluated(work, {"scene": scene, "frames": frames})
    assert metric(report, "psnr")["mean"] > 30
    assert any("resampled" in text for text in report["warnings"])
    assert any("differ in size" in note["why"] for note in report["not_measured"])


WRONG = {"gap": 1, "pairs": -1, "perceptual_pairs": -1, "sheet": 0, "style_side": 8, "depth_tolerance": 0.0,
         "margin": -1, "ring": 0}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_options_out_of_range_are_refused(name):
    with pytest.raises(ValueError, match="--" + name.replace("_", "-")):
        replace(QUIET, **{name: WRONG[name]})


def test_a_rebuilt_or_missing_source_is_reported(fitted, tmp_path):
    work = WorkFolder(tmp_path)
    scene = made.make_scene(work, POSITIONS)
    field = made.make_field(work, "wall", "fit", {"scene": scene})
    cameras = [made.camera(x, f"test_{i}") for i, x in enumerate(POSITIONS)]
    frames = made.make_frames(work, "wall-test", "test", cameras, [made.look(v) for v in cameras], field)
    made.make_field(work, "wall", "fit", {"scene": scene}, config={"other": 1})
    _, report = evaluated(work, {"scene": scene, "frames": frames})
    assert any("rebuilt after" in text for text in report["warnings"])
    (field.path / "manifest.json").unlink()
    _, report = evaluated(work, {"scene": scene, "frames": frames})
    assert any("cannot be read" in text for text in report["warnings"])


def test_equal_images_are_a_hundred_decibels(tmp_path):
    work = WorkFolder(tmp_path)
    scene = made.make_scene(work, [0.0], depth=False)
    field = made.make_field(work, "wall", "fit", {"scene": scene})
    view = made.camera(0.0, "test_0")
    gray = replace(made.look(view), rgb=np.zeros((72, 96, 3), np.float32))
    frames = made.make_frames(work, "wall-test", "test", [view], [gray], field)
    black = evaluate.FrameViews(frames, 0.0).render(0)
    row = evaluate.ViewRow("black")
    evaluate.measure_fit(row, black, evaluate.Photo(np.zeros((72, 96, 3), np.float32), None, None, False, False), {})
    assert row.values["psnr"] == 100.0 and row.values["ssim"] == pytest.approx(1.0)


def test_exr_colors_come_back_as_they_were_composited():
    from stages.evaluation.test_views import composite

    random = np.random.default_rng(0)
    rgb, alpha = random.random((6, 7, 3)).astype(np.float32), random.random((6, 7)).astype(np.float32)
    seen = made.Seen(rgb, alpha, np.ones((6, 7)))
    view = made.exr_of(made.camera(0, "any", (7, 6)), seen)
    wanted = seen.rgb * seen.alpha[..., None] + (1 - seen.alpha[..., None]) * 1.0
    np.testing.assert_allclose(composite(view.rgb, view.alpha, 1.0), wanted, atol=1e-5)


def test_what_masks_hide_of_a_capture_is_not_measured(tmp_path):
    work = WorkFolder(tmp_path)
    scene = made.make_scene(work, [0.0], background="alpha", depth=False, layout="forward")
    field = made.make_field(work, "wall", "fit", {"scene": scene})
    view, ball = made.camera(0.0, "test_0"), made.look(made.camera(0.0, "test_0"), wall=False)
    noise = np.random.default_rng(0).random((72, 96, 3)).astype(np.float32)
    photo, values = SceneViews(scene).photo(0, 96, 72), []
    assert photo.mask is None and np.array_equal(photo.visible, ball.alpha > 0.5)
    for hidden in (noise, np.ones_like(noise), 1 - noise):
        rgb = np.where(ball.alpha[..., None] > 0.5, np.clip(ball.rgb + 0.05, 0, 1), hidden)
        frames = made.make_frames(
            work, "wall-test", "test", [view], [replace(ball, rgb=rgb, alpha=np.ones_like(ball.alpha))], field
        )
        row = evaluate.ViewRow("view")
        distance = {"lpips": lambda a, b: float(np.abs(a - b).sum())}
        evaluate.measure_fit(row, evaluate.FrameViews(frames, 1.0).render(0), photo, distance)
        measure_content(row, rgb, photo)
        values.append(row.values)
    assert 25 < values[0]["psnr"] < 28 and "psnr_object" not in values[0]
    for key, tolerance in (("psnr", 1e-6), ("lpips", 1e-3), ("ssim", 0.05), ("content_ssim", 0.05)):
        assert np.ptp([one[key] for one in values]) <= tolerance, key


def test_pairs_are_spread_and_few_have_perceptual_distances(fitted):
    _, inputs, *_ = fitted
    assert pairs_of(10, 7, 0) == [(0, 7), (1, 8), (2, 9)] and pairs_of(5, 7, 3) == []
    assert pairs_of(100, 1, 4) == [(0, 1), (33, 34), (65, 66), (98, 99)]
    path = evaluate.FrameViews(inputs["path_frames"], 0.0)
    ranges = {"short": pairs_of(10, 1, 0), "long": pairs_of(10, 7, 0)}
    config = replace(QUIET, perceptual_pairs=2)
    path_pairs = PathConsistency(path, config, PerceptualMetrics(None, None, None, ""), None)
    path_pairs._pixel_distance = lambda a, b: np.full(a.shape[:2], 0.25)
    rows = list(path_pairs.measure_ranges(ranges))
    assert [row["short_perceptual"] for row in rows if "short_perceptual" in row] == [0.25, 0.25]
    assert len(rows) == 12 and sum("long_perceptual" in row for row in rows) == 2
    assert [row["frame"] for row in rows if "short_perceptual" in row] == [1, 9]
