"""The fitting loop on a tiny scene: it resumes to the bit, and survives NaN, falls and lack of memory."""

import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from stylerf.errors import Diverged
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import backward, render_rays
from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.fit import engine as module
from stylerf.training.fit.engine import Batch, CpuEngine, StepResult
from stylerf.training.fit.fitter import Fitter
from tests.stylerf.small import close, field_of, vm_color
from tests.stylerf.training.running import Stopped, assert_same_bits, now, result_of, resumed, run_until, saved
from tests.stylerf.training.scenes import LEVELS, box_fitter, masked_wall, settings

# -- resuming -------------------------------------------------------------------------------------------------------


def test_a_fit_that_was_stopped_goes_on_to_the_same_bits():
    """Stopped before any look at held-out views, at a growth, within a trial, after a drop, at the end."""
    steps, more = 320, {"level_ends": (0.32, 0.63), "min_gain": 9.0, "background": "random"}
    whole = box_fitter(steps, **more)
    whole.run()
    expected, arrays = result_of(whole)
    assert (
        whole.state.decisions and max(e["parameters"] for e in whole.state.curve) > whole.state.curve[0]["parameters"]
    )
    at = box_fitter(steps, **more)
    for stop in (3, 103, 130, 203, 319):
        at = run_until(at, stop)
        at = resumed(box_fitter(steps, **more), at)
        assert at.state.step == stop
    at.run()
    state, found = result_of(at)
    assert state == expected
    assert_same_bits(found, arrays)


def test_all_steps_draw_one_sequence_of_rays():
    fitter, batches = box_fitter(40), []
    learn = fitter.engine.learn

    def learned(batch: Batch):
        batches.append(batch)
        return learn(batch)

    fitter.engine.learn = learned
    fitter.run()
    rays = [batch.rays for batch in batches]
    assert [batch.earlier for batch in batches] == [sum(rays[:step]) for step in range(40)] and len({*rays}) > 1


# -- masks ----------------------------------------------------------------------------------------------------------


def gradients_of(bank: RayDataset, field) -> list[np.ndarray]:
    """Of one step, by the engine's optimizers."""
    engine, found = CpuEngine(bank, 0, 1, field), []
    for adam in (engine.density_adam, engine.color_adam):
        adam.step = lambda rate, adam=adam: found.append(adam.gradients.copy())
    engine.learn(Batch(0, 200, 1, len(bank.cameras), 0.0, "white", 1e-2, (0.0, 0.0), 0.0))
    return found


@pytest.mark.parametrize("kind", ["frustum", "contraction"])
def test_what_masks_hide_in_a_closed_space_teaches_nothing(kind):
    space = masked_wall(0)[0] if kind == "frustum" else SpaceWarp.box([-1] * 3, [1] * 3, near=0.05, far=1e3, kind=kind)
    field = field_of(space, 1, vm_color(2))
    assert all(not found.any() for found in gradients_of(masked_wall(24)[1], field))
    # What a photo shows counts for as much as without the mask.
    half, whole = masked_wall(12)[1], masked_wall(0)[1]
    views, pixels = half.choose(200, np.random.default_rng([0, 5]), 8, 0.0)
    jitter = np.random.default_rng([0, 4, 0]).random(200, dtype=np.float32)
    shown = pixels % 24 >= 12
    origins, directions, colors = (array[shown] for array in whole.at(views, pixels))
    rendered = render_rays(field, Rays.of(origins, directions, space.near, jitter[shown]), threads=1)
    towards = np.zeros_like(rendered.out)
    towards[:, :3] = 2 / 600 * (rendered.out[:, :3] + (1 - rendered.out[:, 3:4]) - colors[:, :3])
    towards[:, 3] = -towards[:, :3].sum(1)
    wanted = [np.zeros((1, len(part.values)), np.float32) for part in (field.density, field.color)]
    backward(field, rendered, towards, *wanted)
    for found, expected in zip(gradients_of(half, field), wanted, strict=True):
        close(found, expected, 1e-4)


