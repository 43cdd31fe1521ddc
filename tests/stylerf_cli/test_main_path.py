"""The main path on a tiny still life, through the command's front door, against its known geometry."""

import json
import shutil
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas.errors import UsageError
from schemas.images import read_image, write_png
from schemas.work_folder import WorkFolder
from stages.pipeline.demo import refuse_others
from stages.pipeline.demo_scene import PAINTING
from stages.stylization import view_sizes
from stylerf.procedural.still_life import StillLife
from stylerf_cli.main import main

DEMO = ["--size", "48", "--train-views", "16", "--test-views", "2", "--fit-budget", "250", "--style-budget", "6",
        "--frames", "4"]  # fmt: skip


def said(capsys, *arguments: str) -> dict:
    """The --json object of one command that must succeed."""
    assert main([*arguments, "--json", "--quiet"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def demo(tmp_path_factory) -> Path:
    """A finished tiny demo."""
    work = tmp_path_factory.mktemp("demo") / "work"
    assert main(["demo", str(work), "--quiet", *DEMO]) == 0
    return work


def test_demo_leaves_what_it_promises_and_a_field_that_has_learned(demo, capsys):
    result = said(capsys, "demo", str(demo), *DEMO)
    for what in ("sheet", "report", "video"):
        assert Path(result[what]).stat().st_size > 1000
    # An empty field renders white: what that scores is the bar that a fit of 250 steps must clear by far.
    photos = [read_image(p).pixels for p in sorted((demo / "photos" / "test").glob("*.png"))]
    over_white = [p[..., :3] * p[..., 3:] + 1 - p[..., 3:] for p in photos]
    white = -10 * np.log10(np.mean([np.mean((1 - p) ** 2) for p in over_white]))
    assert result["psnr"] > white + 6


def test_a_demo_replaces_neither_scenes_nor_photos_of_others(posed, tmp_path, capsys):
    work = tmp_path / "work"
    said(capsys, "import", str(posed), str(work))
    before = WorkFolder(work).get("scene", "main").digest
    assert main(["demo", str(work), "--quiet", *DEMO]) == 2
    assert "scene/main was not created by the demo" in capsys.readouterr().err
    assert WorkFolder(work).get("scene", "main").digest == before and not (work / "photos").exists()
    (tmp_path / "new" / "photos").mkdir(parents=True)
    (tmp_path / "new" / "photos" / "mine.jpg").write_bytes(b"mine")
    assert main(["demo", str(tmp_path / "new"), "--quiet", *DEMO]) == 2
    assert "photos was not created by the demo" in capsys.readouterr().err


def test_a_demo_knows_its_own_even_where_it_was_moved(photos, tmp_path, capsys):
    work = tmp_path / "work"
    shutil.copytree(photos, work / "photos")
    said(capsys, "import", str(work / "photos"), str(work))
    refuse_others(WorkFolder(work), work / "photos")
    moved = work.rename(tmp_path / "moved")
    refuse_others(WorkFolder(moved), moved / "photos")
    shutil.rmtree(moved / "photos")
    with pytest.raises(UsageError, match="not created by the demo"):
        refuse_others(WorkFolder(moved), moved / "photos")


def test_all_stages_of_a_demo_are_its_own(demo, capsys, monkeypatch, tmp_path):
    """What makes them is replaced: --force reaches every one, --only forbids none, names are their own."""
    requested = []

    def execute(spec, run, work, name, inputs, config, context, force=False, protect=False):
        requested.append((spec.verb, force))
        return work.get(spec.writes, name), True

    monkeypatch.setattr("stages.pipeline.stage_runner.execute", execute)
    said(capsys, "demo", str(demo), *DEMO, "--force")
    assert {verb for verb, _ in requested} == {"import", "fit", "deform", "stylize", "render", "eval"}
    assert all(force for _, force in requested)
    assert main(["demo", str(tmp_path / "new"), "--name", "mine", "--quiet"]) == 2
    assert "names its own artifacts" in capsys.readouterr().err and not (tmp_path / "new").exists()


def test_everything_made_verifies_and_a_flipped_byte_is_found(demo, capsys, tmp_path):
    assert main(["verify", str(demo), "--quiet"]) == 0
    victim = next((demo / "field" / "fit").glob("*.safetensors"))
    data = bytearray(victim.read_bytes())
    data[len(data) // 2] ^= 1
    whole = victim.read_bytes()
    victim.write_bytes(bytes(data))
    try:
        assert main(["verify", str(demo), "--quiet"]) == 4
        assert victim.name in capsys.readouterr().err
    finally:
        victim.write_bytes(whole)


def test_written_depth_unprojects_onto_the_still_life(demo):
    frames = demo / "frames" / "fit-test" / "exr"
    life, errors = StillLife(0), []
    for path in sorted(frames.glob("*.exr")):
        picture = oiio.ImageInput.open(str(path))
        spec = picture.spec()
        pixels = dict(zip(spec.channelnames, np.moveaxis(picture.read_image(oiio.FLOAT), -1, 0)))
        to_camera = np.array(spec.getattribute("worldToCamera")).reshape(4, 4)  # row vectors: p_camera = p_world @ M
        fx = next(v for k, v in demo_intrinsics(demo) if k == path.stem)
        height, width = pixels["Z"].shape
        rows, columns = np.nonzero(pixels["A"] > 0.95)
        z = pixels["Z"][rows, columns]
        # The EXR camera has y up.
        local = np.stack([(columns + 0.5 - width / 2) / fx * z, -(rows + 0.5 - height / 2) / fx * z, z, 1 + 0 * z], -1)
        world = (local @ np.linalg.inv(to_camera))[:, :3]
        errors.append(np.abs(life.distance(world)))
        picture.close()
    # 48 pixels see a 2.5 unit wide scene: a pixel is 0.05 units, and the fit has had 250 steps.
    assert np.median(np.concatenate(errors)) < 0.05


def demo_intrinsics(demo: Path):
    scene = json.loads((demo / "scene" / "main" / "scene.json").read_text())
    return [(Path(view["name"]).name, view["fx"]) for view in scene["views"]]


def test_stylized_colors_are_nearer_to_the_painting(demo):
    painting = read_image(demo / "photos" / "painting.png").pixels[..., :3].reshape(-1, 3).mean(0)

    def mean_of(name: str) -> np.ndarray:
        views = [read_image(p).pixels for p in sorted((demo / "frames" / name / "png").glob("*.png"))]
        lit = np.concatenate([v[..., :3][(v[..., :3] < 0.98).any(-1)] for v in views])
        return lit.mean(0)

    before = np.linalg.norm(mean_of("fit-test") - painting)
    after = np.linalg.norm(mean_of("painting-desrf-test") - painting)
    assert after < 0.5 * before


def test_frames_of_a_demo_are_those_that_render_makes(demo, capsys):
    before = (demo / "frames" / "fit-test" / "manifest.json").read_bytes()
    said(capsys, "render", str(demo), "--of", "fit", "--path", "test")
    assert (demo / "frames" / "fit-test" / "manifest.json").read_bytes() == before


def test_shards_of_a_path_are_the_bytes_of_the_whole(demo, capsys):
    common = ("render", str(demo), "--of", "fit", "--path", "orbit", "--count", "4", "--scale", "0.5")
    said(capsys, *common, "--name", "whole")
    said(capsys, *common, "--frames", "2-3", "--name", "shard")
    for kind in ("png", "exr"):
        for frame in ("0002", "0003"):
            whole, shard = (demo / "frames" / n / kind / f"{frame}.{kind}" for n in ("whole", "shard"))
            assert whole.read_bytes() == shard.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (("stylize", "--style", "missing.jpg"), 3, "image not found"),
        (("stylize", "--style", "tiny.png"), 3, "16 pixels"),
        (("fit", "--budget", "soon"), 2, "soon"),
        (("fit", "--capacity", "fixed:9x3"), 2, "fixed:9x3"),
        (("render", "--path", "nowhere.json"), 3, "nowhere.json"),
        (("render", "--path", "test", "--frames", "90-99"), 3, "90-99"),
        (("render", "--of", "nothing"), 2, "nothing"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_its_exit_code(demo, capsys, arguments, code, word, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    write_png(tmp_path / "tiny.png", np.zeros((8, 8, 3), np.uint8))
    verb, *rest = arguments
    assert main([verb, str(demo), *rest, "--quiet"]) == code
    error = capsys.readouterr().err
    assert word in error and error.count("\n") == 1


@pytest.mark.parametrize("flags", [(), ("--max-side", "0")])
def test_a_short_time_takes_smaller_views_and_says_so(work, photos, capsys, monkeypatch, flags):
    monkeypatch.setattr(view_sizes, "MIN_PIXELS", 24 * 24)
    monkeypatch.setattr(view_sizes, "PIXELS_PER_SECOND", 1)
    style = ("--style", str(photos / PAINTING), "--refit-steps", "5", "--coarse", "0")
    small = ("--budget", "2s", "--levels", "4", "--finest", "64", "--table-bits", "12", *flags)
    assert main(["stylize", str(work), "--of", "fit", "--name", "short", *style, *small]) == 0
    said = capsys.readouterr().err
    assert ("learning from views of up to 24 pixels a side; --max-side sets" in said) == ("pixels a side" in said)
    assert ("pixels a side" in said) == (not flags)
    assert json.loads((work / "field/short/manifest.json").read_text())["figures"]["steps"] >= 1
