"""Stylizing a tiny scene: what a step teaches, against the float64 oracle; resuming; what stops it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.errors import Diverged, InvalidValue
from stylerf.fields.deformation import Deformation
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.style import style_loss
from stylerf.style.style_loss import StyleObjective, StyleWeights
from stylerf.training.common.even_draws import drawn_evenly
from stylerf.training.stylize import arf as module
from stylerf.training.stylize import geometry
from stylerf.training.stylize.arf import Arf
from stylerf.training.stylize.scene import CPU, MEMORY, StyleBackend
from stylerf.training.stylize.settings import ArfSettings, DesrfSettings
from stylerf.training.stylize.silhouettes import mirror_pixels, object_colors, over
from stylerf.training.stylize.trainer import StylizationTrainer
from tests.stylerf.small import float64, oracle_color
from tests.stylerf.style.small_trunk import picture, small_trunk
from tests.stylerf.training.running import Stopped, assert_same_bits, result_of, resumed, run_until
from tests.stylerf.training.stylizing import BOX, GRAY, HEIGHT, WIDTH, arf, problem, settings, trainer


def stylizer(
    threads: int = 1, seed: int = 0, space: SpaceWarp = BOX, deform: bool = False, memory: float = MEMORY,
    backend: StyleBackend = CPU, to: str = "cpu", **given
) -> StylizationTrainer:  # fmt: skip
    """ARF, or with `deform` DeSRF, on a tiny scene. to: device of the extractor."""
    kind, more = ArfSettings, {"threads": threads, "memory": memory, "backend": backend}
    if deform:
        kind, given = DesrfSettings, {"displacement_vertices": 8, **given}
        more["deformation"] = Deformation.create(np.random.default_rng(0), frequencies=2, width=16)
    made = problem(settings(kind, **given), seed, space=space, **more)
    return trainer(lambda scene: Arf(scene, small_trunk().to(to)), made)


def style_gradient(made: StylizationTrainer) -> np.ndarray:
    """dL/d(color values) of one style step, before the optimizer takes it."""
    found = []
    made.scene.adam.step = lambda rate: found.append(made.scene.adam.gradients.sum(0, dtype=np.float64))
    made.method.step()
    return found[0]


@pytest.mark.parametrize("slow", [{"detail_rate": 0.1}, {"broad": 1.0}])
def test_style_steps_learn_some_levels_slowly_and_the_refit_the_finest(slow):
    made = stylizer(**slow)
    cells = made.scene.field.color.grid.cells
    slowest = slow.get("detail_rate", cells[0] / cells[-1])
    rates = []
    made.run(lambda run: rates.append((run.state.phase, {factor for _, _, factor in run.scene.adam.groups})))
    found = {phase: factors for phase, factors in rates}
    assert min(found["refit"]) == pytest.approx(0.2) and max(found["refit"]) == 1
    assert min(found["style"]) == pytest.approx(slowest) and max(found["style"]) == 1


def test_colors_narrower_than_features_see_stay_as_the_refit_left_them():
    made = stylizer(narrow=2.0)
    grid, pixel_cells = made.scene.field.color.grid, made.scene.pixel_cells()
    sharp = int(grid.firsts[sum(2.0 * cells <= pixel_cells for cells in grid.cells)])
    after_refit = []

    def look(run: StylizationTrainer) -> None:
        if run.state.phase == "refit" or not after_refit:
            after_refit[:] = [run.scene.field.color.values.copy()]

    made.run(look)
    values, refitted = made.scene.field.color.values, after_refit[0]
    assert 0 < sharp < len(values)
    np.testing.assert_array_equal(values[sharp:], refitted[sharp:])
    assert np.abs(values[:sharp] - refitted[:sharp]).max() > 0


# -- what a step teaches --------------------------------------------------------------------------------------------


def oracle_picture(made: StylizationTrainer, view: int, values: torch.Tensor, pixels: np.ndarray) -> torch.Tensor:
    """Premultiplied rgb [n, 3] of pixels in float64, from the packed surface."""
    starts, ends, x, weights = made.scene.geometry.surface(view).samples(pixels)
    rays = torch.from_numpy(np.repeat(np.arange(len(pixels)), ends - starts))
    colors = oracle_color(made.scene.field.color, values, None, float64(x))
    return torch.zeros(len(pixels), 3, dtype=torch.float64).index_add(0, rays, float64(weights)[:, None] * colors)


def oracle_loss(made: StylizationTrainer, view: int, premultiplied: torch.Tensor) -> torch.Tensor:
    """The style objective of a view's picture over the background, in float64 from end to end."""
    s = made.settings
    objective = StyleObjective(
        small_trunk().double(),
        made.scene.problem.style_image.double(),
        (HEIGHT, WIDTH),
        s.weights,
        s.feature_scale,
        s.style_rows,
        0,
    )
    alpha = float64(made.scene.geometry.alpha(view))
    mirror = torch.from_numpy(mirror_pixels(alpha.numpy()))

    def without_background(picture: torch.Tensor) -> torch.Tensor:
        return over(picture, alpha, GRAY, object_colors(picture, alpha, mirror, GRAY))

    content = objective.content_of(without_background(float64(made.scene.photos[view]).permute(2, 0, 1)))
    rgb = premultiplied.reshape(HEIGHT, WIDTH, 3) + (1 - alpha[..., None]) * GRAY
    return objective(without_background(rgb.permute(2, 0, 1)), content, alpha)[0]