def test_held_out_views_are_judged_where_masks_show_them():
    space, bank = masked_wall(12)
    held_out = Fitter(space, bank, 2, settings(3), 0, 1).held_out_rays.rays
    assert 7000 < len(held_out[0]) < 9000
    np.testing.assert_allclose(held_out[2], np.broadcast_to(np.float32([180, 120, 60, 255]) / 255, held_out[2].shape))
    assert len(Fitter(space, masked_wall(24)[1], 2, settings(3), 0, 1).held_out_rays.rays[0]) == 16384


def test_another_seed_is_another_fit_and_the_same_seed_the_same():
    results = []
    for seed in (5, 5, 6):
        fitter = box_fitter(30, seed=seed)
        fitter.run()
        results.append(fitter.field.arrays())
    assert_same_bits(results[0], results[1])
    assert not np.array_equal(results[0]["color"], results[2]["color"])


def test_rays_stay_as_they_are_until_a_step_is_reported():
    fitter = box_fitter(4)
    learn, before = fitter.engine.learn, fitter.state.rays
    fitter.engine.learn = lambda batch: StepResult(0.0, 0.0)  # a device is still at its first
    fitter.step()
    assert fitter.state.rays == before
    fitter.engine.learn = learn
    fitter.step()
    assert fitter.state.rays != before


def test_what_a_look_waits_for_is_time_of_the_fit():
    fitter = box_fitter(20)
    settle, seconds = fitter.engine.settle, []

    def slow() -> None:
        settle()
        time.sleep(0.02)
        seconds.append(fitter.state.seconds)

    fitter.engine.settle = slow
    fitter.run()
    assert len(seconds) > 1 and all(later - earlier >= 0.02 for earlier, later in pairwise(seconds))


def test_kernels_of_a_lower_degree_are_compiled_before_it_is_taught():
    fitter = box_fitter(4, degree=1)
    seen, warm_up = [], fitter.engine.warm_up

    def watched(scratch, *more) -> None:
        seen.append(sorted(field.color.degree for field in scratch))
        warm_up(scratch, *more)

    fitter.engine.warm_up = watched
    fitter.warm_up()
    fitter.warm_up_levels([replace(LEVELS[-1], degree=0)])
    fitter.warm_up_levels([replace(LEVELS[-1], degree=1)])
    assert seen[0] == [1] and seen[1:] == [[0]]


# -- faults on the way ----------------------------------------------------------------------------------------------


def poison(fitter: Fitter, steps) -> None:
    """NaN among the colors that the rays of these steps should meet."""
    draw = fitter.dataset.draw

    def drawn(*arguments):
        origins, directions, colors, views = draw(*arguments)
        if fitter.state.step in steps:
            colors[7] = np.nan
        return origins, directions, colors, views

    fitter.dataset.draw = drawn


def test_a_loss_of_nan_brings_back_the_best_field_with_half_the_rate():
    fitter, before = box_fitter(60), {}
    poison(fitter, {40})

    def on_step(now_: Fitter) -> None:
        if now_.state.step == 40:
            before.update(now(now_.checkpoint()[1], "anchor."))
        if now_.state.step == 41:
            assert_same_bits(now(now_.checkpoint()[1]), before)
            assert now_.state.rollbacks == 1 and now_.state.rate_scale == 0.5
            raise Stopped

    with pytest.raises(Stopped):
        fitter.run(on_step)
    assert any("finite" in text and "half" in text for text in fitter.said)
    again = box_fitter(60)
    poison(again, {40})
    again.run()
    assert all(np.isfinite(v).all() for v in (again.field.density.values, again.field.color.values))
    assert again.state.decisions == fitter.state.decisions
    clean = box_fitter(60)
    clean.run()
    assert again.state.curve[-1]["psnr"] > clean.state.curve[-1]["psnr"] - 1.5


def spoil(fitter: Fitter, step: int, shift: float):
    """on_step that makes the density exp(shift) times what it was."""

    def on_step(now_: Fitter) -> None:
        if now_.state.step == step:
            now_.field.density.values[-1] += shift

    return on_step


