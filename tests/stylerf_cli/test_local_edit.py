"""A local edit of a tiny still life, command by command: select, extract, recolor, distill, finetune; and undone."""

import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, binary_erosion

from schemas.exr import read_exr
from schemas.images import read_image, write_png
from schemas.tensors import load_tensors
from schemas.work_folder import Recipe, WorkFolder
from stages import edit_learn
from stages.artifacts.field import load_field
from stages.artifacts.region import load_region, save_region
from stages.artifacts.scene import EDIT_TARGETS, load_scene
from stages.pipeline.demo_scene import PAINTING, write_demo
from stages.run.progress import Silent
from stylerf.fields.radiance_field import layers_of
from stylerf.rendering.view import render_view
from stylerf_cli.main import main
from tests.stylerf_cli.conftest import STYLIZE

QUICK = ["--palette-steps", "60", "--pruned-steps", "20", "--colors", "4", "--max-colors", "3"]


def said(capsys, *arguments: object) -> dict:
    """The --json object of one command that must succeed."""
    assert main([*map(str, arguments), "--json", "--quiet"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def refused(capsys, *arguments: object) -> str:
    """The one line of a command that must fail by its user's fault."""
    assert main([*map(str, arguments), "--quiet"]) in (2, 3, 4)
    text = capsys.readouterr().err.strip()
    assert text.startswith("stylerf: error: ") and "\n" not in text
    return text


@pytest.fixture(scope="module")
def still_life(tmp_path_factory) -> Path:
    """A fitted tiny still life and a stylization of it."""
    work = tmp_path_factory.mktemp("edit") / "work"
    write_demo(work / "photos", 48, 16, 2, 0, 1, Silent())
    for command in (
        ("import", work / "photos", work),
        ("fit", work, "--budget", "250", "--no-buffers"),
        ("stylize", work, "--of", "fit", "--style", work / "photos" / PAINTING, *STYLIZE),
    ):
        assert main([*map(str, command), "--quiet"]) == 0
    return work


@pytest.fixture(scope="module")
def middle(still_life) -> str:
    """VIEW:X,Y of the most saturated pixel in the middle of the first training view: one of the objects."""
    scene = load_scene(WorkFolder(still_life).artifacts("scene")[0])
    view = scene.splits["train"][0]
    rgb = scene.images(view)[..., :3]
    saturation = (rgb.max(2) - rgb.min(2))[14:34, 14:34]
    row, column = np.unravel_index(saturation.argmax(), saturation.shape)
    return f"{scene.views[view].name}:{column + 14},{row + 14}"


@pytest.fixture(scope="module")
def edited(still_life, middle) -> Path:
    """The whole chain in one command."""
    assert main(["edit", str(still_life), "--at", middle, "--recolor", "--palette", "0=#10e020", "--name", "ball",
                 "--config", str(_finetune(still_life)), "--quiet", *QUICK]) == 0  # fmt: skip
    return still_life


def photos_of(work: WorkFolder):
    """The scene of photos."""
    return next(one for one in work.artifacts("scene") if one.manifest.stage == "pose_import")


def photographed(work: WorkFolder):
    """The camera of the first training view."""
    scene = load_scene(photos_of(work))
    return scene.cameras[scene.splits["train"][0]]


def fitted(work: Path) -> str:
    """Name of the field that was fitted to the photos."""
    return next(one.name for one in WorkFolder(work).artifacts("field") if one.manifest.stage == "nerf_fit")


def _finetune(work: Path) -> Path:
    path = work.parent / "options.toml"
    path.write_text('[finetune]\nbudget = "60"\nrays = 1024\n')
    return path


def test_one_command_leaves_every_artifact_and_each_verifies(edited, capsys):
    for kind, name in (
        ("region", "ball"),
        ("edit-dataset", "ball"),
        ("edit", "ball"),
        ("edit", "ball-learned"),
        ("scene", "ball"),
        ("field", "ball"),
    ):
        assert (edited / kind / name / "manifest.json").is_file(), f"{kind} {name}"
    assert main(["verify", str(edited), "--quiet"]) == 0


def test_commands_one_by_one_reuse_what_the_one_command_made(edited, middle, capsys):
    made = {kind: edited / kind / "ball" / "manifest.json" for kind in ("region", "edit-dataset", "edit", "field")}
    before = {kind: path.stat().st_mtime_ns for kind, path in made.items()}
    said(capsys, "select", edited, "--at", middle, "--name", "ball")
    said(capsys, "extract", edited, "--region", "ball")
    said(capsys, "stylize", edited, "--region", "ball", "--recolor", "--palette", "0=#10e020", "--name", "ball", *QUICK)
    said(capsys, "distill", edited, "--edit", "ball")
    said(capsys, "finetune", edited, "--edit", "ball", "--budget", "60", "--rays", "1024")
    for kind, moment in before.items():
        assert (edited / kind / "ball" / "manifest.json").stat().st_mtime_ns == moment, kind


def test_only_pixels_of_the_region_change_and_they_turn_green(edited):
    work = WorkFolder(edited)
    plain = load_scene(next(s for s in work.artifacts("scene") if s.manifest.stage == "pose_import"))
    green = load_scene(work.get("scene", "ball"))
    changed, towards = 0, []
    for view in plain.splits["train"]:
        before, after = plain.images(view), green.images(view)
        seen = edited / "edit-dataset" / "ball" / "exr" / f"{plain.views[view].name}.exr"
        if not seen.is_file():
            np.testing.assert_array_equal(before, after)
            continue
        region = read_exr(seen).alpha > 0.01
        np.testing.assert_array_equal(before[~region], after[~region])
        moved = np.abs(after - before)[..., :3].max(2) > 0.1
        changed += int(moved.sum())
        towards.append((after - before)[moved])
    assert changed > 50
    shift = np.concatenate(towards).mean(0)
    assert shift[1] - shift[0] > 0.1  # less red, more green
    for view in plain.splits["test"]:
        np.testing.assert_array_equal(plain.images(view), green.images(view))


def test_other_palette_changes_need_no_training(edited, capsys):
    learned = (edited / "edit" / "ball-learned" / "manifest.json").stat().st_mtime_ns
    made = said(
        capsys, "stylize", edited, "--region", "ball", "--recolor", "--palette", "0=#2030f0", "--name", "ball", *QUICK
    )
    assert (edited / "edit" / "ball-learned" / "manifest.json").stat().st_mtime_ns == learned
    colors = json.loads((Path(made["edit"]) / "palette.json").read_text())["colors"]
    assert colors[0]["now"] == "#2030f0" != colors[0]["learned"]
    assert abs(sum(one["share"] for one in colors) - 1) < 0.01
    assert read_image(Path(made["edit"]) / "palette.png").pixels.shape[2] == 3


def test_a_tint_changes_every_palette_color_but_those_that_are_named(edited, capsys):
    requested = ("--palette", "all=#2030f0", "--palette", "1=#ffffff", "--name", "tint")
    made = said(capsys, "stylize", edited, "--region", "ball", "--recolor", *requested, *QUICK)
    assert made["figures"]["learned"] == "ball-learned" and not (edited / "edit" / "tint-learned").exists()
    colors = json.loads((Path(made["edit"]) / "palette.json").read_text())["colors"]
    rgb = [[int(one["now"][i : i + 2], 16) for i in (1, 3, 5)] for one in colors]
    assert rgb[1] == [255, 255, 255]
    blues = [one for place, one in enumerate(rgb) if place != 1 and max(one) > 8]
    assert blues and all(one[2] > one[1] > one[0] for one in blues)
    said(capsys, "stylize", edited, "--region", "ball", "--recolor", "--palette", "0=#10e020", "--name", "ball", *QUICK)


@pytest.mark.slow
def test_what_stands_under_the_ordinary_name_needs_no_training_either(edited, capsys, tmp_path):
    work, requested = tmp_path / "work", ("--region", "ball", "--recolor", *QUICK)
    shutil.copytree(edited, work)
    shutil.rmtree(work / "edit")
    learned = said(capsys, "stylize", work, *requested)
    changed = said(capsys, "stylize", work, *requested, "--palette", "0=#2030f0")
    assert (learned["name"], changed["name"]) == ("ball-recolor", "ball-recolor-changed")
    assert changed["figures"]["learned"] == "ball-recolor"
    edits = [one.name for one in WorkFolder(work).artifacts("edit")]
    assert sorted(edits) == ["ball-recolor", "ball-recolor-changed"]


def test_a_change_under_the_name_of_the_learned_edit_needs_no_training(edited, capsys, tmp_path, monkeypatch):
    work, requested = tmp_path / "work", ("--region", "ball", "--recolor", "--palette-steps", "30", *QUICK[2:])
    shutil.copytree(edited, work)
    said(capsys, "stylize", work, *requested, "--name", "vase")
    looked_at = WorkFolder(work).get("edit", "vase")
    before, files = looked_at.manifest, {one.path: one.sha256 for one in looked_at.manifest.files}

    def never(*_):
        raise AssertionError("learned again")

    with monkeypatch.context() as patch:
        patch.setattr(edit_learn, "run", never)
        refused(capsys, "stylize", work, *requested, "--palette", "9=#000000", "--name", "vase")
        assert WorkFolder(work).get("edit", "vase").digest == looked_at.digest  # a slip loses nothing
        named = said(capsys, "stylize", work, *requested, "--palette", "0=#2030f0", "--name", "vase")
        stages = [WorkFolder(work).get("edit", "vase").manifest.stage]
        back = said(capsys, "stylize", work, *requested, "--name", "vase")
    again = WorkFolder(work).get("edit", "vase")
    again.verify()
    assert back["name"] == "vase" and {one.path: one.sha256 for one in again.manifest.files} == files
    assert named["figures"]["learned"] == "vase-learned"
    learned = WorkFolder(work).get("edit", "vase-learned")
    learned.verify()
    assert {one.path: one.sha256 for one in learned.manifest.files} == files
    assert (learned.manifest.recipe, learned.manifest.seconds) == (before.recipe, before.seconds)
    assert [*stages, again.manifest.stage] == ["edit_palette", "edit_learn"]


@pytest.mark.slow
def test_options_of_extract_and_distill_reach_the_edit(edited, capsys, tmp_path):
    copy, short = tmp_path / "work", ("--budget", "5", "--rays", "512")
    shutil.copytree(edited, copy)
    said(capsys, "extract", copy, "--region", "ball", "--tolerance", "0.7", "--no-exr", "--name", "near")
    said(capsys, "stylize", copy, "--region", "ball", "--recolor", "--name", "near", *QUICK)
    said(capsys, "distill", copy, "--edit", "near", "--no-fade", "--name", "sharp")
    said(capsys, "finetune", copy, "--edit", "near", *short)
    work = WorkFolder(copy)

    def made_from(kind: str, name: str) -> set[str]:
        return {f"{ref.kind} {ref.name}" for ref in work.get(kind, name).manifest.inputs}

    assert made_from("edit", "near") == {"edit-dataset near"}
    assert "scene sharp" in made_from("field", "near") and not (copy / "scene" / "near").exists()
    # A table of an option file says otherwise, and so does `edit`, whose own these stages are.
    options = tmp_path / "options.toml"
    options.write_text("[extract]\ntolerance = 0.4\n[distill]\nmin_opacity = 0.6\n")
    said(capsys, "stylize", copy, "--region", "ball", "--recolor", "--name", "wide", "--config", options, *QUICK)
    said(capsys, "finetune", copy, "--edit", "wide", "--config", options, *short)
    assert made_from("edit", "wide") == {"edit-dataset ball"} and "scene wide" in made_from("field", "wide")
    assert work.get("edit-dataset", "ball").manifest.config["tolerance"] == 0.4
    assert work.get("scene", "wide").manifest.config["min_opacity"] == 0.6


def test_a_second_edit_keeps_the_first_and_either_can_be_restored(edited, middle, capsys):
    work, first = WorkFolder(edited), middle.partition(":")[0]
    scene = load_scene(next(one for one in work.artifacts("scene") if one.manifest.stage == "pose_import"))
    covered = binary_erosion(scene.images(scene.splits["train"][0])[..., 3] > 0.99, iterations=4)
    column, row = map(int, middle.partition(":")[2].split(","))
    far = max(np.argwhere(covered), key=lambda at: np.hypot(at[0] - row, at[1] - column))
    kept = {name: work.get("field", name).digest for name in ("ball", fitted(edited))}
    flags = [
        "--at",
        f"{first}:{far[1]},{far[0]}",
        "--tolerance",
        "0",
        "--reach",
        "0.5",
        "--most",
        "1",
        "--palette",
        "all=#2030f0",
    ]
    said(capsys, "edit", edited, "--of", "ball", *flags, "--recolor", "--name", "table", "--config",
         _finetune(edited), *QUICK)  # fmt: skip
    (plain, _), (ball, _), (both, _) = (
        load_field(work.get("field", name)) for name in (fitted(edited), "ball", "table")
    )
    assert [part.kind for part in layers_of(both.color)] == ["patch", "patch", plain.color.kind]
    assert {name: work.get("field", name).digest for name in kept} == kept
    scene = load_scene(work.get("scene", "table"))
    camera = scene.cameras[scene.splits["train"][0]]
    regions = {name: load_region(work.get("region", name))[0].edit for name in ("ball", "table")}
    views = [render_view(one, camera, threads=1, regions=regions) for one in (plain, ball, both)]
    in_ball, in_table = ((views[0].masks[name] > 0.9) for name in ("ball", "table"))
    assert in_ball.sum() > 8 and in_table.sum() > 8

    def shift(a, b, where):
        return (views[b].rgb - views[a].rgb)[where].mean(0)

    green, blue = shift(0, 2, in_ball & ~in_table), shift(0, 2, in_table & ~in_ball)
    assert green[1] > green[0] and blue[2] > blue[0] + 0.05
    # What the first edit made of the ball, the second leaves as it is, but for a seam.
    assert np.abs(shift(1, 2, in_ball & (views[0].masks["table"] < 0.01))).max() < 0.03
    again = ("--colors", "field", "--budget", "5", "--name", "whole-table")
    assert "a local edit that covers its own colors" in refused(capsys, "finetune", edited, "--edit", "table", *again)


def test_a_palette_of_the_whole_scene_is_learned_from_edited_pictures(edited, capsys):
    few = ("--budget", "30", "--refit-steps", "40", "--pixels", "512", "--levels", "4", "--table-bits", "12")
    said(capsys, "stylize", edited, "--of", "ball", "--method", "palettenerf", *few, "--name", "all-over")
    work = WorkFolder(edited)
    camera = photographed(work)
    region = {"ball": load_region(work.get("region", "ball"))[0].edit}
    names = (fitted(edited), "ball", "all-over")
    plain, green, mixed = (render_view(load_field(work.get("field", one))[0], camera, threads=1, regions=region)
                           for one in names)  # fmt: skip
    inside = plain.masks["ball"] > 0.9
    before, wanted, found = (view.rgb[inside].mean(0) for view in (plain, green, mixed))
    assert np.abs(found - wanted).max() < 0.5 * np.abs(wanted - before).max()


@pytest.mark.parametrize("picture", ["red", pytest.param("painting", marks=pytest.mark.slow)])
def test_a_part_alone_is_stylized_after_a_view_and_the_rest_keeps_bits(
    edited, middle, capsys, tmp_path, picture
):
    """After a picture that is given, and after one that is painted first."""
    work, view = WorkFolder(edited), middle.partition(":")[0]
    few = ("--method", "refnpr", "--levels", "4", "--table-bits", "12", "--budget", "9", "--refit-steps", "8")
    red = np.zeros((48, 48, 3), np.uint8) + np.array([220, 10, 10], np.uint8)
    write_png(tmp_path / "red.png", red)
    flags = {
        "red": ("--reference", f"{view}={tmp_path / 'red.png'}"),
        "painting": (
            "--style", edited / "photos" / PAINTING, "--reference-view", view, "--reference-steps", "3",
        ),
    }[picture]  # fmt: skip
    fit, _ = load_field(work.get("field", fitted(edited)))
    region = load_region(work.get("region", "ball"))[0]
    camera = photographed(work)
    before = render_view(fit, camera, threads=1, regions={"ball": region.edit})
    made = said(capsys, "stylize", edited, "--region", "ball", *flags, *few)
    name = f"ball-{picture}-refnpr"
    assert made["name"] == name
    field, _ = load_field(work.get("field", name))
    assert [part.kind for part in layers_of(field.color)] == ["patch", fit.color.kind]
    assert {ref.role: ref.name for ref in work.get("field", name).manifest.inputs}["region"] == "ball"
    after = render_view(field, camera, threads=1, regions={"own": field.color.marked})
    beside = after.masks["own"] == 0
    assert beside.sum() > 500 and np.array_equal(after.rgb[beside], before.rgb[beside])
    inside = before.masks["ball"] > 0.9
    assert np.abs(after.rgb - before.rgb)[inside].mean() > 0.02
    (reference,) = made["figures"]["references"]
    shown = read_image(Path(made["field"]) / reference["file"]).pixels
    photo = load_scene(photos_of(work)).images(0)
    over = photo[..., :3] * photo[..., 3:] + 1 - photo[..., 3:]
    assert np.abs(shown - over)[before.masks["ball"] == 0].max() < 0.01
    if picture == "red":
        figures = said(capsys, "eval", edited, "--of", name, "--region", "ball", "--perceptual", "none")["figures"]
        assert figures["background_ratio"] == pytest.approx(1, abs=0.1) and figures["change_inside"] > 0.02


def test_a_part_is_stylized_without_matching_whole_pictures(edited, capsys):
    painting = edited / "photos" / "painting.png"
    options = "--region", "ball", "--style", painting, "--method", "refnpr", "--match", "both"
    reported = refused(capsys, "stylize", edited, *options)
    assert "--match both maps every pixel" in reported
    reported = refused(capsys, "stylize", edited, *options[:-2], "--keep-colors")
    assert "--keep-colors maps every pixel" in reported
    reported = refused(capsys, "stylize", edited, "--region", "ball", "--of", "ball", "--style", painting, "--method",
                   "refnpr")  # fmt: skip
    assert "--of ball: region ball was selected in field fit; select it again" in reported
    for method in (("--method", "arf"), ("--method=palettenerf",)):
        reported = refused(capsys, "stylize", edited, "--region", "ball", "--style", painting, *method)
        assert "stylizes whole scenes; with --region, use --method refnpr" in reported


def test_an_edit_of_a_stylized_field_is_taught_by_what_that_field_shows(edited, middle, capsys):
    """A painting is in no photo: what lies beside the region would turn to the photos' colors."""
    name = next(one.name for one in WorkFolder(edited).artifacts("field") if one.manifest.stage == "stylize")
    flags = (
        "--at",
        middle,
        "--tolerance",
        "0",
        "--reach",
        "0.3",
        "--most",
        "1",
        "--palette",
        "all=#10e020",
        "--recolor",
    )
    options = ("--config", _finetune(edited), *QUICK)
    said(capsys, "edit", edited, "--of", name, *flags, "--name", "on-paint", *options)
    work = WorkFolder(edited)
    photos, pictures = (load_scene(work.get("scene", one)) for one in (photos_of(work).name, "on-paint"))
    stylized, taught = (load_field(work.get("field", one))[0] for one in (name, "on-paint"))
    region = {"part": load_region(work.get("region", "on-paint"))[0].edit}
    targets, _ = load_tensors(pictures.folder / EDIT_TARGETS)
    moved = []
    for view in pictures.splits["train"][:3]:
        camera, picture = pictures.cameras[view], pictures.images(view)
        seen, now = (render_view(one, camera, threads=1, regions=region) for one in (stylized, taught))
        edited_here = np.isin(np.arange(seen.alpha.size), targets.get(f"{view}.pixels", ())).reshape(seen.alpha.shape)
        solid = ~edited_here & (seen.alpha > 0.9)
        assert np.abs(picture[..., :3] - seen.rgb / seen.alpha.clip(1e-6)[..., None])[solid].max() < 0.01
        assert np.abs(picture[..., :3] - photos.images(view)[..., :3])[solid].mean() > 0.03
        beside = binary_dilation(edited_here, iterations=4) & ~edited_here & (seen.masks["part"] < 0.02)
        moved.append(np.abs(now.rgb - seen.rgb)[beside])
    assert np.concatenate(moved).mean() < 0.01
    # The whole of it would lose the painting, and says so.
    for command in (("stylize", "--method", "palettenerf"), ("deform",)):
        line = refused(capsys, command[0], edited, "--of", name, *command[1:], "--name", "other")
        assert f"Start from --of {fitted(edited)}" in line
    for edit, of in (("ball", name), ("on-paint", fitted(edited)), ("on-paint", "ball")):
        line = refused(capsys, "finetune", edited, "--edit", edit, "--of", of, "--name", "other")
        assert "pictures of another field" in line


def test_the_whole_fields_colors_can_learn_instead(edited, capsys):
    said(capsys, "finetune", edited, "--edit", "ball", "--colors", "field", "--budget", "5", "--name", "whole")
    field, _ = load_field(WorkFolder(edited).get("field", "whole"))
    plain, _ = load_field(WorkFolder(edited).get("field", fitted(edited)))
    assert field.color.kind == plain.color.kind
    assert (field.density.values != plain.density.values).any()
    said(capsys, "finetune", edited, "--edit", "ball", "--colors", "field", "--freeze-density", "--budget", "5",
         "--name", "held")  # fmt: skip
    held, _ = load_field(WorkFolder(edited).get("field", "held"))
    np.testing.assert_array_equal(held.density.values, plain.density.values)


@pytest.mark.slow
def test_the_commands_that_only_names_make_what_was_missing(edited, tmp_path, capsys):
    """An edit learned with other options, and its photos: each named command is enough for the next step."""
    work = tmp_path / "a folder"
    shutil.copytree(edited, work)
    quick = ["--palette-steps", "40", *QUICK[2:]]
    commands = [
        ["stylize", work, "--region", "ball", "--recolor", "--palette", "0=#2030f0", "--name", "other", *quick],
        ["finetune", work, "--edit", "other", "--budget", "5"],
    ]
    for command, missing in zip(commands, ("edit other-learned", "scene other"), strict=True):
        line = refused(capsys, *command, "--only")
        assert f"{missing} is missing or out of date" in line
        said(capsys, *shlex.split(line.partition("; run: ")[2])[1:])
        said(capsys, *command, "--only")


def test_regions_are_joined_and_cut(edited, capsys):
    region, space = load_region(WorkFolder(edited).get("region", "ball"))
    ends = space.unwarp((np.argwhere(region.edit) + 0.5) / region.cells)
    low, high = ends.min(0) - 0.1, ends.max(0) + 0.1
    left = [*low, np.median(ends[:, 0]), *high[1:]]
    said(capsys, "select", edited, "--box", *left, "--most", "1", "--name", "left")
    kept = said(capsys, "select", edited, "--union", "ball", "--intersect", "left", "--name", "ball-left")["figures"]
    cut = said(capsys, "select", edited, "--union", "ball", "--subtract", "left", "--name", "ball-right")["figures"]
    whole = json.loads((edited / "region" / "ball" / "manifest.json").read_text())["figures"]
    assert kept["edit_cells"] + cut["edit_cells"] == whole["edit_cells"]


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["select", "--at", "nowhere:1,1"], "view 'nowhere' not found"),
        (["select", "--at", "MIDDLE", "--most", "0.0001"], "has grown over"),
        (["select"], "nothing is selected"),
        (["select", "--at", "FIRST:400,1"], "48x48 pixels"),
        (["stylize", "--region", "ball", "--recolor", "--palette", "9=#000000", *QUICK], "does not exist"),
        (["stylize", "--region", "ball"], "takes either --recolor or --style"),
        (["stylize", "--region", "ball", "--recolor", "--of", "painting-arf"], "was selected in field fit"),
        (["stylize", "--region", "ball", "--style", "PAINTING", "--crop", "0", "0", "9000"], "does not fit"),
        (["stylize", "--region", "no-such", "--recolor"], "found none"),
        (["stylize", "--region", "ball", "--recolor", "--crop", "0", "0", "32"], "no effect with --recolor"),
        (["distill", "--edit", "no-such"], "found none"),
        (["edit", "--of", "ball", "--at", "MIDDLE", "--recolor", "--name", "ball"], "region ball would replace"),
        (["edit", "--at", "MIDDLE", "--recolor", "--name", "main"], "scene main would replace what it is made from"),
        (["edit", "--at", "MIDDLE", "--recolor", "--name", "fit"], "field fit would replace what it is made from"),
        (["select", "--union", "ball", "--at", "MIDDLE", "--name", "ball"], "region ball would replace"),
    ],
)
def test_bad_requests_are_one_line_and_lose_nothing(edited, middle, capsys, flags, words):
    first = middle.partition(":")[0]
    painting = str(edited / "photos" / "painting.png")
    swapped = {"MIDDLE": middle, "PAINTING": painting}
    verb, *more = [swapped.get(flag, flag).replace("FIRST", first) for flag in flags]
    before = sorted(path.relative_to(edited) for path in edited.rglob("*") if path.is_file())
    name = [] if "--name" in more else ["--name", "other"]
    assert words in refused(capsys, verb, edited, *more, *name)
    after = sorted(path.relative_to(edited) for path in edited.rglob("*") if path.is_file())
    assert [p for p in before if p not in after] == []


