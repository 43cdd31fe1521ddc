"""Evaluation of a local edit on made-up pictures: every figure is worked out again, pixel by pixel."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from schemas.errors import BadInput
from schemas.exr import write_exr
from schemas.frames import Frame, FrameCamera, Frames, write_frames
from schemas.images import write_png
from schemas.work_folder import WorkFolder
from stages import evaluate
from stages.artifacts.field import save_field
from stages.artifacts.region import save_region
from stages.configs.evaluate import EvaluateConfig
from stages.evaluate import pinned
from stages.evaluation import region_masks as mask_module
from stages.run.progress import Context
from stages.run.runner import execute
from stylerf.editing.edit_grid import Region
from stylerf.geometry.space_warp import SpaceWarp
from tests.stages import evaluation_fixture as made
from tests.stylerf.small import density, field_of, hash_color

POSITIONS = [0.0, 0.25]
BOX = SpaceWarp.box([-1, -1, 3], [1, 1, 5])
QUIET = EvaluateConfig(perceptual="none", sheet=2, margin=2, ring=4)
ROWS, COLUMNS = np.indices((72, 96))


def region_of(space: SpaceWarp = BOX, cells: int = 8):
    """The half of the cube towards +x."""
    edit = np.indices((cells,) * 3)[0] >= cells // 2
    return lambda folder: save_region(folder, Region(edit, np.zeros_like(edit)), space, {})


def seen_of_region(x: float) -> np.ndarray:
    """Pixels whose ray meets the solid box's front, at z = 3, between x = 0 and x = 1."""
    at_x, at_y = x + (COLUMNS + 0.5 - 48) / 90 * 3, (ROWS + 0.5 - 36) / 90 * 3
    return (at_x > 0) & (at_x < 1) & (np.abs(at_y) < 1)


def solid():
    field = field_of(BOX, 1, hash_color(2), step=1 / 100)
    field.density = density(0, size=(2, 2, 2))
    field.density.values[:-1], field.density.values[-1] = 0, 12
    return field


def frames_with_masks(field: str, path: str, cameras, pictures, masks):
    """Frames as `render` writes them where region half.x is there."""

    def write(folder):
        frames = []
        for i, (view, seen, mask) in enumerate(zip(cameras, pictures, masks, strict=True)):
            write_exr(folder / f"exr/{i}.exr", replace(made.exr_of(view, seen), masks={"half_x": mask}))
            write_png(folder / f"png/{i}.png", np.zeros((72, 96, 3), np.uint8))
            entry = FrameCamera(**made.camera_entry(view))
            frames.append(Frame(view.name, f"exr/{i}.exr", f"png/{i}.png", entry, i if path == "test" else None))
        write_frames(folder, Frames(field, path, tuple(frames), masks={"half.x": "half_x"}))

    return write


def nearest(inside: np.ndarray) -> np.ndarray:
    """Distance of each pixel to the nearest of the region, by looking at all of them."""
    places = np.argwhere(inside)
    return np.sqrt(((np.stack([ROWS, COLUMNS], -1)[:, :, None] - places) ** 2).sum(-1)).min(-1)


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    """Unedited renders are 0.02 and 0.06 too bright; the edit paints the region and runs over by six pixels."""
    work = WorkFolder(tmp_path_factory.mktemp("edit"))
    scene = made.make_scene(work, POSITIONS)
    base = made.commit(work, "field", "fit", "nerf_fit", {"scene": scene}, lambda at: save_field(at, solid(), "black"))
    edited = made.make_field(work, "blue", "finetune", {"scene": scene, "field": base})
    region = made.commit(work, "region", "half.x", "select", {"field": base}, region_of())
    cameras = [made.camera(x, f"photo_{i:02d}") for i, x in enumerate(POSITIONS)]
    plain, painted = [], []
    for x, view, brighter in zip(POSITIONS, cameras, (0.02, 0.06), strict=True):
        seen = made.look(view)
        plain.append(replace(seen, rgb=seen.rgb + np.float32(brighter)))
        distance = nearest(seen_of_region(x))[..., None]
        run_over = plain[-1].rgb + np.where(distance <= 6, np.float32(0.08), 0)
        painted.append(replace(seen, rgb=np.where(distance == 0, np.float32([0.1, 0.3, 0.9]), run_over)))
    inputs = {
        "scene": scene, "field": edited, "base_field": base, "region.half.x": region,
        "frames": made.make_frames(work, "blue-test", "test", cameras, painted, edited),
        "unedited_frames": made.make_frames(work, "fit-test", "test", cameras, plain, base),
    }  # fmt: skip
    return work, inputs, plain, painted, cameras