def test_a_fall_of_held_out_views_by_two_db_restores_the_best_field():
    fitter, anchor = box_fitter(200), {}
    damage = spoil(fitter, 90, -9.0)

    def on_step(now_: Fitter) -> None:
        if now_.state.step == 90:
            anchor.update(now(now_.checkpoint()[1], "anchor."))
        damage(now_)
        if now_.state.rollbacks:
            raise Stopped

    with pytest.raises(Stopped):
        fitter.run(on_step)
    assert 90 < fitter.state.step <= 98 and fitter.state.rate_scale == 0.5
    assert_same_bits(now(fitter.checkpoint()[1]), anchor)
    assert fitter.state.decisions[-1].startswith("held-out views fell from 17.")
    best, last = fitter.state.best, fitter.state.curve[-1]["psnr"]
    assert best - last > 2 and fitter.held_out_psnr() == pytest.approx(best, abs=1e-9)
    assert fitter.state.quality["held out"] == pytest.approx(best, abs=1e-3)  # not of what was left behind


def test_a_fall_of_less_is_noise():
    fitter = box_fitter(120)
    fitter.run(spoil(fitter, 90, -0.4))
    assert fitter.state.rollbacks == 0


def test_a_fall_within_the_trial_of_a_level_leaves_the_levels():
    fitter = box_fitter(300, level_ends=(0.34, 0.68), levels=LEVELS[:2])
    fitter.run(spoil(fitter, 120, -9.0))
    assert fitter.state.rollbacks == 1 and fitter.state.growth_ended and fitter.state.level == 0
    assert fitter.field.density.size.max() == 8 and fitter.state.trial is None


def test_nan_in_the_field_itself_is_found_by_the_next_look():
    """Kernels clamp a NaN density to an ordinary one; a picture that is wrong without NaN must not be kept either."""

    def on_step(now_: Fitter) -> None:
        if now_.state.step == 97:
            now_.field.density.values[:] = np.nan
            now_.field.color.values[:] = np.nan

    fitter = box_fitter(100)
    fitter.run(on_step)
    assert fitter.state.rollbacks >= 1
    assert np.isfinite(fitter.field.density.values).all() and np.isfinite(fitter.field.color.values).all()


def test_quality_that_is_no_number_counts_as_a_fall(monkeypatch):
    fitter = box_fitter(40)
    looks = iter([12.0, 13.0, float("nan")])
    monkeypatch.setattr(fitter, "held_out_psnr", lambda: next(looks, 14.0))
    fitter.run()
    assert fitter.state.rollbacks == 1 and "nan" in fitter.state.decisions[0]
    assert all(np.isfinite(value) for value in fitter.state.quality.values())


def test_the_fifth_rollback_is_a_divergence_or_the_first_without_a_state():
    fitter = box_fitter(60)
    poison(fitter, range(20, 60))
    with pytest.raises(Diverged, match="5 times"):
        fitter.run()
    assert fitter.state.rollbacks == 5 and fitter.state.rate_scale == 0.5**4
    fresh = box_fitter(60)
    poison(fresh, {0})
    with pytest.raises(Diverged, match="finite"):
        fresh.run()


def test_a_fit_that_diverges_past_half_its_budget_ends_with_its_best():
    fitter, anchor = box_fitter(60), {}
    poison(fitter, range(40, 60))

    def on_step(now_: Fitter) -> None:
        if now_.state.step == 40:
            anchor.update(now(now_.checkpoint()[1], "anchor."))

    fitter.run(on_step)
    assert fitter.state.step == 45 and fitter.state.rollbacks == 5 and fitter.state.ended_at == 0.75
    assert_same_bits(now(fitter.checkpoint()[1]), anchor)
    assert fitter.said[-1] == fitter.state.decisions[-1] and "stopping with the best field, 75%" in fitter.said[-1]
    again = resumed(box_fitter(60), fitter)
    again.run()
    assert again.state.step == 45
    assert_same_bits(again.field.arrays(), fitter.field.arrays())