def test_a_scribble_of_another_size_or_of_nothing_is_refused(edited, middle, capsys, tmp_path):
    first = middle.partition(":")[0]
    write_png(tmp_path / "small.png", np.full((8, 8, 3), 255, np.uint8))
    assert "8x8 pixels, but view" in refused(capsys, "select", edited, "--scribble", f"{first}={tmp_path}/small.png")
    write_png(tmp_path / "black.png", np.zeros((48, 48, 3), np.uint8))
    assert "no pixel of the scribble" in refused(
        capsys, "select", edited, "--scribble", f"{first}={tmp_path}/black.png"
    )


def test_seeds_that_meet_nothing_are_refused_or_reported(edited, middle, capsys, tmp_path):
    scene, first = load_scene(photos_of(WorkFolder(edited))), middle.partition(":")[0]
    empty = ~binary_dilation(scene.images(scene.splits["train"][0])[..., 3] > 0, iterations=3)
    row, column = np.argwhere(empty)[0]
    nowhere = f"{first}:{column},{row}"
    for flags in (("--at", nowhere), ("--avoid", nowhere)):
        assert f"{nowhere} hits nothing" in refused(
            capsys, "select", edited, "--at", middle, *flags, "--name", "seeds"
        )
    x, y = map(int, middle.partition(":")[2].split(","))
    scribble = np.zeros((48, 48), np.uint8)
    scribble[y, x] = 255
    scribble[tuple(np.argwhere(empty)[:3].T)] = 255
    write_png(tmp_path / "drawn.png", scribble)
    drawn = ("--scribble", f"{first}={tmp_path}/drawn.png", "--name", "seeds")
    assert main(["select", str(edited), *drawn]) == 0
    assert "75% of the scribble hits nothing" in capsys.readouterr().err
    write_png(tmp_path / "drawn.png", 255 * empty.astype(np.uint8))
    assert "the scribble hits nothing in the field" in refused(capsys, "select", edited, *drawn)