def evaluated(work, inputs, config=QUIET, name="report"):
    report, _ = execute(evaluate.SPEC, evaluate.run, work, name, inputs, config, Context(threads=2), force=True)
    return report, json.loads(report.file("report.json").read_text())


def expected(made_up, view: int, margin: float, ring: float, inside: np.ndarray | None = None) -> dict[str, float]:
    """The figures of one view, by loops."""
    _, _, plain, painted, cameras = made_up
    inside = seen_of_region(POSITIONS[view]) if inside is None else inside
    distance, photo = nearest(inside), np.round(made.look(cameras[view]).rgb * 255) / 255
    before, after = (np.clip(one[view].rgb, 0, 1) for one in (plain, painted))
    sums = dict.fromkeys(("mse", "before", "outside", "bleeding", "ring", "change", "inside"), 0.0)
    for row, column in np.ndindex(72, 96):
        at, d = (row, column), distance[row, column]
        if d > margin:
            sums["outside"] += 1
            sums["mse"] += ((after[at] - photo[at]) ** 2).mean()
            sums["before"] += ((before[at] - photo[at]) ** 2).mean()
        if margin < d <= margin + ring:
            sums["ring"] += 1
            sums["bleeding"] += np.abs(after[at] - before[at]).mean()
        if d == 0:
            sums["inside"] += 1
            sums["change"] += np.abs(after[at] - before[at]).mean()
    return {
        "background_mse": sums["mse"] / sums["outside"],
        "background_mse_unedited": sums["before"] / sums["outside"],
        "bleeding": sums["bleeding"] / sums["ring"],
        "change_inside": sums["change"] / sums["inside"],
        "region_share": sums["inside"] / (72 * 96),
    }


def metric(report, key):
    return next(item for item in report["metrics"] if item["key"] == key)


@pytest.fixture(scope="module")
def measured(made_up):
    return evaluated(made_up[0], made_up[1])


def test_a_known_edit_gives_the_known_metrics(made_up, measured):
    _, report = measured
    wanted = [expected(made_up, view, 2, 4) for view in range(2)]
    for view, values in enumerate(wanted):
        for key, value in values.items():
            assert report["views"][view][key] == pytest.approx(value, rel=0.01), key  # half floats, mask by 1/100 steps
    assert wanted[0]["bleeding"] == pytest.approx(0.08, rel=0.03)  # as it was painted, but for what clips
    means = {key: np.mean([values[key] for values in wanted]) for key in wanted[0]}
    mse = metric(report, "background_mse")
    assert mse["mean"] == pytest.approx(means["background_mse"], rel=0.01)
    assert mse["reference"]["the unedited renders"] == pytest.approx(means["background_mse_unedited"], rel=0.01)
    ratio = metric(report, "background_ratio")["mean"]
    assert ratio == pytest.approx(means["background_mse"] / means["background_mse_unedited"], rel=0.01)
    assert metric(report, "change_lab")["mean"] > 20
    assert "within 2 pixels" in mse["protocol"] and not any("{" in item["protocol"] for item in report["metrics"])
    assert report["edit"] == {"regions": ["half.x"], "unedited": "fit", "masks": "", "margin": 2, "ring": 4}
    assert not report["stylized"] and metric(report, "psnr")["mean"] < 25  # the edit is an error there
    assert any("edit counts as an error" in note["why"] for note in report["not_measured"])


def test_the_page_shows_what_changed(measured):
    artifact, _ = measured
    page = artifact.file("report.html").read_text()
    assert page.count("<img") == 2 * 5 and "before the edit" in page and "Change: 0" in page
    assert "Background MSE" in page and "edited field" in page
    with open(artifact.file("views.csv"), newline="") as stream:
        assert {"background_mse", "background_mse_unedited", "bleeding"} <= {*next(csv.reader(stream))}


def test_masks_stored_in_frames_replace_marching(made_up, measured, monkeypatch):
    work, inputs, plain, _, cameras = made_up
    region, base = inputs["region.half.x"], inputs["base_field"]

    def never(*_):
        raise AssertionError("marched")

    masks = [seen_of_region(x) * 0.75 for x in POSITIONS]
    write = frames_with_masks("fit", "test", cameras, plain, masks)
    masked = made.commit(work, "frames", "masked", "render", {"field": base, "region.half.x": region}, write)
    with monkeypatch.context() as patch:
        patch.setattr(mask_module, "march_view", never)
        _, report = evaluated(work, inputs | {"unedited_frames": masked}, name="masked")
        assert report["views"][0]["background_mse"] == pytest.approx(
            measured[1]["views"][0]["background_mse"], rel=1e-3
        )
        # A region made again since then is not that of the channel.
        other = made.commit(work, "region", "half.x", "select", {"field": base}, region_of(), config={"other": 1})
        with pytest.raises(AssertionError, match="marched"):
            evaluated(work, inputs | {"unedited_frames": masked, "region.half.x": other}, name="masked")
    again = made.commit(work, "region", "half.x", "select", {"field": base}, region_of())
    assert again.digest == region.digest  # as other tests have it


