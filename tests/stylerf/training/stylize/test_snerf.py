"""Pictures and field by turns: whose turn it is, what each lowers, what a picture is, going on."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.style.image_stylization import painted
from stylerf.style.style_loss import StyleWeights
from stylerf.training.stylize import snerf
from stylerf.training.stylize.settings import SnerfSettings
from stylerf.training.stylize.snerf import Snerf
from stylerf.training.stylize.trainer import StylizationTrainer
from tests.stylerf.style.small_trunk import small_trunk
from tests.stylerf.training.running import Stopped, assert_same_bits, result_of, resumed
from tests.stylerf.training.stylizing import GRAY, HEIGHT, VIEWS, WIDTH, problem, settings, stopping, trainer


def alternating(**more) -> StylizationTrainer:
    options = {"rounds": 2, "image_share": 0.5, "loss": "gram", **more}
    return trainer(lambda scene: Snerf(scene, small_trunk()), problem(settings(SnerfSettings, **options)))


def test_turns_follow_the_budget():
    one, pictures = alternating(steps=12, match="none"), []
    one.run(lambda now: pictures.append(now.state.counts.get("pictures", 0)))
    assert pictures == [0] * 8 + [1, 2, 3, 3, 3, 3, 4, 5, 6, 6, 6, 6]  # after a refit of eight steps
    assert sorted(one.method.images) == list(range(VIEWS))


def test_views_take_turns_and_the_field_learns_from_the_first_on():
    one, seen = alternating(steps=8, rounds=4, image_share=0.5, match="none"), []
    one.run(lambda now: seen.append(len(now.method.images)) if now.state.phase == "style" else None)
    assert seen == [1, 1, 2, 2, 3, 3, 3, 3]


def test_a_picture_that_takes_long_ends_with_the_pictures_turn():
    """In a budget of time the field has its turn even where a single picture would take all of it."""
    one = alternating(steps=0, match="none", image_steps=10**6, refit_steps=1)
    one.scene.settings = replace(one.settings, seconds=2.0)
    kinds = []
    one.method.step = lambda step=one.method.step: kinds.append(one.method.optimizes_images) or step()
    one.run()
    assert True in kinds and False in kinds and one.state.seconds < 6.0
    one.state.phase, one.state.seconds = "style", 0.7
    assert one.method.seconds_left_for_images == pytest.approx(-0.2) and not one.method.optimizes_images
    one.state.seconds = 1.2
    assert one.method.seconds_left_for_images == pytest.approx(0.3) and one.method.optimizes_images


class Clock:
    """In place of `time`: moves by what steps take."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        return self.now


@pytest.mark.parametrize("evaluation", [20.0, 60.0, 150.0])
def test_however_slow_an_evaluation_the_field_has_its_turns(monkeypatch, evaluation):
    """Of two minutes in three rounds: a step of ten seconds after each round's images, and the last ten."""
    one, clock, kinds = alternating(steps=0, match="none", rounds=3, image_share=0.75), Clock(), []
    one.scene.settings = replace(one.settings, seconds=120.0)
    one.state.phase = "style"
    monkeypatch.setattr(snerf, "time", clock)

    def painted(start, alpha, background, loss, steps, rate, enough):
        for _ in range(steps):
            clock.now += evaluation
            if enough():
                break
        return np.zeros((HEIGHT, WIDTH, 3), np.float32), {}

    monkeypatch.setattr(snerf, "painted", painted)
    while one.scene.budget.progress < 1.0:
        begun, this_round = clock.now, int(3 * one.scene.budget.progress)
        if one.method.optimizes_images:
            one.method.image_step()
            kinds.append(this_round)
        else:
            clock.now += 10.0
            kinds.append("field")
        # As the trainer counts: the first step compiles.
        one.state.seconds, one.state.step = one.state.seconds + (clock.now - begun) * (len(kinds) > 1), len(kinds)
    assert kinds[-1] == "field" and one.state.seconds < 140
    pairs = [(a, b) for a, b in itertools.pairwise(kinds) if "field" not in (a, b)]
    assert all(a == b for a, b in pairs)


def test_a_picture_is_its_render_painted_and_kept_in_eight_bits():
    one = alternating(match="none")
    one.state.phase = "style"
    parts = one.method.image_step()
    (view,) = one.method.images
    alpha = one.scene.geometry.alpha(view)
    rgb = one.scene.render(view).reshape(HEIGHT, WIDTH, 3) + (1 - alpha[..., None]) * GRAY
    content, coverage = one.method.loss.content(view), torch.from_numpy(alpha)
    expected, again = painted(
        torch.from_numpy(rgb).permute(2, 0, 1).contiguous(), coverage, GRAY,
        lambda p: one.method.loss.objective(
            one.method.loss.without_background(view, p, coverage), content, coverage, one.method.loss.windows[view]
        ), 5, 0.03,
    )  # fmt: skip
    assert np.abs(one.method.images[view] / 255 - expected).max() <= 0.5 / 255 + 1e-6 and parts == again
    assert np.abs(expected - rgb).max() > 0.05


