"""A stylization that meets NaN: back to the last good state, on at half the rate, as often as it is allowed to."""

import numpy as np
import pytest

from stylerf.errors import Diverged
from stylerf.fields.deformation import Deformation
from stylerf.training.stylize.trainer import KEEP_EVERY, StylizationTrainer
from tests.stylerf.training.running import assert_same_bits, result_of, resumed
from tests.stylerf.training.stylizing import arf


def poisoned(at: set[int], **given) -> StylizationTrainer:
    """Its style step spoils the colors at these steps, each time once, as an overflowing gradient does."""
    one = arf(match="none", **{"steps": 12, "refit_steps": 4, **given})
    left, plain = set(at), one.method.step

    def step() -> dict[str, float]:
        parts = plain()
        if one.state.step in left:
            left.remove(one.state.step)
            one.scene.field.color.values[:] = np.nan
            return parts | {"style": float("nan")}
        return parts

    one.method.step = step
    return one


def test_without_leave_it_ends_at_the_first():
    with pytest.raises(Diverged, match="style step 3"):
        poisoned({3}).run()


def test_it_goes_back_and_ends_with_sound_colors_at_half_the_rate():
    one = poisoned({3, 7}, rollbacks=2)
    seen = []
    one.run(lambda now: seen.append((now.state.phase, now.state.step)))
    assert np.isfinite(one.scene.field.color.values).all() and one.state.counts["rollbacks"] == 2
    assert one.settings.rate == pytest.approx(0.25 * one._guard.initial.rate) and one.state.phase == "done"
    # What is kept is of step 1 of the phase: each return begins there again.
    style = [step for phase, step in seen if phase != "refit"]
    assert style == [1, 2, 3, *range(2, 8), *range(2, 13)]
    assert KEEP_EVERY > 12


def test_what_it_goes_back_to_is_the_kept_state_to_the_bit():
    """Compared with a run that is stopped at that state and goes on at half the rate by itself."""
    one = poisoned({3}, rollbacks=1)
    one.run()
    other = arf(match="none", steps=12, refit_steps=4, rollbacks=1)
    stop = other.state

    class Enough(Exception):
        pass

    def halt(now) -> None:
        if now.state.phase == "style" and now.state.step == 1:
            raise Enough

    with pytest.raises(Enough):
        other.run(halt)
    other.state.counts["rollbacks"] = 1
    other = resumed(arf(match="none", steps=12, refit_steps=4, rollbacks=1), other)
    assert other.settings.rate == pytest.approx(0.5 * other._guard.initial.rate) and stop is not other.state
    other.run()
    assert_same_bits(result_of(one)[1], result_of(other)[1])


def test_what_was_counted_and_reported_since_is_forgotten():
    one = poisoned({11}, rollbacks=1, steps=14)
    plain = one.method.step

    def counted() -> dict[str, float]:
        one.state.counts["steps"] = one.state.counts.get("steps", 0) + 1
        return plain()

    one.method.step = counted
    one.run()
    assert one.state.counts == {"steps": 14, "rollbacks": 1}
    assert [entry["step"] for entry in one.state.curve if entry["phase"] == "style"] == [10]


@pytest.mark.parametrize("rollbacks", [0, 1])
def test_the_last_step_is_looked_at_too(rollbacks):
    """What it leaves no loss tells of."""
    one = arf(match="none", steps=12, refit_steps=4, rollbacks=rollbacks)
    plain, left = one.method.step, [11]

    def step() -> dict[str, float]:
        parts = plain()
        if left and one.state.step == left[0]:
            left.pop()
            one.scene.field.color.values[:] = np.nan
        return parts

    one.method.step = step
    if not rollbacks:
        with pytest.raises(Diverged):
            one.run()
        return
    one.run()
    assert np.isfinite(one.scene.field.color.values).all() and one.state.phase == "done"


def test_too_often_is_the_end():
    with pytest.raises(Diverged):
        poisoned({2, 3, 5}, rollbacks=2).run()


def test_a_sound_run_is_the_same_with_and_without():
    plain, guarded = (arf(match="none", steps=12, refit_steps=4, rollbacks=n) for n in (0, 3))
    plain.run()
    guarded.run()
    assert_same_bits(result_of(plain)[1], result_of(guarded)[1])


@pytest.mark.parametrize("broken", ["color", "adam.second", "deform.values", "deform.adam.first"])
def test_what_is_not_finite_and_only_the_device_has_yet_is_not_kept(broken):
    one = with_shapes(rollbacks=1)
    one.state.phase = "style"
    one.scene.start_moving()
    checkpoint = one.checkpoint

    def collected():
        data, arrays = checkpoint()
        return data, arrays | {broken: np.full_like(arrays[broken], np.nan)}

    one.checkpoint = collected
    one._guard.keep(one)
    assert one._guard._snapshot is None and np.isfinite(one.scene.field.color.values).all()
    one.checkpoint = checkpoint
    one._guard.keep(one)
    assert np.isfinite(one._guard._snapshot[1][broken]).all()


def test_what_is_kept_has_shapes_that_can_be_seen():
    """A displacement of NaN is reported a step late, when the state that holds it might have been kept."""
    one = with_shapes(rollbacks=1)
    plain, left = one.method.step, [KEEP_EVERY]

    def step() -> dict[str, float]:
        parts = plain()
        if left and one.state.phase == "style" and one.state.step + 1 == left[0]:
            left.pop()
            one.scene.deformer.deformation.values[:] = np.nan
            one.scene.deformer.bake()
        return parts

    one.method.step = step
    one.run()
    assert one.state.counts["rollbacks"] == 1 and np.isfinite(one.scene.field.displacement).all()


def test_a_clip_holds_the_network_of_the_shapes_too():
    assert (
        with_shapes(gradient_clip=3.0).scene.deformer.adam.gradient_clip == 3.0
        and with_shapes().scene.deformer.adam.gradient_clip == 0.0
    )


def with_shapes(**given) -> StylizationTrainer:
    """A short stylization whose shapes move."""
    moved = Deformation.create(np.random.default_rng(0), frequencies=2, width=16)
    options = {"match": "none", "steps": KEEP_EVERY + 3, "refit_steps": 4, "displacement_vertices": 6, **given}
    return arf({"deformation": moved}, **options)
