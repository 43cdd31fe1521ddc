"""Stylizing after a view that is given stylized: what it says of itself and of other views; painting one; going on."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.rendering.ray_registration import points_of
from stylerf.rendering.view import render_view
from stylerf.style.style_loss import StyleWeights
from stylerf.training.stylize.refnpr import LATE_WEIGHT, RefNpr
from stylerf.training.stylize.scene import StyledScene
from stylerf.training.stylize.settings import RefNprSettings
from stylerf.training.stylize.trainer import StylizationTrainer
from tests.stylerf.blends import MILD
from tests.stylerf.small import displacement_grid
from tests.stylerf.style.small_trunk import small_trunk
from tests.stylerf.training.running import Stopped, assert_same_bits, result_of, resumed
from tests.stylerf.training.stylizing import (
    GRAY,
    HEIGHT,
    VIEWS,
    WIDTH,
    new_color,
    problem,
    settings,
    stopping,
    trainer,
)

ONLY_COLORS = StyleWeights(0, 0, 0, 0)


def referenced(references: dict | None = None, region=None, apart: float = 0.2, **given) -> StylizationTrainer:
    """A solid cube, seen from three nearby places; view 1 is the reference. region: a part alone."""
    options = {"match": "none", "reference_steps": 6, "reference_scale": 1.0, "strategy": "deferred", **given}
    made = problem(settings(RefNprSettings, **options), apart=apart, raw=6.0, region=region)
    extractors = small_trunk(), small_trunk("conv2_2", 3)
    return trainer(lambda scene: RefNpr(scene, small_trunk(), references or {1: None}, *extractors), made)


def upper_half(cells: int = 8) -> np.ndarray:
    within = np.zeros((cells,) * 3, bool)
    within[..., cells // 2 :] = True
    return within


def waves(points: np.ndarray) -> np.ndarray:
    """A color for every place in the world."""
    turned = points @ np.array([[0.5, 2.0, 1.0], [2.0, -1.0, 1.5], [1.0, 1.5, -2.0]])
    return (0.5 + 0.4 * np.sin(turned)).astype(np.float32)


def true_colors(one: StylizationTrainer, view: int) -> tuple[np.ndarray, np.ndarray]:
    """The picture [h, w, 3] of a view of a world of these waves, and where it sees the world."""
    seen = points_of(one.scene.fixed.surface(view), one.scene.cameras[view], one.scene.field.space)
    picture = np.where(seen.there[:, None], waves(seen.points), GRAY).astype(np.float32)
    return picture.reshape(HEIGHT, WIDTH, 3), seen.there


def rendered(one: StylizationTrainer, view: int) -> np.ndarray:
    alpha = one.scene.geometry.alpha(view).reshape(-1, 1)
    return one.scene.render(view) + (1 - alpha) * GRAY


def test_the_reference_is_learned_and_other_views_carry_its_colors():
    """The colors of the other views come from the world's own formula: the method has never seen it."""
    picture, there = true_colors(referenced(), 1)
    one = referenced({1: picture}, steps=150, refit_steps=1, reference_feature_weights=ONLY_COLORS, rate=0.05, late=0.0)
    before = {view: rendered(one, view) for view in range(VIEWS)}
    one.run()
    apart = [np.abs(image - picture.reshape(-1, 3))[there].mean() for image in (before[1], rendered(one, 1))]
    assert apart[1] < 0.25 * apart[0]
    for view in (0, 2):
        wanted, there = true_colors(one, view)
        pixels, colors = one.method._registered[view]
        assert len(pixels) > 0.5 * there.sum()
        # A pixel is a twentieth of the cube wide: colors between two of the reference's pixels.
        assert np.abs(colors - wanted.reshape(-1, 3)[pixels]).mean() < 0.04
        apart = [np.abs(image - wanted.reshape(-1, 3))[pixels].mean() for image in (before[view], rendered(one, view))]
        assert apart[1] < 0.4 * apart[0]
    assert 0.5 < one.method.registered_share <= 1


def test_only_rays_that_see_the_references_surface_are_taught_by_it():
    """A view from the other side has none."""
    picture, _ = true_colors(referenced(), 1)
    one = referenced({1: picture})
    behind = replace(one.scene.cameras[1], world_from_camera=one.scene.cameras[1].world_from_camera.copy())
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])  # half a turn about the cube's upright axis
    behind.world_from_camera[:] = turn @ one.scene.cameras[1].world_from_camera
    one.scene.cameras[2] = behind
    one.scene.fixed._surfaces.kept.clear()
    assert len(one.method._registered[0][0]) > 50 and len(one.method._registered[2][0]) == 0


