"""`stylerf blend` and `render --strength`: what they make, what they reuse, what they refuse."""

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest

from schemas.exr import read_exr
from schemas.frames import read_frames
from schemas.images import linear_from_srgb
from schemas.work_folder import WorkFolder
from stages.artifacts.field import load_field
from stages.configs.blend import BlendConfig
from stages.configs.render import RenderConfig
from stages.pipeline.pipeline import Pipeline
from stylerf_cli.main import main
from tests.stylerf_cli.conftest import STYLIZE


def said(capsys, *arguments: object) -> dict:
    """The --json object of one command that must succeed."""
    assert main([*map(str, arguments), "--json", "--quiet"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def refused(capsys, code: int, *arguments: object) -> str:
    capsys.readouterr()
    assert main([*map(str, arguments), "--quiet"]) == code
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "Traceback" not in line
    return line


def render(capsys, work: Path, of: str, *more: object) -> list:
    """The EXR views of a field's test path."""
    made = said(capsys, "render", work, "--of", of, "--path", "test", "--no-regions", *more)
    return [read_exr(path) for path in sorted((Path(made["frames"]) / "exr").glob("*.exr"))]


def srgb(views: list) -> np.ndarray:
    """[pixels, 3] premultiplied sRGB of linear views: what is mixed."""
    found = []
    for view in views:
        alpha = view.alpha[..., None]
        straight = view.rgb / np.maximum(alpha, 1e-6)
        low = straight <= 0.0031308
        encoded = np.where(low, 12.92 * straight, 1.055 * np.maximum(straight, 1e-9) ** (1 / 2.4) - 0.055)
        found.append((encoded * alpha).reshape(-1, 3))
    return np.concatenate(found)


@pytest.fixture(scope="module")
def styled(finished, photos, in_memory):
    """The finished work folder with a second stylization, `other`, and a region, `left`; nobody changes it."""
    work = shutil.copytree(finished, in_memory / "styled" / "work")
    photo = min((photos / "train").glob("*.png"))
    for arguments in (
        ("stylize", work, "--style", photo, *STYLIZE, "--of", "fit", "--name", "other"),
        ("select", work, "--of", "fit", "--box", "-9", "-9", "-9", "-0.25", "9", "9", "--name", "left"),
    ):
        assert main([*map(str, arguments), "--quiet"]) == 0
    yield work
    shutil.rmtree(work.parent)


@pytest.fixture
def styles(styled, in_memory):
    """A copy of it."""
    folder = Path(tempfile.mkdtemp(dir=in_memory))
    yield shutil.copytree(styled, folder / "work")
    shutil.rmtree(folder)


def test_encoding_of_this_test_is_the_inverse_of_linearizing():
    values = np.linspace(0, 1, 50, dtype=np.float32).reshape(1, -1, 1).repeat(3, 2)
    view = type("View", (), {"rgb": linear_from_srgb(values), "alpha": np.ones((1, 50), np.float32)})
    np.testing.assert_allclose(srgb([view]), values.reshape(-1, 3), atol=1e-5)


def test_strength_renders_between_the_fit_and_its_stylization(work, capsys):
    fit, styled = render(capsys, work, "fit"), render(capsys, work, "painting-arf")
    none = render(capsys, work, "painting-arf", "--strength", "0")
    half = said(capsys, "render", work, "--of", "painting-arf", "--path", "test", "--no-regions", "--strength", "0.5")
    whole = said(capsys, "render", work, "--of", "painting-arf", "--path", "test", "--no-regions", "--strength", "1")
    for found, expected in zip(none, fit, strict=True):
        np.testing.assert_array_equal(found.rgb, expected.rgb)
        np.testing.assert_array_equal(found.z, expected.z)
    views = [read_exr(path) for path in sorted((Path(half["frames"]) / "exr").glob("*.exr"))]
    np.testing.assert_allclose(srgb(views), 0.5 * (srgb(fit) + srgb(styled)), atol=4e-3)
    assert np.abs(srgb(fit) - srgb(styled)).max() > 0.05
    assert half["name"] == "painting-arf-test-strength-0.5" and whole["name"] == "painting-arf-test"
    assert views[0].attributes["strength"] == "0.5"
    inputs = {ref.role: ref.name for ref in WorkFolder(work).get("frames", half["name"]).manifest.inputs}
    assert inputs["source"] == "fit" and inputs["field"] == "painting-arf"


def test_weaker_frames_are_not_measured_as_the_field(work, capsys):
    shutil.rmtree(work / "frames")
    said(capsys, "render", work, "--of", "painting-arf", "--path", "test", "--no-regions", "--strength", "0.5")
    said(capsys, "eval", work, "--of", "painting-arf", "--perceptual", "none")
    report = next(one for one in WorkFolder(work).artifacts("report") if one.name == "painting-arf")
    measured = {ref.role: ref.name for ref in report.manifest.inputs}
    assert measured["frames"] == "painting-arf-test" and measured["base_frames"] == "fit-test"
    assert read_frames(work / "frames" / "painting-arf-test").field == "painting-arf"


def test_a_blend_is_a_field_like_any_other(styles, capsys):
    work = styles
    made = said(capsys, "blend", work, "--of", "painting-arf=0.4", "other")
    assert made["name"] == "painting-arf+other" and made["figures"]["source_weight"] == 0
    fields = [render(capsys, work, name) for name in ("painting-arf", "other", made["name"])]
    first, second, found = map(srgb, fields)
    np.testing.assert_allclose(found, 0.4 * first + 0.6 * second, atol=4e-3)
    for view, same in zip(fields[2], fields[0], strict=True):
        np.testing.assert_array_equal(view.alpha, same.alpha)
    said(capsys, "eval", work, "--of", made["name"], "--perceptual", "none")
    measured = {ref.role: ref.name for ref in WorkFolder(work).get("report", made["name"]).manifest.inputs}
    assert measured["frames"] == f"{made['name']}-test" and measured["base_frames"] == "fit-test"
    assert "style.0" in str(said(capsys, "show", work / "field" / made["name"])["inputs"])
    said(capsys, "verify", work / "field" / made["name"])
    again = said(capsys, "blend", work, "--of", f"{made['name']}=0.5", "--name", "half")
    assert again["figures"]["source_weight"] == 0.5 and again["figures"]["layers"] == 3
    fit = srgb(render(capsys, work, "fit"))
    np.testing.assert_allclose(srgb(render(capsys, work, "half")), 0.5 * (fit + found), atol=4e-3)
    weaker = srgb(render(capsys, work, made["name"], "--strength", "0.25"))
    np.testing.assert_allclose(weaker, 0.75 * fit + 0.25 * found, atol=4e-3)


def test_a_style_of_a_region_leaves_all_other_pixels(styles, capsys):
    made = said(capsys, "blend", styles, "--of", "painting-arf", "other:left")
    assert made["name"] == "painting-arf+other.left"
    frames = said(capsys, "render", styles, "--of", made["name"], "--path", "test")
    found = [read_exr(path) for path in sorted((Path(frames["frames"]) / "exr").glob("*.exr"))]
    changed = 0
    for view, before in zip(found, render(capsys, styles, "painting-arf"), strict=True):
        missed = view.masks["left"] == 0
        assert missed.sum() > 50
        np.testing.assert_array_equal(view.rgb[missed], before.rgb[missed])
        changed += int((np.abs(view.rgb - before.rgb).max(-1) > 0.01).sum())
    assert changed > 50


def test_same_blend_is_reused_and_python_makes_the_same(styles, capsys):
    made = said(capsys, "blend", styles, "--of", "painting-arf=0.25", "other:left=0.5", "--name", "mix")
    manifest = WorkFolder(styles).get("field", "mix").manifest
    again = said(capsys, "blend", styles, "--of", "painting=0.25", "oth:le=0.5", "--name", "mix")  # abbreviated
    assert again["seconds"] == made["seconds"]
    pipeline = Pipeline(styles, device="cpu", threads=2)
    field = pipeline.blend(BlendConfig(("painting-arf=0.25", "other:left=0.5")), name="mix")
    assert field.manifest.created == manifest.created
    frames = pipeline.render(RenderConfig(path="test", strength=0.5, regions=False), of=field)
    assert frames.name == "mix-test-strength-0.5"
    loaded, _ = load_field(field)
    layers = [(one.weight, one.within is None) for one in loaded.color.layers]
    assert layers == [(0.75, True), (0.25, True), (0.5, False)]


def test_blends_that_cannot_be_are_refused_in_a_line(styles, capsys):
    work = styles
    for code, expected, parts in (
        (2, "add up to 1.1", ("painting-arf=0.5", "other=0.6")),
        (2, "a number of 0 to 1", ("painting-arf=-0.5",)),
        (2, "a number of 0 to 1", ("painting-arf=nan",)),
        (2, "a number of 0 to 1", ("painting-arf=much",)),
        (2, "is not written FIELD", ("painting-arf:left:right",)),
        (2, "2 times", ("painting-arf", "painting-arf=0.5")),
        (2, "2 times", ("painting-arf=0.5", "painting=0.5")),
        (2, "the other weights add up to 1", ("painting-arf=1", "other")),
        (2, "alone is not a blend", ("painting-arf",)),
        (2, "found none", ("painting-arf=0.5", "missing")),
        (2, "found none", ("painting-arf", "other:missing")),
        (2, "is not derived from another field", ("fit=0.5",)),
    ):
        assert expected in refused(capsys, code, "blend", work, "--of", *parts)
    assert "--of is required" in refused(capsys, 2, "blend", work)
    assert not [one for one in (work / "field").iterdir() if "+" in one.name]


def test_strengths_that_cannot_be_are_refused_in_a_line(work, capsys):
    assert "is not derived from another field" in refused(capsys, 2, "render", work, "--of", "fit", "--strength", "0.5")
    assert "strength must be 0 to 1" in refused(capsys, 2, "render", work, "--strength", "1.5")
    assert "expected a number" in refused(capsys, 2, "render", work, "--strength", "nan")
    shutil.rmtree(work / "field" / "fit")
    assert "field fit" in refused(capsys, 4, "render", work, "--of", "painting-arf", "--strength", "0.5")


def test_fields_of_two_fits_are_refused(styles, capsys):
    fit = ("--budget", "3", "--no-buffers", "--capacity", "fixed:32x8x8", "--samples", "3000")
    said(capsys, "fit", styles, *fit, "--name", "second", "--seed", "1")
    line = refused(capsys, 2, "blend", styles, "--of", "painting-arf=0.5", "second=0.5")
    assert "not derived from the same field" in line and "painting-arf from fit" in line


def test_a_blend_is_not_trained_further(styles, capsys):
    said(capsys, "blend", styles, "--of", "painting-arf=0.5", "--name", "half")
    photo = styles / "field" / "painting-arf" / "style.png"
    assert "are not in the photos" in refused(capsys, 2, "stylize", styles, "--of", "half", "--style", photo)
    options = ("--of", "half", "--box", "-9", "-9", "-9", "-0.25", "9", "9", "--recolor", "--palette", "all=#00ff00")
    assert "is a blend, which cannot be trained" in refused(capsys, 2, "edit", styles, *options)


def test_a_deformed_stylization_is_rendered_half_as_bent(work, capsys):
    """The command accepts a field that was bent first: its source is the field before that."""
    style = work / "field" / "painting-arf" / "style.png"
    bent = ("--method", "desrf", "--of", "fit-deformed", "--name", "bent")
    said(capsys, "stylize", work, "--style", style, *STYLIZE, *bent)
    made = said(capsys, "blend", work, "--of", "bent=0.5", "painting-arf=0.25")
    assert made["figures"]["displaced"] and made["figures"]["source"] == "fit"
    grids = [load_field(WorkFolder(work).get("field", name))[0].displacement for name in ("bent", made["name"])]
    np.testing.assert_allclose(grids[1], 0.5 * grids[0], atol=1e-7)
    render(capsys, work, "bent", "--strength", "0.5")
    none, fit = render(capsys, work, "bent", "--strength", "0"), render(capsys, work, "fit")
    np.testing.assert_array_equal(none[0].rgb, fit[0].rgb)