def test_a_checkpoint_of_before_goes_on():
    """It tells neither the quality of what stands nor whether the fit has ended."""
    data, arrays = saved(run_until(box_fitter(30), 12))
    for later in ("quality", "anchor_quality", "ended_at"):
        del data["state"][later]
    fitter = box_fitter(30)
    fitter.resume(data, arrays)
    fitter.run()
    assert fitter.state.step == 30 and fitter.state.quality


# -- memory ---------------------------------------------------------------------------------------------------------


def limit_rays(monkeypatch, most: int) -> list[int]:
    """No more than `most` rays at once fit in memory, but for looks at held-out views; returns the sizes rendered."""
    render, sizes = module.render_rays, []

    def limited(field, rays, **more):
        if field.occupancy.cells != 8 or len(rays.origins) in (16, 4096):  # warm-up and held-out views
            return render(field, rays, **more)
        if len(rays.origins) > most:
            raise MemoryError
        sizes.append(len(rays.origins))
        return render(field, rays, **more)

    monkeypatch.setattr(module, "render_rays", limited)
    return sizes


def test_a_batch_that_does_not_fit_is_worked_off_in_parts(monkeypatch):
    sizes = limit_rays(monkeypatch, 300)
    fitter = box_fitter(12)
    fitter.run()
    assert fitter.state.step == 12 and fitter.state.parts == 4 and max(sizes) <= 300  # 1024 rays at first
    assert [text for text in fitter.said if "memory" in text] == [
        "out of memory: batches are now split into 2 parts",
        "out of memory: batches are now split into 4 parts",
    ]
    monkeypatch.undo()
    straight = box_fitter(12)
    straight.state.parts = 4
    straight.run()
    assert_same_bits(straight.field.arrays(), fitter.field.arrays())  # what had been added before the fault is gone


def test_not_even_a_sixty_fourth_fits(monkeypatch):
    limit_rays(monkeypatch, 2)
    with pytest.raises(MemoryError, match="1/64 of a batch"):
        box_fitter(12).run()


def step_gradients(parts: int, **more) -> list[np.ndarray]:
    """Gradients of one step in a half-learned field, before the optimizer takes them."""
    fitter, found = resumed(box_fitter(60), run_until(box_fitter(60), 33)), []
    fitter.state.parts = parts
    for adam in (fitter.engine.density_adam, fitter.engine.color_adam):
        adam.step = lambda rate, adam=adam: found.append(adam.gradients.sum(0, dtype=np.float64))
    fitter.step()
    return found


def test_the_gradient_of_a_step_in_parts_is_the_gradient_of_the_whole():
    whole = step_gradients(1)
    for parts in (2, 7):
        for found, expected in zip(step_gradients(parts), whole):
            largest = np.abs(expected).max()
            assert largest > 0
            np.testing.assert_allclose(found, expected, atol=2e-6 * largest)  # sums of float32 in another order


def test_planes_are_smoothed_every_eighth_step_by_as_much_as_eight():
    """The gradient of a smoothing step is the plain one and eight times that of the planes' total variation."""
    for at, is_smoothed in ((31, False), (32, True)):
        (plain, _), (smoothed, variation) = (gradients_and_variation(at, weight) for weight in (0.0, 0.5))
        for without, found, expected in zip(plain, smoothed, variation):
            assert np.abs(expected).max() > 0
            if is_smoothed:
                np.testing.assert_allclose(found - without, expected, atol=1e-5 * np.abs(found).max())
            else:
                assert np.array_equal(found, without)


def gradients_and_variation(at: int, weight: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Gradients of step `at`, and eight times the weighted gradient of the planes' variation before it, per part."""
    fitter, found = resumed(box_fitter(60, smoothness=(weight, 2 * weight)), run_until(box_fitter(60), at)), []
    variation = [np.zeros(len(part.values), np.float32) for part in (fitter.field.density, fitter.field.color)]
    fitter.field.density.smooth(8 * weight, variation[0])
    fitter.field.color.smooth(16 * weight, variation[1])
    for adam in (fitter.engine.density_adam, fitter.engine.color_adam):
        adam.step = lambda rate, adam=adam: found.append(adam.gradients.sum(0))
    fitter.step()
    return found, variation
