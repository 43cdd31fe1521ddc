"""Stylizing a tiny scene: what a step teaches, against the float64 oracle; resuming; what stops it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.errors import Diverged
from stylerf.fields.deformation import Deformation
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.style.style_objective import StyleObjective, StyleWeights
from stylerf.training.stylize import arf as module
from stylerf.training.stylize import geometry
from stylerf.training.stylize.arf import ArfTrainer
from stylerf.training.stylize.settings import StyleSettings
from stylerf.training.stylize.trainer import MEMORY
from tests.stylerf.small import field_of, float64, hash_color, oracle_color, vm_color
from tests.stylerf.style.small_trunk import picture, small_trunk
from tests.stylerf.training.running import Stopped, assert_same_bits, result_of, resumed, run_until

BOX = SpaceWarp.box([-1, -1, -1], [1, 1, 1])
HEIGHT, WIDTH, GRAY = 14, 18, 0.75


def camera(index: int) -> Camera:
    eye = 2.8 * np.array([np.cos(1.3 * index), np.sin(1.3 * index), 0.3])
    pose = look_at(eye, np.zeros(3), np.array([0, 0, 1.0]))
    return Camera(f"s{index}", WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, pose)


def settings(**more) -> StyleSettings:
    small = {"steps": 12, "refit_steps": 8, "refit_pixels": 128, "feature_scale": 1.0, "style_basis": 0, "share": 0.1}
    return StyleSettings(**{**small, "weights": StyleWeights(1.0, 0.02, 0.5), **more})


def stylizer(
    chunks: int = 1, seed: int = 0, space: SpaceWarp = BOX, deform: bool = False, memory: float = MEMORY, **more
) -> ArfTrainer:
    field = field_of(space, 3, vm_color(4))
    field.density.values[-1] = -3.0
    photos = [picture(HEIGHT, WIDTH, 20 + i).permute(1, 2, 0).numpy().copy() for i in range(3)]
    cameras = [camera(i) for i in range(3)]

    def new_color(generator, pixel_cells):
        return hash_color(int(generator.integers(1000)))

    painting = picture(20, 24, 9)
    deformation = Deformation.create(np.random.default_rng(0), frequencies=2, width=16) if deform else None
    given = settings(**more, **({"displacement_vertices": 8} if deform else {}))
    more = (painting, small_trunk(), given, seed, chunks, new_color, deformation, memory)
    return ArfTrainer(field, cameras, photos, GRAY, *more)


def style_gradient(made: ArfTrainer) -> np.ndarray:
    """dL/d(color values) of one style step, before the optimizer takes it."""
    found = []
    made.adam.step = lambda rate: found.append(made.adam.gradients.sum(0, dtype=np.float64))
    made.style_step()
    return found[0]


# -- what a step teaches --------------------------------------------------------------------------------------------


def oracle_picture(made: ArfTrainer, view: int, values: torch.Tensor, pixels: np.ndarray) -> torch.Tensor:
    """Premultiplied rgb [n, 3] of pixels in float64, from the packed surface."""
    starts, ends, x, weights = made.geometry.surface(view).samples(pixels)
    rays = torch.from_numpy(np.repeat(np.arange(len(pixels)), ends - starts))
    colors = oracle_color(made.field.color, values, None, float64(x))
    return torch.zeros(len(pixels), 3, dtype=torch.float64).index_add(0, rays, float64(weights)[:, None] * colors)


def oracle_loss(made: ArfTrainer, view: int, premultiplied: torch.Tensor) -> torch.Tensor:
    """The style objective of a view's picture over the background, in float64 from end to end."""
    s = made.settings
    objective = StyleObjective(
        small_trunk().double(), made.painting.double(), (HEIGHT, WIDTH), s.weights, s.feature_scale, s.style_rows, 0
    )
    alpha = float64(made.geometry.alpha(view))
    content = objective.content_of(float64(made.photos[view]).permute(2, 0, 1))
    rgb = premultiplied.reshape(HEIGHT, WIDTH, 3) + (1 - alpha[..., None]) * GRAY
    return objective(rgb.permute(2, 0, 1), content, alpha)[0]