def test_of_two_references_the_straighter_look_tells():
    pictures = {0: np.zeros((HEIGHT, WIDTH, 3), np.float32), 2: np.ones((HEIGHT, WIDTH, 3), np.float32)}
    one = referenced(pictures)
    turn = one.scene.cameras[0]
    one.scene.cameras[1] = replace(one.scene.cameras[1], world_from_camera=turn.world_from_camera.copy())
    one.scene.fixed._surfaces.kept.clear()
    pixels, colors = one.method._registered[1]
    alpha = one.scene.fixed.alpha(0).ravel()[pixels]
    assert len(pixels) > 50 and np.abs(colors - (1 - alpha[:, None]) * GRAY).max() < 1e-5  # all of view 0's black


def test_a_reference_is_painted_before_the_scene_is():
    one, phases = referenced(steps=20), []
    one.run(lambda now: phases.append((now.state.phase, now.scene.budget.steps)))
    assert phases == [("refit", 8)] * 8 + [("reference", 6)] * 6 + [("style", 14)] * 14
    losses = [
        one.method.making_loss(1)(one.method.loss.to_device(p))[0]
        for p in (one.scene.photos[1], one.method.references[1])
    ]
    assert float(losses[1]) < float(losses[0])
    assert (
        np.abs(one.method.references[1] * 255 - np.rint(one.method.references[1] * 255)).max() < 1e-4
    )  # as a file would keep it


def test_painting_counts_towards_a_budget_and_takes_a_third_at_most():
    one, phases = referenced(steps=9), []
    one.run(lambda now: phases.append(now.state.phase))
    assert phases == ["refit"] * 8 + ["reference"] * 3 + ["style"] * 6
    one = referenced(steps=0)
    one.scene.settings = replace(one.settings, seconds=900.0)
    one.state.phase, one.state.step, one.state.seconds = "reference", 3, 0.0
    assert one.scene.budget.progress == pytest.approx(0.5)
    one.state.seconds = 300.0
    assert one.scene.budget.progress == 1.0
    one.next_phase()
    assert (one.state.phase, one.state.step, one.state.seconds) == (
        "style",
        0,
        300.0,
    ) and one.scene.budget.progress == 0
    one.state.seconds = 750.0
    assert one.scene.budget.progress == pytest.approx(0.75)  # of the 600 that are left: the last quarter begins
    # No step of it was made: it is the photo, as a checkpoint has it.
    assert np.array_equal(one.method.references[1], np.rint(one.scene.photos[1] * 255).astype(np.float32) / 255)


@pytest.mark.parametrize("making", [900.0, 1200.0])
def test_references_that_use_up_the_budget_leave_one_step_of_style(making):
    one = referenced(steps=0)
    one.scene.settings = replace(one.settings, seconds=900.0)
    one.state.phase, one.state.seconds = "reference", making
    one.next_phase()
    assert one.state.phase == "style" and one.scene.budget.progress == 0
    one.state.seconds += 0.5
    assert one.scene.budget.progress == 1.0


@pytest.mark.parametrize("most", [16, 50_000])
def test_a_step_learns_as_many_registered_pixels_as_of_the_reference_and_no_more_than_there_are(most):
    picture, _ = true_colors(referenced(), 1)
    one, learned = referenced({1: picture}, refit_steps=1, reference_pixels=most), []
    learn = one.scene.learn_pixels
    one.scene.learn_pixels = lambda view, *given: learned.append((view, len(given[0]))) or learn(view, *given)
    one.method.style_step()
    assert [view == 1 for view, _ in learned] == [True, False]
    counts = [count for _, count in learned]
    assert counts == [16, 16] if most == 16 else all(100 < count <= HEIGHT * WIDTH for count in counts)


