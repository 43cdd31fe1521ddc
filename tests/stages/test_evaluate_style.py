"""Evaluation of a stylized field: distances to the painting, structure kept, shape changed."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import BadInput, UsageError
from schemas.images import write_png
from schemas.work_folder import WorkFolder
from stages import evaluate
from stages.configs.evaluate import EvaluateConfig
from stages.configs.stylize import ArfConfig, DesrfConfig, SnerfConfig
from stages.evaluation.painted_views import options_of
from stages.evaluation.perceptual_metrics import StyleImage, perceptual_networks, style_file
from stages.run.progress import Context
from stages.run.runner import execute
from stages.weights import resolve
from stylerf.metrics.color_distribution import color_quantiles, distance_of_quantiles
from tests.stages import evaluation_fixture as made

POSITIONS = [-0.2, 0.2]
FEATURES = "st-vgg16"  # the feature network that every install has


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STYLERF_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.delenv("STYLERF_WEIGHTS", raising=False)
        if not any(row["name"] == FEATURES and row["found"] for row in resolve.describe()):
            pytest.skip(f"{FEATURES} is not installed")
        yield


@pytest.fixture(scope="module")
def painted():
    """Stripes of blue and yellow: [96, 128, 3]."""
    rows, columns = np.mgrid[:96, :128]
    stripe = (np.sin((rows + columns) / 3) > 0)[..., None]
    return np.where(stripe, [0.1, 0.2, 0.7], [0.9, 0.8, 0.2]).astype(np.float32)


def test_a_style_image_has_no_distance_to_itself(painted):
    painting = StyleImage(painted, FEATURES, 128, "cpu")
    ones = np.ones(painted.shape[:2], np.float32)
    nearest, gram, judge_gram, sifid = painting.distances(painted, ones)
    assert nearest == pytest.approx(0, abs=1e-4) and gram == pytest.approx(0, abs=1e-4)
    assert sifid == pytest.approx(0, abs=1e-4) and judge_gram == pytest.approx(0, abs=1e-4)
    other = made.look(made.camera(0, "any", (128, 96))).rgb
    far_nearest, far_gram, far_judge_gram, far_sifid = painting.distances(other, ones)
    assert far_nearest > 0.02 and far_gram > 0.1 and far_judge_gram > 0.1
    shifted = painting.distances(np.roll(painted, 8, axis=1), ones)
    assert shifted[0] < far_nearest / 3  # the same strokes elsewhere
    assert shifted[2] < far_judge_gram / 3 and shifted[3] < far_sifid / 10


def test_transparent_pixels_take_no_part(painted):
    painting = StyleImage(painted, FEATURES, 128, "cpu")
    other = made.look(made.camera(0, "any", (128, 96))).rgb
    half = painted.copy()
    half[:, 64:] = other[:, 64:]
    left = np.zeros((96, 128), np.float32)
    left[:, :48] = 1  # away from the seam, beyond which features see both
    assert painting.distances(half, left)[0] < 0.2 * painting.distances(half, 1 - left)[0]
    assert np.isnan(painting.distances(half, left * 0)).all()


def test_perceptual_map_agrees_with_its_network_and_grows_with_error(painted):
    tolerant, _ = perceptual_networks("cpu")
    assert tolerant is not None and tolerant.distance(painted, painted) == pytest.approx(0, abs=1e-6)
    noise = np.random.default_rng(0).standard_normal(painted.shape).astype(np.float32)
    slight, strong = (np.clip(painted + amount * noise, 0, 1) for amount in (0.05, 0.3))
    assert tolerant.distance(painted, strong) > tolerant.distance(painted, slight) > 0
    there = painted.copy()
    there[60:80, 90:110] = strong[60:80, 90:110]
    found = tolerant.pixels(painted, there)
    assert found.shape == (96, 128) and found[55:85, 85:115].mean() > 5 * found[:40, :60].mean()


@pytest.fixture(scope="module")
def stylized(tmp_path_factory, painted):
    """A "stylized" field whose renders are the fit's in the painting's mean color, a fifth nearer."""
    folder = tmp_path_factory.mktemp("stylized")
    work = WorkFolder(folder / "work")
    scene = made.make_scene(work, POSITIONS)
    field = made.make_field(work, "wall", "fit", {"scene": scene}, seconds=10)
    write_png(folder / "stripes.png", np.round(painted * 255).astype(np.uint8))
    painted_field = made.make_field(
        work, "stripes", "stylize", {"scene": scene, "field": field}, seconds=20,
        config={"style": str(folder / "stripes.png")},
    )  # fmt: skip
    cameras = [made.camera(x, f"test_{i}") for i, x in enumerate(POSITIONS)]
    seen = [made.look(view) for view in cameras]
    base = made.make_frames(work, "wall-test", "test", cameras, seen, field)
    target = painted.reshape(-1, 3).mean(axis=0)
    new = [replace(one, rgb=one.rgb - one.rgb.mean((0, 1)) + target, z=one.z * 0.8) for one in seen]
    frames = made.make_frames(work, "stripes-test", "test", cameras, new, painted_field)
    inputs = {"scene": scene, "frames": frames, "base_frames": base, "field": painted_field}
    config = EvaluateConfig(features=FEATURES, sheet=2)
    artifact, _ = execute(evaluate.SPEC, evaluate.run, work, "stripes", inputs, config, Context())
    return inputs, artifact, json.loads(artifact.file("report.json").read_text())


def metric(report, key):
    return next(item for item in report["metrics"] if item["key"] == key)


def test_metrics_of_a_stylized_field(stylized, painted):
    _, artifact, report = stylized
    assert report["stylized"] and report["style_image"] == "style.png"
    mean = metric(report, "palette_mean")
    assert mean["mean"] < 0.03 < mean["reference"]["the unstylized renders"]  # clipping moves it a little
    assert metric(report, "shape_change")["mean"] == pytest.approx(0.2, abs=1e-4)
    kept = metric(report, "content_ssim")
    assert 0.7 < kept["mean"] < kept["reference"]["the unstylized renders"] <= 1
    edges = metric(report, "edges_kept")
    assert edges["mean"] == pytest.approx(1, abs=0.02) and edges["count"] == 2  # other colors, the same edges
    colors = metric(report, "color_distribution")
    shown = [made.look(made.camera(x, "any")).rgb.reshape(-1, 3) for x in POSITIONS]
    wanted = color_quantiles(painted.reshape(-1, 3))
    own = np.mean([distance_of_quantiles(color_quantiles(one.clip(0, 1)), wanted) for one in shown])
    assert colors["reference"]["the unstylized renders"] == pytest.approx(own, abs=0.1)
    assert metric(report, "speckle")["mean"] < 0.002
    assert FEATURES in metric(report, "nnfm")["protocol"] and metric(report, "nnfm")["count"] == 2
    assert not {"psnr", "ssim", "lpips"} & {item["key"] for item in report["metrics"]}
    assert any("PSNR" in note["what"] for note in report["not_measured"])
    assert {made_by["stage"] for made_by in report["stages"]} == {"import", "fit", "stylize", "render"}
    page = artifact.file("report.html").read_text()
    assert "the style image" in page and page.count("<img") == 2 * 4 + 1
    assert {record.path for record in artifact.manifest.files} >= {"charts/sifid_views.svg"}


def test_without_a_style_image_the_first_reference_is_compared(stylized, tmp_path, painted):
    """Ref-NPR without --style: what stands in its folder as style.png is the reference picture, no painting."""
    inputs, *_ = stylized
    write_png(tmp_path / "stripes.png", np.round(painted * 255).astype(np.uint8))

    def write(folder):
        write_png(folder / "style.png", np.round(painted * 255).astype(np.uint8))

    work, given = WorkFolder(tmp_path / "work"), {key: inputs[key] for key in ("scene", "frames")}
    made_with = {"style": "", "reference": ["0=stripes.png"]}
    field = made.commit(work, "field", "referenced", "stylize", {"scene": inputs["scene"]}, write, config=made_with)
    reported = {}
    for words, style in (("the reference", ""), ("the style image", str(tmp_path / "stripes.png"))):
        config = EvaluateConfig(features=FEATURES, sheet=1, perceptual="none", style=style)
        report, _ = execute(evaluate.SPEC, evaluate.run, work, "r", given | {"field": field}, config, Context())
        reported[words] = json.loads(report.file("report.json").read_text())
        for key in ("nnfm", "gram", "palette", "color_distribution"):
            assert metric(reported[words], key)["label"].endswith(f"distance to {words}")
            assert words in metric(reported[words], key)["protocol"]
        page = report.file("report.html").read_text()
        assert f"NNFM distance to {words}" in page and f"<figcaption>{words}</figcaption>" in page
    assert "painting" not in json.dumps(reported["the reference"]["metrics"])


def test_a_missing_style_image_is_bad_input(stylized):
    inputs, *_ = stylized
    with pytest.raises(BadInput, match="no such file"):
        style_file(EvaluateConfig(style="nowhere.png"), inputs["field"])


def test_the_style_image_is_the_one_kept_with_the_field(tmp_path):

    def write(folder):
        write_png(folder / "style.png", np.zeros((4, 4, 3), np.uint8))

    field = made.commit(WorkFolder(tmp_path), "field", "kept", "stylize", {}, write, config={"style": "elsewhere.png"})
    assert style_file(EvaluateConfig(), field) == field.file("style.png")
    field = made.commit(WorkFolder(tmp_path), "field", "bare", "stylize", {}, lambda folder: None,
                        config={"style": str(tmp_path / "private.png")})  # fmt: skip
    (tmp_path / "private.png").write_bytes(b"")
    assert style_file(EvaluateConfig(), field) is None  # a stranger's manifest may name any file
    assert style_file(EvaluateConfig(), None) is None


def test_views_painted_in_2d_stand_beside_the_renders(stylized, tmp_path):
    """Photo, style image, the photo stylized in 2D and the render; the painted ones are measured too."""
    inputs, *_ = stylized
    config = EvaluateConfig(features=FEATURES, sheet=1, perceptual="none", ceiling=4)
    work = WorkFolder(tmp_path / "work")
    artifact, _ = execute(evaluate.SPEC, evaluate.run, work, "r", inputs, config, Context())
    report = json.loads(artifact.file("report.json").read_text())
    painted = metric(report, "color_distribution")["reference"]
    assert painted["1 view painted in 2D"] < 0.9 * painted["the unstylized renders"]
    assert 0 < metric(report, "edges_kept")["reference"]["1 view painted in 2D"] <= 1
    page = artifact.file("report.html").read_text()
    captions = re.findall(r"<figcaption>([^<]*)</figcaption></figure>", page[page.index('class="sheet"') :])[:4]
    assert captions[:3] == ["photo", "the style image", "painted in 2D"] and captions[3].startswith("stylized")


def test_a_ceiling_needs_a_style_image(stylized):
    inputs, *_ = stylized
    with pytest.raises(UsageError, match="--ceiling needs a style image; give one with --style"):
        evaluate.pinned(EvaluateConfig(ceiling=5, perceptual="none"), inputs["base_frames"])
    with pytest.raises(ValueError, match="--ceiling -1: expected at least 0"):
        EvaluateConfig(ceiling=-1)


def test_what_paints_is_what_stylized(tmp_path):
    """The options of the field that concern images are those of its views in 2D."""
    made_with = {"method": "desrf", "style_scale": 2.5, "match_by": "nearest", "budget": "30s", "unheard_of": 1}
    field = made.make_field(WorkFolder(tmp_path), "bent", "stylize", {}, config=made_with)
    found = options_of(field, Path("other.png"))
    assert (found.style, found.style_scale, found.match_by) == ("other.png", 2.5, "nearest")
    assert options_of(None, Path("other.png")).style_scale == type(found).style_scale
    assert type(found) is DesrfConfig  # with the defaults that this method has for weights


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"method": "snerf", "image_by": "features", "budget": "3", "keep_frame": True}, SnerfConfig),
        ({"method": "refnpr", "reference_by": "adain"}, ArfConfig),
        ({"method": ["arf"]}, ArfConfig),
    ],
)
def test_views_are_painted_with_the_methods_own_defaults(tmp_path, options, kind):
    found = options_of(made.make_field(WorkFolder(tmp_path), "a", "stylize", {}, config=options), Path("other.png"))
    assert type(found) is kind and found.budget == kind.budget
    for name in ("image_by", "keep_frame"):
        assert getattr(found, name, None) == options.get(name, getattr(kind, name, None))