def oracle_gradients(made: ArfTrainer, view: int, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """dL/d(values) through one graph, and deferred: by the picture's own gradient, handed back in parts."""
    everything = np.arange(HEIGHT * WIDTH)
    values = float64(made.field.color.values).requires_grad_()
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


@pytest.mark.parametrize("chunks", [1, 2])
def test_full_and_deferred_steps_equal_each_other_and_the_oracle(monkeypatch, chunks):
    full = style_gradient(stylizer(chunks, strategy="full", match="none"))
    monkeypatch.setattr(module, "PIXELS_AT_ONCE", 37)  # 252 pixels in seven parts
    made = stylizer(chunks, strategy="deferred", match="none")
    view = made._view_of_step()
    deferred = style_gradient(made)
    # Only the order of float32 sums differs.
    assert apart(deferred, full) < 1e-6
    expected, _ = oracle_gradients(made, view, 1)
    # Features of two blocks in float32, squared and divided by their lengths: some tens of roundings.
    assert apart(full, expected) < 5e-5


@pytest.mark.parametrize("strategy", ["dilated", "random", "patch"])
def test_chosen_rays_learn_their_share_of_the_whole_pictures_gradient(strategy):
    made = stylizer(strategy=strategy, match="none", blur=0, dilation=3)
    view, generator = made._view_of_step(), np.random.default_rng([0, 4, 0])
    pixels = module.selected_pixels(strategy, HEIGHT, WIDTH, 3, generator)
    values = float64(made.field.color.values).requires_grad_()
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
    before = kept.paint_view(0)
    for made in (kept, fresh):
        made._picture(0, pixels)
        made.field.color.values += 0.3
    now_ = kept.paint_view(0)
    old, new = kept._picture(0, pixels + 1)[0], fresh._picture(0, pixels + 1)[0]
    assert np.array_equal(new, now_) and np.array_equal(old[pixels + 1], now_[pixels + 1])
    rest = np.setdiff1d(np.arange(HEIGHT * WIDTH), pixels + 1)
    assert np.array_equal(old[rest], before[rest]) and np.abs(old[rest] - now_[rest]).max() > 0.05


def test_what_is_remembered_follows_what_dilated_rays_have_learned():
    made = stylizer(strategy="dilated", match="none", dilation=2)
    before = made.paint_view(0)
    made._picture(0, module.selected_pixels("dilated", HEIGHT, WIDTH, 2, np.random.default_rng(0)))
    made.field.color.values += 0.3
    now_, chosen = made.paint_view(0), module.selected_pixels("dilated", HEIGHT, WIDTH, 2, np.random.default_rng(1))
    seen = made._picture(0, chosen)[0]
    assert np.array_equal(seen[chosen], now_[chosen])
    assert np.abs(seen - now_).mean() < 0.2 * np.abs(before - now_).mean()


def test_a_refit_step_teaches_the_mean_squared_error_of_its_pixels():
    made, found = stylizer(match="none", chunks=2), []
    made.adam.step = lambda rate: found.append(made.adam.gradients.sum(0, dtype=np.float64))
    generator = np.random.default_rng([0, 2, 0])
    view = int(generator.integers(3))
    alpha = made.geometry.alpha(view).ravel()
    lit = np.flatnonzero(alpha > 1e-3)
    pixels = lit[generator.integers(0, len(lit), 128)]
    loss = made.refit_step()
    values = float64(made.field.color.values).requires_grad_()
    rgb = oracle_picture(made, view, values, pixels) + (1 - float64(alpha[pixels])[:, None]) * GRAY
    expected = (rgb - float64(made.photos[view].reshape(-1, 3)[pixels])).square().mean()
    expected.backward()
    assert loss == pytest.approx(float(expected.detach()), rel=1e-5) and apart(found[0], values.grad.numpy()) < 1e-5


# -- the loop -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("deform", [False, True])
@pytest.mark.parametrize("strategy", ["deferred", "dilated"])
def test_a_stylization_that_was_stopped_goes_on_to_the_same_bits(strategy, deform):
    whole = stylizer(strategy=strategy, deform=deform)
    whole.run()
    expected, arrays = result_of(whole)
    at = stylizer(strategy=strategy, deform=deform)
    seen = []

    def stop_after(count: int):
        def on_step(made: ArfTrainer) -> None:
            seen.append(made.state.phase)
            if len(seen) == count:
                raise Stopped

        return on_step

    for count in (3, 8, 9, 15):  # within the refit, at its last step, at the first of style, within it
        with pytest.raises(Stopped):
            at.run(stop_after(count))
        at = resumed(stylizer(strategy=strategy, deform=deform), at)
    at.run()
    state, found = result_of(at)
    assert seen.count("style") == 7 and state == expected and state["phase"] == "done"
    assert_same_bits(found, arrays)
    assert torch.equal(at.field.color_map.matrix, whole.field.color_map.matrix)
    assert any(name.startswith("seen.") for name in arrays) == (strategy == "dilated")


def test_learning_lowers_the_loss_and_leaves_the_density_alone():
    made, losses = stylizer(steps=30, strategy="deferred", match="none", weights=StyleWeights(1, 0, 0, 0)), []
    before = made.field.density.values.copy()
    step = made.style_step
    made.style_step = lambda: losses.append(step()) or losses[-1]
    made.run()
    style = [parts["style"] for parts in losses]
    assert np.mean(style[-3:]) < 0.9 * np.mean(style[:3])
    assert np.array_equal(made.field.density.values, before)
    assert made.field.color_map is None and len(made.state.curve) == 3


def test_every_view_is_visited_once_an_epoch():
    made, visits = stylizer(), []
    for made.state.step in range(12):
        visits.append(made._view_of_step())
    assert (
        all(sorted(visits[at : at + 3]) == [0, 1, 2] for at in (0, 3, 6, 9))
        and len(set(map(tuple, zip(*[iter(visits)] * 3)))) > 1
    )


def test_with_a_deformation_shapes_move_and_a_weight_holds_them():
    """The silhouettes change, the density does not: it is asked elsewhere."""
    moved = {}
    for weight in (0.0, 1e3):
        made = stylizer(steps=30, deform=True, match="none", displacement_weight=weight)
        before, rest = made.field.density.values.copy(), [made.geometry.alpha(v).copy() for v in range(3)]
        made.run()
        assert np.array_equal(made.field.density.values, before)
        for view in range(3):
            made.paint_view(view)
        apart_ = np.mean([np.abs(made.geometry.alpha(v) - rest[v]).mean() for v in range(3)])
        moved[weight] = apart_, np.abs(made.field.displacement).max()
    assert moved[0.0][0] > 1.1 * moved[1e3][0] and moved[0.0][1] > 5 * moved[1e3][1] > 0


def test_a_deforming_step_teaches_the_grid_what_the_finite_difference_says(monkeypatch):
    """dL/dD of a whole style step, along a random direction, background behind the silhouette included."""
    monkeypatch.setattr(geometry, "OPAQUE", 0.0)  # a ray that ends a sample earlier is a jump, not a slope
    made = stylizer(deform=True, match="none", strategy="deferred", refit_steps=1, share=0.0)
    made.field.occupancy = OccupancyGrid(made.field.occupancy.cells)
    made.refit_step()
    made._next_phase()
    view, pixels = made._view_of_step(), np.arange(HEIGHT * WIDTH)
    random = np.random.default_rng(5)
    direction = random.normal(size=made.field.displacement.shape).astype(np.float32)
    for axis in range(3):  # smooth, so that few samples change their cell
        direction = (direction + np.roll(direction, 1, axis) + np.roll(direction, -1, axis)) / 3
    picture_, _ = made._picture(view, pixels)
    gradient, _ = made._gradient(view, picture_)
    _, kept = made.geometry.paint(view, pixels)
    made.geometry.learn(kept, gradient.reshape(-1, 3), made.adam.gradients)
    expected = float((made.deformer.gradients.sum(0, dtype=np.float64) * direction.ravel()).sum())

    def linear(step: float) -> float:
        made.field.displacement[:] = step * direction
        rgb = made.paint_view(view).astype(np.float64)
        over = rgb + (1 - made.geometry.alpha(view).reshape(-1, 1)) * GRAY
        return float((over * gradient.reshape(-1, 3)).sum())

    measured = (linear(2e-4) - linear(-2e-4)) / 4e-4
    assert measured == pytest.approx(expected, rel=0.12)  # slopes jump between cells


@pytest.mark.parametrize("match", ["none", "before", "after", "both"])
def test_colors_are_matched_when_asked_for(match):
    made = stylizer(match=match, steps=3)
    changed = [not np.array_equal(a, b) for a, b in zip(made.photos, stylizer(match="none").photos)]
    assert all(changed) == (match in ("before", "both"))
    made.run()
    assert (made.field.color_map is not None) == (match in ("after", "both"))


def test_nan_in_a_photo_or_in_the_painting_is_a_divergence():
    made = stylizer(match="none")
    made.photos = [np.full_like(p, np.nan) for p in made.photos]
    with pytest.raises(Diverged, match="refit step 0"):
        made.run()
    made = stylizer(match="none")
    run_until(made, 5)
    made.painting = torch.full_like(made.painting, np.nan)
    with pytest.raises(Diverged, match="style step 0"):
        made.run()


def test_a_view_that_sees_nothing_is_passed_over():
    made = stylizer(match="none", refit_steps=4)
    away = look_at(np.array([3.0, 0, 0]), np.array([9.0, 0, 0]), np.array([0, 0, 1.0]))
    made.cameras[:] = [Camera("away", WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, away)] * 3
    made.geometry = geometry.FixedGeometry(made.field, made.cameras, 0.1, 1)
    before = made.field.color.values.copy()
    assert made.refit_step() == 0 and np.array_equal(made.field.color.values, before)
    assert all(np.isfinite(v) for v in made.style_step().values())


def test_a_view_is_first_remembered_as_it_looked_at_rest():
    """Shapes have moved since; what was there before them is neither walked again nor moved along."""
    made = stylizer(deform=True, strategy="random", match="none", refit_steps=4)
    made.settings = replace(made.settings, steps=1)
    rest = made.still.alpha(2).copy()
    while made.state.phase == "refit":
        made.refit_step()
        made.state.step += 1
        if made.progress >= 1:
            made._next_phase()
    made.field.displacement += 0.1
    made.deformer.look()
    assert np.array_equal(made.geometry.alpha(2), rest)
    everything, chosen = np.arange(HEIGHT * WIDTH), np.arange(0, HEIGHT * WIDTH, 5)
    others = np.setdiff1d(everything, chosen)
    still, (moved, _) = made.still.paint(2, everything)[0], made.geometry.paint(2, everything)
    picture = made._picture(2, chosen)[0]
    assert np.array_equal(picture[others], still[others]) and np.array_equal(picture[chosen], moved[chosen])
    assert np.abs(moved - still).max() > 0.05 and not np.array_equal(made.geometry.alpha(2), rest)


def test_large_strokes_come_first():
    """The coarse share of the steps takes features at half the size; the photos' are taken anew after it."""
    made, scales, contents = stylizer(steps=4, coarse=0.5, match="none"), [], []

    def look(now: ArfTrainer) -> None:
        if now.state.phase == "style":
            scales.append(now.objective.scale)
            contents.append({view: kept.features["conv1"].shape for view, kept in now._content.kept.items()})

    made.run(look)
    # Told after a step, the objective is that of the next one.
    assert scales == [0.5, 1.0, 1.0, 1.0]
    assert contents[1] == {} and {shape[1:] for shape in contents[3].values()} == {(HEIGHT, WIDTH)}


def test_features_are_taken_around_the_object_alone():
    made = stylizer()
    assert all(window == (slice(0, HEIGHT), slice(0, WIDTH)) for window in made.windows)  # no room for a margin here
    made.windows = [(slice(2, 12), slice(4, 16))] * 3
    made.run()
    assert all(kept.features["conv1"].shape[1:] == (10, 12) for kept in made._content.kept.values())