def test_the_last_quarter_matches_renders_with_the_references_render():
    picture, _ = true_colors(referenced(), 1)
    one, parts = referenced({1: picture}, steps=12, refit_steps=1), []
    step = one.method.style_step
    one.method.style_step = lambda: parts.append(step()) or parts[-1]
    one.run()
    assert ["content" in found for found in parts] == [True] * 9 + [False] * 3
    assert sorted(one.method._late_renders) == [1] and LATE_WEIGHT == 0.2
    # The template's own view, as it was then, finds itself; another look finds something else.
    one.state.phase, one.state.step = "style", 11
    objective, matches, seen = one.method.objective, one.method.objective.matches_of, []
    objective.matches_of = lambda *given: seen.append(matches(*given)) or seen[-1]
    one.method.loss_of_view(1)(one.method.loss.to_device(one.method._late_renders[1]))
    for block, found in seen[0].items():
        keys = one.method.late_keys[block].rows
        alive = keys.norm(dim=1) > 0.5
        cosines = (keys[found.long()] * keys).sum(1)[alive]
        assert float(cosines.min()) > 1 - 1e-5 and alive.sum() > 20, block  # a flat place has many that are as like
    one.method.loss_of_view(1)(one.method.loss.to_device(one.scene.photos[1]))
    assert any(not torch.equal(found, seen[1][block]) for block, found in seen[0].items())
    weights = one.settings.reference_feature_weights
    one.scene.settings = replace(
        one.settings, reference_feature_weights=replace(weights, style=3 * weights.style, variation=0.0)
    )
    tripled, parts = one.method.loss_of_view(1)(one.method.loss.to_device(one.method._late_renders[1]))
    assert float(tripled) == pytest.approx(LATE_WEIGHT * 3 * weights.style * parts["style"], rel=1e-5)


@pytest.mark.parametrize("region", [None, upper_half()], ids=["all of it", "a part"])
def test_a_stopped_one_goes_on_to_the_same_bits(region):
    whole = referenced(steps=12, match="before", region=region)
    whole.run()
    expected, arrays = result_of(whole)
    at, on_step = referenced(steps=12, match="before", region=region), stopping([3, 8, 10, 12, 15, 18, 19])
    for _ in range(7):  # refit, its end, painting, its end, style, at the last quarter's begin, within it
        with pytest.raises(Stopped):
            at.run(on_step)
        at = resumed(referenced(steps=12, match="before", region=region), at)
    at.run(on_step)
    state, found = result_of(at)
    assert state == expected and state["phase"] == "done"
    assert_same_bits(found, arrays)
    names = {name.split(".")[0] for name in arrays}
    assert {"reference", "late"} <= names and "painted" not in names


def test_of_a_part_what_lies_beside_it_keeps_its_colors_to_the_bit():
    black = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    one = referenced({1: black}, upper_half(), steps=60, refit_steps=1, reference_feature_weights=ONLY_COLORS, late=0.0)
    fitted = replace(one.scene.field, color=one.scene.field.color.base)
    before = [one.scene.render(view) for view in range(VIEWS)]
    one.run()
    assert one.scene.field.color.base is fitted.color and one.scene.field.weight_threshold == fitted.weight_threshold
    for view in range(VIEWS):
        part, after = one.scene.coverage(view).ravel(), one.scene.render(view)
        assert np.array_equal(after[part == 0], before[view][part == 0])
        inside = part > 0.9
        assert inside.sum() > 20 and (part == 0).sum() > 40
        assert after[inside].mean() < 0.5 * before[view][inside].mean()
        old, new = (render_view(field, one.scene.cameras[view], threads=1) for field in (fitted, one.scene.field))
        assert np.array_equal(new.rgb[part.reshape(HEIGHT, WIDTH) == 0], old.rgb[part.reshape(HEIGHT, WIDTH) == 0])
    part, requested = one.scene.coverage(1), one.method.references[1]
    assert (
        np.array_equal(requested[part == 0], one.scene.photos[1][part == 0])
        and np.abs(requested[part > 0.999]).max() < 0.01
    )
    assert 0.5 < one.method.registered_share <= 1