def test_given_masks_at_any_size_and_depth(made_up, tmp_path):
    """Half the size, of 0 and 1 in eight bits: taken without a margin; a view without a picture takes no part."""
    work, inputs, *_ = made_up
    half = seen_of_region(POSITIONS[0])[::2, ::2]
    write_png(tmp_path / "photo_00_mask.png", half.astype(np.uint8))
    config = replace(QUIET, masks=str(tmp_path))
    _, report = evaluated(work, inputs, pinned(config), name="given")
    whole = np.kron(half, np.ones((2, 2), bool))  # twice the size by lines between values: the same, over a half
    for key, value in expected(made_up, 0, 0, 4, whole).items():
        assert report["views"][0][key] == pytest.approx(value, rel=0.01), key
    assert "background_mse" not in report["views"][1] and metric(report, "background_mse")["count"] == 1
    assert any("1 views have no mask" in text and "photo_01" in text for text in report["warnings"])
    assert report["edit"]["margin"] == 0 and "given mask" in metric(report, "background_mse")["protocol"]
    first = pinned(config).masks_digest
    write_png(tmp_path / "photo_00_mask.png", (~half).astype(np.uint8))
    assert pinned(config).masks_digest != first


def test_empty_masks_give_a_warning(made_up, tmp_path):
    work, inputs, *_ = made_up
    for i, level in enumerate((0, 0)):
        write_png(tmp_path / f"photo_{i:02d}.png", np.full((72, 96), level, np.uint8))
    _, report = evaluated(work, inputs, replace(QUIET, masks=str(tmp_path)), name="black")
    assert any("are empty" in text for text in report["warnings"])


def test_masks_of_another_shape_and_empty_folders_are_refused(made_up, tmp_path):
    work, inputs, *_ = made_up
    with pytest.raises(BadInput, match="found none"):
        pinned(replace(QUIET, masks=str(tmp_path)))
    write_png(tmp_path / "photo_00.png", np.zeros((72, 72), np.uint8))
    with pytest.raises(BadInput, match="72x72 but the view is 96x72"):
        evaluated(work, inputs, replace(QUIET, masks=str(tmp_path)), name="refused")


def test_names_with_folders_are_not_mixed_up(tmp_path):
    write_png(tmp_path / "r_0.png", np.full((4, 4), 255, np.uint8))
    assert mask_module.ImageMasks(tmp_path, ["test/r_0.png"]).file_of("test/r_0.png") == tmp_path / "r_0.png"
    assert mask_module.ImageMasks(tmp_path, ["test/r_0", "train/r_0"]).file_of("test/r_0") is None
    write_png(tmp_path / "train" / "r_0.png", np.full((4, 4), 255, np.uint8))
    both = mask_module.ImageMasks(tmp_path, ["test/r_0", "train/r_0"])
    assert both.file_of("train/r_0") == tmp_path / "train" / "r_0.png" and both.file_of("test/r_0") is None


def test_training_views_have_their_own_metrics(made_up, measured):
    """Training frames that are darker by 0.1 and 0.02 than those of the test views, so that neither stands in."""
    work, inputs, plain, painted, cameras = made_up
    trained = [
        [replace(seen, rgb=seen.rgb - np.float32(darker)) for seen in some]
        for some, darker in ((plain, 0.1), (painted, 0.02))
    ]
    more = {
        "train_frames": made.make_frames(work, "blue-train", "train", cameras, trained[1], inputs["field"]),
        "unedited_train_frames": made.make_frames(
            work, "fit-train", "train", cameras, trained[0], inputs["base_field"]
        ),
    }
    artifact, report = evaluated(work, inputs | more, name="trained")
    wanted = [expected((work, inputs, *trained, cameras), view, 2, 4) for view in range(2)]
    mse, before, change = (
        np.mean([values[key] for values in wanted])
        for key in ("background_mse", "background_mse_unedited", "change_inside")
    )
    found = metric(report, "train_background_mse")
    assert found["mean"] == pytest.approx(mse, rel=0.01)
    assert found["reference"]["the unedited renders"] == pytest.approx(before, rel=0.01)
    assert metric(report, "train_background_ratio")["mean"] == pytest.approx(mse / before, rel=0.01)
    assert metric(report, "train_change_inside")["mean"] == pytest.approx(change, rel=0.01)
    assert abs(metric(report, "background_mse")["mean"] / mse - 1) > 0.05
    assert metric(report, "train_bleeding")["protocol"].startswith("On training views.")
    assert len(report["training_views"]) == 2 and artifact.file("training.csv").is_file()
    assert report["views"] == measured[1]["views"] and "Training views" in artifact.file("report.html").read_text()