def oracle_gradients(made: StylizationTrainer, view: int, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """dL/d(values) through one graph, and deferred: by the picture's own gradient, handed back in parts."""
    everything = np.arange(HEIGHT * WIDTH)
    values = float64(made.scene.field.color.values).requires_grad_()
    whole = oracle_picture(made, view, values, everything)
    (full,) = torch.autograd.grad(oracle_loss(made, view, whole), values)
    cached = whole.detach().requires_grad_()
    (gradient,) = torch.autograd.grad(oracle_loss(made, view, cached), cached)
    deferred = torch.zeros_like(full)
    for part in np.array_split(everything, parts):
        again = oracle_picture(made, view, values, part)
        deferred += torch.autograd.grad((again * gradient[part]).sum(), values)[0]
    return full.numpy(), deferred.numpy()


def apart(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def test_deferred_is_full_in_float64():
    made = stylizer()
    full, deferred = oracle_gradients(made, 1, 5)
    assert np.abs(full).max() > 0 and apart(deferred, full) < 1e-12


@pytest.mark.parametrize("threads", [1, 2])
def test_full_and_deferred_steps_equal_each_other_and_the_oracle(monkeypatch, threads):
    full = style_gradient(stylizer(threads, strategy="full", match="none"))
    monkeypatch.setattr(module, "PIXELS_AT_ONCE", 37)  # 252 pixels in seven parts
    made = stylizer(threads, strategy="deferred", match="none")
    view = made.method.view_step.view_of_step()
    deferred = style_gradient(made)
    # Only the order of float32 sums differs.
    assert apart(deferred, full) < 1e-6
    expected, _ = oracle_gradients(made, view, 1)
    # Features of two blocks in float32, squared and divided by their lengths: some tens of roundings.
    assert apart(full, expected) < 5e-5


@pytest.mark.parametrize("strategy", ["dilated", "random", "patch"])
def test_chosen_rays_learn_their_share_of_the_whole_pictures_gradient(strategy):
    made = stylizer(strategy=strategy, match="none", blur=0, dilation=3)
    view, generator = made.method.view_step.view_of_step(), np.random.default_rng([0, 4, 0])
    pixels = module.selected_pixels(strategy, HEIGHT, WIDTH, 3, generator)
    values = float64(made.scene.field.color.values).requires_grad_()
    cached = oracle_picture(made, view, values, np.arange(HEIGHT * WIDTH)).detach().requires_grad_()
    (gradient,) = torch.autograd.grad(oracle_loss(made, view, cached), cached)
    chosen = gradient[pixels] * (HEIGHT * WIDTH / len(pixels))
    (oracle_picture(made, view, values, pixels) * chosen).sum().backward()
    assert apart(style_gradient(made), values.grad.numpy()) < 5e-5


@pytest.mark.parametrize("strategy", ["random", "patch"])
def test_what_is_remembered_stands_in_for_pixels_that_are_not_rendered(strategy):
    """The second visit of a view renders the chosen pixels only; the others are as they were at the first."""
    kept, fresh = (stylizer(strategy=strategy, match="none", remember=r, dilation=3) for r in (True, False))
    pixels = np.arange(0, HEIGHT * WIDTH, 9)
    before = kept.scene.render(0)
    for made in (kept, fresh):
        made.method.view_step.image(0, pixels)
        made.scene.field.color.values += 0.3
    now_ = kept.scene.render(0)
    old, new = kept.method.view_step.image(0, pixels + 1)[0], fresh.method.view_step.image(0, pixels + 1)[0]
    assert np.array_equal(new, now_) and np.array_equal(old[pixels + 1], now_[pixels + 1])
    rest = np.setdiff1d(np.arange(HEIGHT * WIDTH), pixels + 1)
    assert np.array_equal(old[rest], before[rest]) and np.abs(old[rest] - now_[rest]).max() > 0.05


def test_what_is_remembered_follows_what_dilated_rays_have_learned():
    made = stylizer(strategy="dilated", match="none", dilation=2)
    before = made.scene.render(0)
    made.method.view_step.image(0, module.selected_pixels("dilated", HEIGHT, WIDTH, 2, np.random.default_rng(0)))
    made.scene.field.color.values += 0.3
    now_, chosen = made.scene.render(0), module.selected_pixels("dilated", HEIGHT, WIDTH, 2, np.random.default_rng(1))
    seen = made.method.view_step.image(0, chosen)[0]
    assert np.array_equal(seen[chosen], now_[chosen])
    assert np.abs(seen - now_).mean() < 0.2 * np.abs(before - now_).mean()


def test_a_refit_step_teaches_the_mean_squared_error_of_its_pixels():
    made, found = stylizer(match="none", threads=2), []
    made.scene.adam.step = lambda rate: found.append(made.scene.adam.gradients.sum(0, dtype=np.float64))
    generator = np.random.default_rng([0, 2, 0])
    view = int(generator.integers(3))
    alpha = made.scene.geometry.alpha(view).ravel()
    lit = np.flatnonzero(alpha > 1e-3)
    pixels = lit[drawn_evenly(128, len(lit), generator)]
    loss = made.scene.refit_step()["mse"]
    values = float64(made.scene.field.color.values).requires_grad_()
    rgb = oracle_picture(made, view, values, pixels) + (1 - float64(alpha[pixels])[:, None]) * GRAY
    expected = (rgb - float64(made.scene.photos[view].reshape(-1, 3)[pixels])).square().mean()
    expected.backward()
    assert loss == pytest.approx(float(expected.detach()), rel=1e-5) and apart(found[0], values.grad.numpy()) < 1e-5


# -- the loop -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("deform", [False, True])
@pytest.mark.parametrize(("strategy", "loss"), [("deferred", "nnfm"), ("dilated", "nnfm"), ("deferred", "transport")])
def test_a_stylization_that_was_stopped_goes_on_to_the_same_bits(strategy, loss, deform, monkeypatch):
    monkeypatch.setattr(style_loss, "POSITIONS", 40)  # transport draws new ones in each step
    given = {"strategy": strategy, "loss": loss, "deform": deform, "detail_rate": 0.1}
    whole = stylizer(**given)
    whole.run()
    expected, arrays = result_of(whole)
    at = stylizer(**given)
    seen = []

    def stop_after(count: int):
        def on_step(made: StylizationTrainer) -> None:
            seen.append(made.state.phase)
            if len(seen) == count:
                raise Stopped

        return on_step

    for count in (3, 8, 9, 15):  # within the refit, at its last step, at the first of style, within it
        with pytest.raises(Stopped):
            at.run(stop_after(count))
        at = resumed(stylizer(**given), at)
    at.run()
    state, found = result_of(at)
    assert seen.count("style") == 7 and state == expected and state["phase"] == "done"
    assert_same_bits(found, arrays)
    assert torch.equal(at.scene.field.color_map.matrix, whole.scene.field.color_map.matrix)
    assert any(name.startswith("seen.") for name in arrays) == (strategy == "dilated")


def test_learning_lowers_the_loss_and_leaves_the_density_alone():
    made, losses = stylizer(steps=30, strategy="deferred", match="none", weights=StyleWeights(1, 0, 0, 0)), []
    before = made.scene.field.density.values.copy()
    step = made.method.step
    made.method.step = lambda: losses.append(step()) or losses[-1]
    made.run()
    style = [parts["style"] for parts in losses]
    assert np.mean(style[-3:]) < 0.9 * np.mean(style[:3])
    assert np.array_equal(made.scene.field.density.values, before)
    assert made.scene.field.color_map is None and len(made.state.curve) == 3


def test_every_view_is_visited_once_an_epoch():
    made, visits = stylizer(), []
    for made.state.step in range(12):
        visits.append(made.method.view_step.view_of_step())
    assert (
        all(sorted(visits[at : at + 3]) == [0, 1, 2] for at in (0, 3, 6, 9))
        and len(set(map(tuple, zip(*[iter(visits)] * 3)))) > 1
    )


def test_with_a_deformation_shapes_move_and_a_weight_holds_them():
    """The silhouettes change, the density does not: it is asked elsewhere."""
    moved = {}
    for weight in (0.0, 1e3):
        made = stylizer(steps=30, deform=True, match="none", deform_rate=1e-2, displacement_weight=weight)
        before, rest = made.scene.field.density.values.copy(), [made.scene.geometry.alpha(v).copy() for v in range(3)]
        made.run()
        assert np.array_equal(made.scene.field.density.values, before)
        for view in range(3):
            made.scene.render(view)
        apart_ = np.mean([np.abs(made.scene.geometry.alpha(v) - rest[v]).mean() for v in range(3)])
        moved[weight] = apart_, np.abs(made.scene.field.displacement).max()
    assert moved[0.0][0] > 1.1 * moved[1e3][0] and moved[0.0][1] > 5 * moved[1e3][1] > 0


def test_a_deforming_step_gives_the_finite_difference_as_gradient(monkeypatch):
    """dL/dD of a whole style step, along a random direction, background behind the silhouette included."""
    monkeypatch.setattr(geometry, "OPAQUE", 0.0)  # a ray that ends a sample earlier is a jump, not a slope
    made = stylizer(deform=True, match="none", strategy="deferred", refit_steps=1, weight_threshold=0.0)
    made.scene.field.occupancy = OccupancyGrid(made.scene.field.occupancy.cells)
    made.scene.refit_step()
    made.next_phase()
    view, pixels = made.method.view_step.view_of_step(), np.arange(HEIGHT * WIDTH)
    random = np.random.default_rng(5)
    direction = random.normal(size=made.scene.field.displacement.shape).astype(np.float32)
    for axis in range(3):  # smooth, so that few samples change their cell
        direction = (direction + np.roll(direction, 1, axis) + np.roll(direction, -1, axis)) / 3
    picture_, _ = made.method.view_step.image(view, pixels)
    gradient, _ = made.method.view_step.gradient(view, picture_)
    _, kept = made.scene.geometry.paint(view, pixels)
    made.scene.geometry.learn(kept, gradient.reshape(-1, 3), made.scene.adam.gradients)
    expected = float((made.scene.deformer.gradients.sum(0, dtype=np.float64) * direction.ravel()).sum())

    def linear(step: float) -> float:
        made.scene.field.displacement[:] = step * direction
        rgb = made.scene.render(view).astype(np.float64)
        over = rgb + (1 - made.scene.geometry.alpha(view).reshape(-1, 1)) * GRAY
        return float((over * gradient.reshape(-1, 3)).sum())

    measured = (linear(2e-4) - linear(-2e-4)) / 4e-4
    assert measured == pytest.approx(expected, rel=0.12)  # slopes jump between cells


@pytest.mark.parametrize("match", ["none", "before", "after", "both"])
def test_colors_are_matched_when_requested(match):
    made = stylizer(match=match, steps=3)
    changed = [not np.array_equal(a, b) for a, b in zip(made.scene.photos, stylizer(match="none").scene.photos)]
    assert all(changed) == (match in ("before", "both"))
    made.run()
    assert (made.scene.field.color_map is not None) == (match in ("after", "both"))


def test_to_keep_colors_the_style_image_takes_the_photos_brightness():
    made, plain = stylizer(match="after", keep_colors=True, steps=3), stylizer(match="none")
    assert all(np.array_equal(one, other) for one, other in zip(made.scene.photos, plain.scene.photos, strict=True))
    before, given = plain.scene.style_image.flatten(1), made.scene.style_image.flatten(1)
    assert float((given - before).abs().mean()) > 0.01 and float((given - given[:1]).abs().max()) < 1e-4
    covered = np.concatenate([made.scene.fixed.alpha(view).ravel() for view in range(len(made.scene.cameras))])
    photos = np.concatenate([photo.reshape(-1, 3) for photo in made.scene.photos])
    straight = np.clip((photos - (1 - covered[:, None]) * GRAY) / np.maximum(covered[:, None], 1e-3), 0, 1)
    wanted = np.average(straight, axis=0, weights=covered)
    assert abs(float(given.mean()) - wanted.mean()) < 0.01 < abs(float(before.mean()) - wanted.mean())
    made.run()
    assert made.method.loss.objective is not None and made.scene.field.color_map is not None


def test_nan_in_a_photo_or_in_the_painting_is_a_divergence():
    made = stylizer(match="none")
    made.scene.photos = [np.full_like(p, np.nan) for p in made.scene.photos]
    with pytest.raises(Diverged, match="refit step 0"):
        made.run()
    made = stylizer(match="none")
    run_until(made, 5)
    made.scene.style_image = torch.full_like(made.scene.style_image, np.nan)
    with pytest.raises(Diverged, match="style step 0"):
        made.run()


def test_a_view_that_sees_nothing_is_passed_over():
    made = stylizer(match="none", refit_steps=4)
    away = look_at(np.array([3.0, 0, 0]), np.array([9.0, 0, 0]), np.array([0, 0, 1.0]))
    made.scene.cameras[:] = [Camera("away", WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, away)] * 3
    made.scene.geometry = geometry.FixedGeometry(made.scene.field, made.scene.cameras, 0.1, 1)
    before = made.scene.field.color.values.copy()
    assert made.scene.refit_step()["mse"] == 0 and np.array_equal(made.scene.field.color.values, before)
    assert all(np.isfinite(v) for v in made.method.step().values())


def test_a_view_is_first_remembered_as_it_looked_at_rest():
    """Shapes have moved since; what was there before them is neither walked again nor moved along."""
    made = stylizer(deform=True, strategy="random", match="none", refit_steps=4)
    made.scene.settings = replace(made.settings, steps=1)
    rest = made.scene.fixed.alpha(2).copy()
    while made.state.phase == "refit":
        made.scene.refit_step()
        made.state.step += 1
        if made.scene.budget.progress >= 1:
            made.next_phase()
    made.scene.field.displacement += 0.1
    made.scene.deformer.look()
    assert np.array_equal(made.scene.geometry.alpha(2), rest)
    everything, chosen = np.arange(HEIGHT * WIDTH), np.arange(0, HEIGHT * WIDTH, 5)
    others = np.setdiff1d(everything, chosen)
    still, (moved, _) = made.scene.fixed.paint(2, everything)[0], made.scene.geometry.paint(2, everything)
    picture = made.method.view_step.image(2, chosen)[0]
    assert np.array_equal(picture[others], still[others]) and np.array_equal(picture[chosen], moved[chosen])
    assert np.abs(moved - still).max() > 0.05 and not np.array_equal(made.scene.geometry.alpha(2), rest)


def test_large_strokes_come_first():
    """The coarse share of the steps takes features at half the size; the photos' are taken again after it."""
    made, scales, contents = stylizer(steps=4, coarse=0.5, match="none"), [], []

    def look(now: StylizationTrainer) -> None:
        if now.state.phase == "style":
            scales.append(now.method.loss.objective.scale)
            contents.append(
                {view: kept.features["conv1"].shape for view, kept in now.method.loss._content.kept.items()}
            )

    made.run(look)
    # Told after a step, the objective is that of the next one.
    assert scales == [0.5, 1.0, 1.0, 1.0]
    assert contents[1] == {} and {shape[1:] for shape in contents[3].values()} == {(HEIGHT, WIDTH)}


def test_deep_layers_are_used_in_the_coarse_steps_only():
    given = problem(settings(ArfSettings, steps=4, coarse=0.5, fine_layers="conv1_2", match="none"), 0, memory=MEMORY)
    made, blocks = trainer(lambda scene: Arf(scene, small_trunk("conv1_2,conv2_1")), given), []

    def look(now: StylizationTrainer) -> None:
        if now.state.phase == "style":
            loss = now.method.loss
            content = {tuple(kept.features) for kept in loss._content.kept.values()}
            blocks.append((tuple(loss.objective.unit), content))

    made.run(look)
    assert [names for names, _ in blocks] == [("conv1", "conv2"), ("conv1",), ("conv1",), ("conv1",)]
    assert blocks[0][1] == {("conv1", "conv2")} and blocks[3][1] == {("conv1",)}


def test_features_are_taken_around_the_object_alone():
    made = stylizer()
    assert all(
        window == (slice(0, HEIGHT), slice(0, WIDTH)) for window in made.method.loss.windows
    )  # no room for a margin here
    made.method.loss.windows = [(slice(2, 12), slice(4, 16))] * 3
    made.run()
    assert all(kept.features["conv1"].shape[1:] == (10, 12) for kept in made.method.loss._content.kept.values())


@pytest.mark.parametrize(("coarse", "height"), [(0.0, 40), (0.5, 80)])
def test_a_style_image_of_which_too_little_is_left_is_refused_before_the_refit(coarse, height):
    """Of views 18 pixels wide; the extractor needs four a side, and sees half of them at first if features are."""
    with pytest.raises(InvalidValue, match="too elongated: 400x"):
        arf({"style_image": picture(height, 400, 9)}, coarse=coarse)
    arf({"style_image": picture(2 * height + 20, 400, 9)}, coarse=coarse)