def test_a_part_of_a_field_with_a_color_map_is_seen_and_learned_through_it():
    """Beside the part the field keeps its colors; the gradient is that of the mapped colors."""
    given = problem(settings(RefNprSettings, match="none"), apart=0.2, raw=6.0, region=upper_half())
    given.field.color_map = MILD
    scene, random = StyledScene(given, new_color), np.random.default_rng(0)
    before, after = (render_view(one, scene.cameras[1], threads=1).rgb for one in (given.field, scene.field))
    np.testing.assert_array_equal(after, before)
    # Surfaces keep positions in sixteen bits, and leave out what weighs little.
    np.testing.assert_allclose(scene.render(1).reshape(before.shape), before, atol=0.05)
    values, pixels = scene.field.color.values, np.flatnonzero(scene.coverage(1).ravel() > 0.5)
    towards, way = random.normal(size=(len(pixels), 3)), random.normal(size=len(values)).astype(np.float32)
    to = np.zeros((1, len(values)), np.float32)
    scene.geometry.learn(scene.geometry.paint(1, pixels)[1], towards.astype(np.float32), to)
    change, at_rest = [], values.copy()
    for step in (0.01, -0.01):
        values[:] = at_rest + np.float32(step) * way
        change.append(float((scene.geometry.paint(1, pixels)[0] * towards).sum()))
    assert float(to[0] @ way) == pytest.approx((change[0] - change[1]) / 0.02, rel=1e-2)


def test_a_reference_that_is_painted_of_a_part_is_the_photo_beside_it():
    photo = referenced().scene.photos[1]
    for match in ("none", "before"):
        one = referenced(region=upper_half(), match=match, steps=20)
        one.run()
        part, apart = one.scene.coverage(1), np.abs(one.method.references[1] - photo).max(2)
        assert apart[part == 0].max() < 1 / 255 and apart[part > 0.9].mean() > 0.02, match


def test_views_without_the_part_neither_learn_nor_are_references():
    front = np.zeros((8, 8, 8), bool)
    front[7, 3:5, 3:5] = True  # of the face that the first view looks at
    one = referenced({0: np.zeros((HEIGHT, WIDTH, 3), np.float32)}, front, apart=1.6)
    assert 0 in one.scene.shown and 2 not in one.scene.shown
    views = set()
    for step in range(9):
        one.state.step = step
        views.add(one.method.view_step.view_of_step())
    assert views == set(one.scene.shown)
    with pytest.raises(InvalidValue, match="view s2, a reference, shows nothing of the region"):
        referenced({2: np.zeros((HEIGHT, WIDTH, 3), np.float32)}, front, apart=1.6)
    hidden = np.zeros((8, 8, 8), bool)
    hidden[3:5, 3:5, 3:5] = True
    with pytest.raises(InvalidValue, match="no training view shows any part of the region"):
        referenced(region=hidden)


def test_a_view_that_misses_the_object_is_no_reference():
    given = problem(settings(RefNprSettings))
    away = given.cameras[1].world_from_camera.copy()
    away[:3, 1:3] *= -1  # looks the other way
    given.cameras[1] = replace(given.cameras[1], world_from_camera=away)
    for image in (None, np.zeros((HEIGHT, WIDTH, 3), np.float32)):
        with pytest.raises(InvalidValue, match="view s1, a reference, shows nothing of the object"):
            RefNpr(StyledScene(given, new_color), small_trunk(), {0: None, 1: image}, small_trunk(), small_trunk())


def test_rays_are_not_registered_through_a_deformation():
    given = problem(settings(RefNprSettings))
    given.field.displacement = displacement_grid(0)
    with pytest.raises(InvalidValue, match="deformation"):
        RefNpr(StyledScene(given, new_color), small_trunk(), {}, small_trunk(), small_trunk())


def test_a_reference_that_is_painted_here_ends_with_the_paintings_colors():
    """Their mean and covariance where all is covered; as published, with --match none, what features leave of them."""

    def colors(match: str) -> np.ndarray:
        one = referenced(match=match, steps=40, refit_steps=1)
        one.run()
        covered = one.scene.fixed.alpha(1) > 0.5
        picture = one.method.references[1] - (1 - one.scene.fixed.alpha(1)[..., None]) * GRAY
        return (picture / np.maximum(one.scene.fixed.alpha(1)[..., None], 1e-3))[covered]

    palette = np.cov(referenced().scene.problem.style_image.flatten(1).numpy())
    apart = {m: np.abs(np.cov(colors(m).T) - palette).max() / palette.max() for m in ("before", "none")}
    assert apart["before"] < 0.05 < apart["none"]


def test_so_does_one_in_the_midst_of_which_the_time_ends():
    one = referenced(match="before", reference_steps=30, refit_steps=1)
    one.state.phase = "reference"
    for _ in range(3):
        one.method.reference_step()
        one.state.step += 1
    before = one.method.references[1].copy()
    one.next_phase()
    assert one.state.phase == "style" and np.abs(one.method.references[1] - before).max() > 0.01