def test_a_view_that_does_not_show_the_region_is_all_background(made_up):
    work, inputs, *_ = made_up
    nothing = np.zeros((8,) * 3, bool)
    empty = made.commit(
        work, "region", "empty", "select", {}, lambda at: save_region(at, Region(nothing, nothing), BOX, {})
    )
    chosen = {role: one for role, one in inputs.items() if not role.startswith("region")} | {"region.empty": empty}
    _, report = evaluated(work, chosen, name="empty")
    assert report["views"][0]["region_share"] == 0 and "change_inside" not in report["views"][0]
    assert report["views"][0]["background_mse"] > 0.01  # the whole edit counts
    assert report["warnings"] == []


def test_a_region_of_another_space_is_refused(made_up):
    work, inputs, *_ = made_up
    other = made.commit(work, "region", "other", "select", {}, region_of(replace(BOX, far=77.0)))
    with pytest.raises(BadInput, match="region other was selected on a different field"):
        evaluated(work, inputs | {"region.other": other}, name="refused")


def test_without_an_edit_there_are_no_edit_metrics(made_up):
    work, inputs, *_ = made_up
    artifact, report = evaluated(work, {role: inputs[role] for role in ("scene", "frames", "field")}, name="plain")
    assert report["edit"] is None and report["training_views"] == []
    assert not any("background" in item["key"] or "change" in item["key"] for item in report["metrics"])
    assert {record.path for record in artifact.manifest.files} == {
        "charts/psnr_views.png", "charts/psnr_views.svg", "report.html", "report.json", "views.csv",
    }  # fmt: skip


def test_consistency_of_the_edit_is_that_of_its_own_pixels(made_up):
    """Along a slide the region turns brighter by 0.1 a frame, and nothing else does.

    The film's own masks, of the edited field, show all but the region: the unedited field decides.
    """
    work, inputs, *_ = made_up
    path = [0.0, 0.05, 0.1]
    cameras = [made.camera(x, f"slide_{i}") for i, x in enumerate(path)]
    steady = [made.look(camera) for camera in cameras]
    flickering = []
    for i, (x, seen) in enumerate(zip(path, steady)):
        rgb = np.where(seen_of_region(x)[..., None], np.float32(0.3 + 0.1 * i), seen.rgb)
        flickering.append(replace(seen, rgb=rgb))
    masks = [np.ones((72, 96)) - seen_of_region(x) for x in path]
    write, given = frames_with_masks("blue", "slide", cameras, flickering, masks), inputs["region.half.x"]
    film = made.commit(work, "frames", "blue-slide", "render", {"field": inputs["field"], "region": given}, write)
    _, report = evaluated(work, {**inputs, "path_frames": film}, replace(QUIET, gap=2), "film")
    assert metric(report, "edit_short_rmse")["mean"] == pytest.approx(0.1, abs=0.01)
    assert metric(report, "edit_long_rmse")["mean"] == pytest.approx(0.2, abs=0.01)
    assert metric(report, "short_rmse")["mean"] < 0.08


def test_palette_metrics_are_those_its_edit_recorded(made_up):
    work, inputs, *_ = made_up
    reported = {"sparsity": 0.75, "palette_variation": 0.012, "psnr": 30.0}
    nothing = {"write": lambda at: (at / "a").write_text("a")}
    edit = made.commit(work, "edit", "blue", "edit_learn", {}, **nothing, figures=reported)
    painted = made.commit(work, "scene", "painted", "distill", {"scene": inputs["scene"], "edit": edit}, **nothing)
    field = made.make_field(work, "learned", "finetune", {"scene": painted, "field": inputs["base_field"]})
    _, report = evaluated(work, {**inputs, "field": field}, name="palette")
    assert metric(report, "sparsity")["mean"] == 0.75 and metric(report, "palette_variation")["mean"] == 0.012
    assert metric(report, "sparsity")["count"] == 1
