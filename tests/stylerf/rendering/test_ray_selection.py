"""Which rays learn: sets, counts, order, reach; and that what they learn is the whole gradient in the mean."""

import itertools

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.rendering.ray_selection import STRATEGIES, selected_gradient, selected_pixels, spread_over_picture

HEIGHT, WIDTH = 9, 14


def drawn(strategy: str, seed: int, dilation: int = 3, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    return selected_pixels(strategy, height, width, dilation, np.random.default_rng(seed))


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_pixels_are_distinct_indices_of_the_picture(strategy):
    for seed, dilation in itertools.product(range(5), (1, 2, 3, 20)):
        found = drawn(strategy, seed, dilation)
        assert found.dtype == np.int64 and len(set(found.tolist())) == len(found) >= 1
        assert found.min() >= 0 and found.max() < HEIGHT * WIDTH
        if strategy != "random":
            assert (np.diff(found) > 0).all()
        if strategy in ("full", "deferred") or dilation == 1:
            assert np.array_equal(np.sort(found), np.arange(HEIGHT * WIDTH))
        assert np.array_equal(found, drawn(strategy, seed, dilation))


def test_dilated_pixels_are_a_lattice_whose_offsets_reach_every_pixel():
    offsets, seen = set(), set()
    for seed in range(80):
        rows, columns = np.divmod(drawn("dilated", seed), WIDTH)
        first = int(rows[0]), int(columns[0])
        assert set(rows) == set(range(first[0], HEIGHT, 3)) and set(columns) == set(range(first[1], WIDTH, 3))
        assert len(rows) == len(set(rows)) * len(set(columns))
        offsets.add(first)
        seen.update(zip(rows.tolist(), columns.tolist()))
    assert offsets == set(itertools.product(range(3), range(3))) and len(seen) == HEIGHT * WIDTH


def test_random_and_patch_take_one_of_dilation_squared():
    assert len(drawn("random", 0)) == HEIGHT * WIDTH // 9
    patches = [np.divmod(drawn("patch", seed), WIDTH) for seed in range(200)]
    for rows, columns in patches:
        assert len(rows) == 3 * 4 and np.ptp(rows) == 2 and np.ptp(columns) == 3  # a solid window of a third a side
    corners = {(int(rows[0]), int(columns[0])) for rows, columns in patches}
    assert {r for r, _ in corners} == set(range(7)) and {c for _, c in corners} == set(range(11))
    seen = {int(p) for seed in range(200) for p in drawn("random", seed)}
    assert len(seen) == HEIGHT * WIDTH


def test_pictures_smaller_than_the_dilation_still_give_a_pixel():
    for strategy in ("dilated", "random", "patch"):
        counts = {len(drawn(strategy, seed, 5, 2, 3)) for seed in range(20)}
        assert counts == {1}
    assert {int(drawn("dilated", seed, 5, 2, 3)[0]) for seed in range(60)} == set(range(6))


def test_an_unknown_strategy_is_refused():
    with pytest.raises(InvalidValue, match="spiral"):
        drawn("spiral", 0)


# -- gradients ------------------------------------------------------------------------------------------------------


def picture_gradient(height=HEIGHT, width=WIDTH) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(height, width, 3)).astype(np.float32)


def mean_gradient(strategy: str, gradient: np.ndarray, dilation: int, rounds: int) -> np.ndarray:
    """The mean over draws of what the rays are handed, spread over the picture."""
    height, width = gradient.shape[:2]
    total, generator = np.zeros((height * width, 3)), np.random.default_rng(3)
    for _ in range(rounds):
        pixels = selected_pixels(strategy, height, width, dilation, generator)
        total[pixels] += selected_gradient(gradient, pixels, 0)
    return (total / rounds).reshape(gradient.shape)