def test_an_edit_of_a_region_of_another_field_is_refused(edited, capsys, tmp_path):
    """A region divides the space of the field that it was selected in."""
    other = tmp_path / "other"
    shutil.copytree(edited, other)
    work = WorkFolder(other)
    ball = work.get("region", "ball")
    region, space = load_region(ball)
    made = ball.manifest
    begun = work.begin("region", "elsewhere", Recipe(made.stage, made.revision, made.config, made.inputs, made.seed))
    save_region(begun.path, region, replace(space, far=2 * space.far), {})
    begun.commit()
    assert "was selected on a different field" in refused(capsys, "extract", other, "--region", "elsewhere")


@pytest.mark.slow
def test_learning_distilling_and_tuning_run_on_a_gpus_kernels(edited, capsys, monkeypatch):
    """Through Triton's interpreter, on CPU tensors: the very commands. Whole views would take it minutes each."""
    pytest.importorskip("triton", reason="Triton is not installed: pip install -e '.[test]' brings it on Linux")
    from stages import distill, edit_learn, finetune

    for stage in (edit_learn, distill, finetune):
        monkeypatch.setattr(stage, "gpu_of", lambda context, field=None: "cpu")
    work, small = (
        WorkFolder(edited),
        ["--palette-steps", "3", "--pruned-steps", "2", "--colors", "4", "--max-colors", "3"],
    )
    requested = ["--region", "ball", "--recolor", "--palette", "0=#10e020", "--name", "there"]
    said(capsys, "stylize", edited, *requested, *small)
    figures = [work.get("edit", "there-learned").manifest.figures]
    figures.append(said(capsys, "distill", edited, "--edit", "there")["figures"])
    tuning = ["--colors", "field", "--budget", "2", "--rays", "64"]
    figures.append(said(capsys, "finetune", edited, "--edit", "there", *tuning)["figures"])
    assert all("gpu_memory_mb" in found for found in figures)
    taught, plain = (load_field(work.get("field", name))[0] for name in ("there", fitted(edited)))
    for one, other in ((taught.color, plain.color), (taught.density, plain.density)):
        assert 0 < np.abs(one.values - other.values).max() < 0.1
