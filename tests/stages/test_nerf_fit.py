"""Which capacities a fit climbs, by the space of its scene."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from schemas.work_folder import WorkFolder
from stages import nerf_fit
from stages.artifacts.field import load_field
from stages.artifacts.photos import level_of
from stages.configs.fit import FitConfig
from stages.nerf_fit import fit_settings, report_ineffective_options, report_memory, shown_background
from stages.run.progress import Context
from stages.run.runner import execute
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.training.common.ray_dataset import background_of
from stylerf.training.fit.settings import FULL, LEVELS
from tests.stages.importing import Said
from tests.stages.stress_fixture import make_capture
from tests.stylerf.small import SPACES

SCENE = SimpleNamespace(
    background="none",
    layout="unbounded",
    cameras=[SimpleNamespace(width=400, height=300)],
    splits={"train": [*range(20)]},
)


def settings(space: SpaceWarp, **options):
    return fit_settings(FitConfig(**options), SCENE, space)


def ends_in_time(requested) -> bool:
    return (
        sorted(requested.level_ends) == list(requested.level_ends)
        and requested.level_ends[-1] < requested.held_out_until
    )


def test_a_density_in_a_contraction_grows_finer_and_in_a_short_time_its_color_does_not():
    requested = settings(SPACES["contraction"])
    assert [level.resolution for level in requested.levels] == [64, 128, 192, 384]
    assert requested.levels[-1].color.resolution == 384
    assert settings(SPACES["contraction"], budget="30s").levels[-1].color.resolution == 256
    assert [level.density_rank for level in requested.levels] == [8, 16, 16, 8]
    assert len(requested.level_ends) == len(requested.level_max_steps) == len(requested.levels) and ends_in_time(
        requested
    )


@pytest.mark.parametrize(
    ("space", "pixels", "last"),
    [("box", 351, LEVELS[-1]), ("box", 352, FULL), ("frustum", 351, LEVELS[-1]), ("frustum", 352, LEVELS[-1])],
)
def test_colors_of_an_object_are_finer_where_its_photos_are(space, pixels, last):
    scene = SimpleNamespace(**vars(SCENE) | {"cameras": [SimpleNamespace(width=20, height=pixels)]})
    requested = fit_settings(FitConfig(), scene, SPACES[space])
    levels = tuple(replace(level, cells=64) for level in requested.levels)
    assert levels == (*LEVELS[:3], last) and not requested.level_max_steps
    assert [level.cells for level in requested.levels] == ([64] * 4 if space == "box" else [64, 64, 128, 128])
    assert len(requested.level_ends) == len(requested.levels) and ends_in_time(requested)
    assert LEVELS[-1].resolution == FULL.resolution and LEVELS[-1].color.resolution < FULL.color.resolution


@pytest.mark.parametrize(
    ("layout", "kind", "clears"), [("object", "vm", False), ("forward", "hash", True), ("unbounded", "vm", True)]
)
def test_captures_lose_haze_and_forward_facing_ones_get_local_density(layout, kind, clears):
    scene = SimpleNamespace(**vars(SCENE) | {"layout": layout})
    requested = fit_settings(FitConfig(), scene, SPACES["frustum"])
    assert (requested.kinds.density, requested.kinds.color) == (kind, "vm")
    assert (requested.least_weight > 0) == (requested.distortion > 0) == clears
    assert requested.overshoot == ((2, 2) if layout == "unbounded" else (1, 1))
    assert ("degree" in requested.prunings) != clears and "resolution" in requested.prunings
    given = fit_settings(FitConfig(field="voxel", least_weight=0.0, distortion_weight=0.3), scene, SPACES["frustum"])
    assert (given.kinds.density, given.least_weight, given.distortion) == ("voxel", 0.0, 0.3)
    assert given.overshoot == (1, 1)
    one = fit_settings(FitConfig(least_weight=0.02), scene, SPACES["frustum"])
    assert one.overshoot == (requested.overshoot[0], 1) and one.least_weight == 0.02


def test_forward_facing_captures_are_smoothed_by_how_few_their_photos_are():
    def smoothness(layout: str, photos: int, **options) -> tuple[float, float]:
        scene = SimpleNamespace(**vars(SCENE) | {"layout": layout, "splits": {"train": [*range(photos)]}})
        return fit_settings(FitConfig(**options), scene, SPACES["frustum"]).smoothness

    few = [smoothness("forward", photos) for photos in (10, 25, 50, 200)]
    assert few == [pytest.approx((weight, weight)) for weight in (5e-3, 2e-3, 1e-3, 1e-3)]
    assert smoothness("unbounded", 10) == smoothness("object", 10) == (3e-3, 3e-3)
    assert smoothness("forward", 10, smoothness=0.0) == (0, 0)
    assert smoothness("forward", 10, smoothness=0.02) == (0.02, 0.02)


@pytest.mark.parametrize(
    ("layout", "field", "expected"),
    [
        ("object", "hash", (1e-4, 1e-4)),
        ("object", "hash+vm", (1e-4, 3e-3)),
        ("object", "vm+voxel", (3e-3, 1e-4)),
        ("unbounded", "voxel+vm", (3e-3, 3e-3)),
    ],
)
def test_grids_are_smoothed_less_than_planes_and_lines(layout, field, expected):
    scene = SimpleNamespace(**vars(SCENE) | {"layout": layout})
    assert fit_settings(FitConfig(field=field), scene, SPACES["box"]).smoothness == expected


@pytest.mark.parametrize(("space", "level_max_steps"), [("contraction", True), ("box", False)])
@pytest.mark.parametrize("options", [{"field": "voxel"}, {"field": "vm+hash"}, {"head": "mlp"}])
def test_other_kinds_search_four_rungs(space, level_max_steps, options):
    requested = settings(SPACES[space], **options)
    assert [level.resolution for level in requested.levels] == [64, 128, 192, 256]
    assert replace(requested.levels[-1], cells=64) == FULL
    assert (
        len(requested.level_ends) == 4
        and ends_in_time(requested)
        and bool(requested.level_max_steps) is level_max_steps
    )


def test_a_color_behind_a_network_has_one_width_on_every_rung():
    requested = settings(SPACES["contraction"], head="mlp")
    assert {level.color_rank for level in requested.levels} == {24}
    fixed = settings(SPACES["box"], head="mlp", capacity="fixed:128x8x16")
    assert {level.color_rank for level in fixed.levels} == {16}


def test_a_capacity_given_by_hand_is_climbed_to_whatever_the_space():
    requested = settings(SPACES["contraction"], capacity="fixed:192x8x16")
    last = requested.levels[-1]
    assert (last.resolution, last.density_rank, last.color_rank) == (192, 8, 16) and requested.force_growth
    assert len(requested.level_ends) == len(requested.levels) - 1


def test_views_inside_a_capture_decide():
    grid = np.array([(x, y, 0.0) for y in range(5) for x in range(5)])
    rim = {at for at, (x, y, _) in enumerate(grid) if {x, y} & {0, 4}}
    inner = nerf_fit.surrounded(grid)
    assert inner == sorted(inner) and {*range(25)} - rim <= {*inner} and not {0, 4, 20, 24} & {*inner}
    path = np.array([(0.0, 0.0, z) for z in range(20)])
    assert nerf_fit.surrounded(path) == [*range(2, 18)]
    uneven = np.cumsum(np.arange(10.0))[:, None] * [1, 0, 0]
    assert nerf_fit.surrounded(uneven) == [0, 1, 2, 3, 4]
    assert nerf_fit.surrounded(np.eye(3)[:2]) == [0, 1]


@pytest.mark.parametrize(
    ("layout", "count", "expected"), [("forward", -1, [8, 16]), ("object", -1, [7, 17]), ("forward", 11, None)]
)
def test_held_out_views_are_spread_evenly_over_those_that_may_be(layout, count, expected):
    cameras = [SimpleNamespace(center=np.array([x, 0.0, 0.0])) for x in range(24)]
    scene = SimpleNamespace(layout=layout, cameras=cameras, splits={"train": [*range(2, 22)]})
    found = nerf_fit._held_out(scene, count)
    if expected is None:
        assert len({*found}) == count
    else:
        assert found == expected


def test_batches_grow_with_the_time_there_is_unless_their_size_is_given():
    space = SPACES["box"]
    budgets = ("20s", "45s", "60s", "5m", "900")
    assert [fit_settings(FitConfig(budget=one), SCENE, space).samples for one in budgets] == [
        30_000, 45_000, 60_000, 90_000, 90_000,
    ]  # fmt: skip
    assert len({fit_settings(FitConfig(budget=one), SCENE, space, "cuda").samples for one in budgets}) == 1
    assert all(fit_settings(FitConfig(samples=2000), SCENE, space, device).samples == 2000 for device in (None, "cuda"))
    with pytest.raises(ValueError, match="samples must be 1000 or more"):
        FitConfig(samples=999)


@pytest.mark.parametrize(
    ("budget", "device", "finest"),
    [("59s", None, 256), ("60s", None, 352), ("2999", None, 256), ("3000", None, 352), ("5s", "cuda", 352)],
)
def test_colors_of_a_forward_facing_capture_get_finer_where_there_is_time(budget, device, finest):
    scene = SimpleNamespace(**vars(SCENE) | {"layout": "forward"})
    requested = fit_settings(FitConfig(budget=budget), scene, SPACES["frustum"], device)
    assert requested.levels[-1].color.resolution == finest
    assert len(requested.level_ends) == len(requested.levels) and ends_in_time(requested)


@pytest.mark.parametrize("kind", ["white", "black", "none", "random"])
def test_behind_a_field_stands_what_it_was_trained_over(kind):
    assert level_of(shown_background(kind)) == background_of(kind, 1, None)[0, 0]


def test_a_boxed_object_scene_keeps_its_background_and_reports_its_ranks(tmp_path):
    """What is made of the field later teaches with the background that is reported here. Behind a small network the
    color has one width from the first level on; six steps are enough for two levels."""
    work, said = WorkFolder(tmp_path / "work"), Said()
    scene = make_capture(work, background="none")
    config = FitConfig(budget="6", space="box", capacity="fixed:72x8x24", head="mlp", samples=1000, held_out=0)
    made, _ = execute(nerf_fit.SPEC, nerf_fit.run, work, "fit", {"scene": scene}, config, Context(progress=said))
    field, background = load_field(made)
    assert (background, field.opaque_background) == ("none", False)
    figures, reported = made.manifest.figures, json.loads(made.file("field.json").read_text())
    assert reported["color"]["features"]["rank"] == figures["color_rank"] == 24
    assert reported["density"]["rank"] == figures["density_rank"] == 8
    assert figures["resolution"] == 72 and max(reported["density"]["size"]) == 72
    assert figures["training_psnr"] == figures["curve"][-1]["psnr"] and figures["held_out_psnr"] is None
    assert figures["ended_at"] is None and not any("not reached" in line for line in said.lines)
    assert settings(SPACES["box"], capacity="fixed:72x8x24").levels[0].color_rank == 16  # as ever, without a network


def test_what_cannot_be_reached_is_reported(tmp_path):
    work, said = WorkFolder(tmp_path / "work"), Said()
    config = FitConfig(budget="1", capacity="fixed:136x8x8", samples=1000, held_out=0)
    scene = make_capture(work)
    made, _ = execute(nerf_fit.SPEC, nerf_fit.run, work, "fit", {"scene": scene}, config, Context(progress=said))
    assert "--capacity fixed:136x8x8 was not reached: 1 steps were too few" in said.lines
    assert made.manifest.figures["resolution"] == 128 and "not reached" in made.manifest.figures["decisions"][-1]


OF_OBJECTS = {"opacity_weight": 0.01, "coverage_weight": 0.2, "visual_hull": 0.1}


@pytest.mark.parametrize(
    ("layout", "space", "cut_out", "idle"),
    [
        ("object", "box", True, ""),
        ("object", "box", False, "--coverage-weight, --visual-hull"),
        ("object", "contraction", True, "--visual-hull"),
        ("unbounded", "contraction", True, "--opacity-weight, --coverage-weight, --visual-hull"),
        ("forward", "box", True, "--opacity-weight, --coverage-weight"),
    ],
)
def test_object_options_without_effect_are_reported_if_they_were_set(layout, space, cut_out, idle):
    said = Said()
    report_ineffective_options(FitConfig(), layout, space, cut_out, Context(progress=said))
    assert said.lines == []
    report_ineffective_options(FitConfig(**OF_OBJECTS), layout, space, cut_out, Context(progress=said))
    assert len(said.lines) == bool(idle)
    assert not idle or said.lines[0].startswith(
        f"no effect: {idle} (only for objects cut out by transparency); here layout"
    )


def test_object_options_are_reported_and_change_nothing_on_a_capture(tmp_path):
    """What is reported to have no effect has none: the field is the same to the bit."""
    work, digests = WorkFolder(tmp_path / "work"), []
    scene = make_capture(work, layout="unbounded", background="none")
    plain = FitConfig(budget="3", capacity="fixed:64x8x8", samples=1000, held_out=0)
    for config, reported in ((plain, 0), (replace(plain, **OF_OBJECTS), 1)):
        said = Said()
        made, _ = execute(nerf_fit.SPEC, nerf_fit.run, work, "fit", {"scene": scene}, config, Context(progress=said))
        assert sum("no effect" in line for line in said.lines) == reported
        digests.append({one.path: one.sha256 for one in made.manifest.files})
    assert digests[0] == digests[1] and digests[0]


def test_a_bound_below_what_a_fit_takes_is_reported():
    """vm of 256^3, ranks 8 and 24: 3 * 32 * (256^2 + 256) parameters and a few of a head, 94 bytes each."""
    even = SpaceWarp.box([-1] * 3, [1] * 3)
    for memory, reported in ((950_000_000, True), (1_000_000_000, False)):
        said = Said()
        report_memory(settings(even), even, Context(progress=said, memory=memory))
        assert len(said.lines) == reported
    said = Said()
    report_memory(settings(even), even, Context(progress=said, memory=800_000_000))
    assert "--memory 800 MB is less than fitting a field of 256^3 needs, about 964 MB" in said.lines[0]
    small = settings(even, capacity="fixed:64x8x8")
    report_memory(small, even, Context(progress=said, memory=10**9))
    assert len(said.lines) == 1


def test_a_time_budget_says_what_comes_on_top_of_it():
    cameras = [SimpleNamespace(width=20, height=10)] * 6
    fitter = SimpleNamespace(
        settings=SimpleNamespace(seconds=60.0), check_seconds=0.2, held_out_rays=SimpleNamespace(rays=(range(400),)),
        checks=2,
        state=SimpleNamespace(seconds=5.0),
        dataset=SimpleNamespace(cameras=cameras),
    )  # fmt: skip
    assert "60 s of training, plus loading" in nerf_fit.time_beside_training(FitConfig(), fitter)
    assert "PNG" not in nerf_fit.time_beside_training(FitConfig(buffers=False), fitter)
    # 25 checks of 0.2 s; 1200 pixels where 400 take 0.2 s; of 8.4 s, 5 s are training and 0.4 s checks.
    assert nerf_fit.estimated_total(FitConfig(), fitter, 8.4) == (
        "about 69 s or more in total: 60 s of training, 3 s of loading, 5 s of checks, 1 s of rendering 6 views"
    )
    assert nerf_fit.estimated_total(FitConfig(buffers=False), fitter, 5.4).startswith("about 65 s or more in total")