@pytest.mark.parametrize(
    ("strategy", "height", "width", "dilation"),
    [("dilated", 9, 15, 3), ("dilated", 5, 7, 2), ("dilated", 3, 4, 3), ("random", 9, 14, 3), ("full", 5, 4, 3)],
)
def test_the_mean_over_many_draws_is_the_full_gradient(strategy, height, width, dilation):
    gradient = picture_gradient(height, width)
    found = mean_gradient(strategy, gradient, dilation, 6000)
    # A pixel is in one of nine draws: its share of 6000 strays from 1 by sqrt(8/6000), 4 % (one standard deviation).
    bound = 0.0 if strategy == "full" else 4.5 * np.sqrt((dilation**2 - 1) / 6000)
    assert np.abs(found / gradient - 1).max() <= bound + 1e-6


def test_a_patch_is_the_full_gradient_in_sum_but_favors_the_middle():
    share = mean_gradient("patch", np.ones((HEIGHT, WIDTH, 3), np.float32), 3, 3000)[..., 0]
    # Of 7 x 11 windows of 3 x 4 pixels one holds a corner, twelve a pixel of the middle; each counts 126/12.
    assert share.mean() == pytest.approx(1, rel=1e-5)
    assert share[4, 6] == pytest.approx(12 / 77 * 10.5, rel=0.15) and share[0, 0] < 0.3


def test_every_offset_of_a_lattice_together_is_exactly_the_full_gradient():
    gradient, total = picture_gradient(6, 9), np.zeros((54, 3))
    seen: dict[bytes, np.ndarray] = {}
    for seed in range(200):
        pixels = drawn("dilated", seed, 3, 6, 9)
        seen[pixels.tobytes()] = pixels
    assert len(seen) == 9
    for pixels in seen.values():
        total[pixels] += selected_gradient(gradient, pixels, 0) / 9
    np.testing.assert_allclose(total.reshape(gradient.shape), gradient, rtol=1e-6)


@pytest.mark.parametrize("blur", [3, 5])
def test_a_blur_lets_chosen_pixels_speak_for_their_neighbors(blur):
    gradient, pixels, rim = picture_gradient(), drawn("dilated", 1), blur // 2
    found = selected_gradient(gradient, pixels, blur)
    padded = np.pad(gradient.astype(np.float64), ((rim, rim), (rim, rim), (0, 0)), mode="edge")
    for n, p in enumerate(pixels):
        i, j = divmod(int(p), WIDTH)
        expected = padded[i : i + blur, j : j + blur].mean((0, 1)) * HEIGHT * WIDTH / len(pixels)
        np.testing.assert_allclose(found[n], expected, rtol=1e-4, atol=1e-5)
    everything = np.arange(HEIGHT * WIDTH)
    assert np.array_equal(selected_gradient(gradient, everything, blur), gradient.reshape(-1, 3))
    assert found.dtype == np.float32 and found.flags["C_CONTIGUOUS"]


def test_changes_spread_linearly_between_the_pixels_of_a_lattice():
    """A plane in the picture comes back as itself within the lattice, and as its nearest place outside."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    plane = np.stack([2 + 0.5 * rows - columns, 3 * columns], -1)
    for seed in range(12):
        pixels = drawn("dilated", seed)
        at_rows, at_columns = np.divmod(pixels, WIDTH)
        spread = spread_over_picture(plane.reshape(-1, 2)[pixels], pixels, HEIGHT, WIDTH, 3)
        assert spread.shape == (HEIGHT * WIDTH, 2) and spread.dtype == np.float32
        near_row = np.clip(rows, at_rows.min(), at_rows.max())
        near_column = np.clip(columns, at_columns.min(), at_columns.max())
        expected = np.stack([2 + 0.5 * near_row - near_column, 3 * near_column], -1)
        assert np.abs(spread - expected.reshape(-1, 2)).max() < 1e-5


def test_a_change_spreads_from_a_single_pixel_over_a_small_picture():
    pixels = drawn("dilated", 0, 5, 2, 3)
    assert np.array_equal(spread_over_picture(np.float32([[4.0]]), pixels, 2, 3, 5), np.full((6, 1), 4.0, np.float32))