def test_in_one_turn_a_picture_is_painted_on_and_in_the_next_again():
    """What is rendered does not change while pictures are painted: begun from it again, a visit would be the last."""
    one = alternating(match="none", steps=0)
    one.scene.settings = replace(one.settings, seconds=100.0)
    one.state.phase = "style"
    losses = [one.method.image_step() for _ in range(3 * VIEWS)]
    first, second, third = (sum(one["style"] for one in losses[at : at + VIEWS]) for at in range(0, 3 * VIEWS, VIEWS))
    assert third < second < first
    begun, other = one.method.images[0].copy(), alternating(match="none")
    one.state.seconds = 50.0  # the second round
    for _ in range(VIEWS):
        one.method.image_step()
    other.state.phase = "style"
    for _ in range(VIEWS):
        other.method.image_step()
    assert np.array_equal(one.method.images[0], other.method.images[0]) and not np.array_equal(
        one.method.images[0], begun
    )


def test_of_few_steps_the_field_has_half():
    """Steps are cheap for the field and dear for pictures: methods given the same number do comparable work."""
    one, before = alternating(steps=15, rounds=3, image_share=0.75, match="none"), []
    one.run(lambda now: before.append(now.state.counts.get("pictures", 0)))
    assert before[-1] == 9  # a half of five, rounded up
    one, before = alternating(steps=60, rounds=2, image_share=0.75, match="none"), []
    one.run(lambda now: before.append(now.state.counts.get("pictures", 0)))
    assert before[-1] == 2 * VIEWS


def test_a_step_of_the_field_is_that_of_the_mean_squared_error():
    one, found = alternating(match="none"), []
    one.state.phase, one.state.step = "style", 3
    one.method.images = {1: np.full((HEIGHT, WIDTH, 3), 51, np.uint8)}
    one.scene.adam.step = lambda rate: found.append(one.scene.adam.gradients.sum(0, dtype=np.float64))
    error = one.method.field_step()["mse"]
    other = alternating(match="none")
    other.scene.photos = [None, np.full((HEIGHT, WIDTH, 3), 0.2, np.float32)]
    expected = other.scene.learn_image(1, other.scene.photos[1], _after_a_draw(0, 5, 3), 128)
    assert error == pytest.approx(expected, rel=1e-6)
    np.testing.assert_array_equal(found[0], other.scene.adam.gradients.sum(0, dtype=np.float64))


def _after_a_draw(seed: int, stream: int, step: int) -> np.random.Generator:
    generator = np.random.default_rng([seed, stream, step])
    generator.integers(1)
    return generator


def test_alternation_lowers_both_distances():
    """Of the renders to the painting, and of the field to the pictures that it is taught."""
    one = alternating(steps=60, rounds=3, image_share=0.3, image_steps=8, match="none", rate=0.03,
                      weights=StyleWeights(1, 0, 0, 0))  # fmt: skip
    styles, gaps = [], []

    def seen(now: StylizationTrainer, view: int) -> np.ndarray:
        alpha = now.scene.geometry.alpha(view)
        return now.scene.render(view).reshape(HEIGHT, WIDTH, 3) + (1 - alpha[..., None]) * GRAY

    def look(now: StylizationTrainer) -> None:
        if now.state.phase != "style":
            return
        if now.state.step in (1, 20, 40, 60):
            rendered = [(torch.from_numpy(seen(now, v)).permute(2, 0, 1).contiguous(), v) for v in range(VIEWS)]
            parts = [
                now.method.loss.objective(p, None, torch.from_numpy(now.scene.geometry.alpha(v)))[1]
                for p, v in rendered
            ]
            styles.append(np.mean([part["style"] for part in parts]))
        if now.state.step in (6, 20):  # the field's first turn begins and ends
            gaps.append(np.mean([np.square(seen(now, v) - t / 255.0).mean() for v, t in now.method.images.items()]))

    one.run(look)
    assert styles[-1] < 0.7 * styles[0] and styles[1] < styles[0]
    assert gaps[1] < 0.9 * gaps[0]


def test_a_stopped_alternation_goes_on_to_the_same_bits():
    whole = alternating(steps=12)
    whole.run()
    expected, arrays = result_of(whole)
    at, on_step = alternating(steps=12), stopping([3, 8, 10, 12, 15, 19])
    for _ in range(6):  # in the refit, at its end, between pictures, in the field's turn, in the second round
        with pytest.raises(Stopped):
            at.run(on_step)
        at = resumed(alternating(steps=12), at)
    at.run(on_step)
    state, found = result_of(at)
    assert state == expected and state["phase"] == "done" and state["counts"] == {"pictures": 6}
    assert_same_bits(found, arrays)
    assert sum(name.startswith("target.") for name in arrays) == VIEWS
    assert torch.equal(at.scene.field.color_map.matrix, whole.scene.field.color_map.matrix)
