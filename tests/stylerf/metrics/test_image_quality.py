"""Image metrics against closed forms and a slow loop."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from stylerf.errors import InvalidValue
from stylerf.metrics.image_quality import content_ssim, explained_structure, mse, psnr, shift_between, ssim, ssim_map


def test_psnr_of_a_constant_offset_is_known():
    a = np.full((8, 9, 3), 0.5)
    assert psnr(a, a + 0.1) == pytest.approx(20.0, abs=1e-9)  # -10 log10(0.01)
    assert mse(a, a + 0.1) == pytest.approx(0.01)
    assert psnr(a, a) == float("inf")


def test_mask_counts_only_its_pixels_and_weights():
    a, b = np.zeros((4, 5, 3)), np.zeros((4, 5, 3))
    b[0, 0], b[1, 1] = 0.2, 0.4
    mask = np.zeros((4, 5))
    mask[0, 0], mask[1, 1] = 3, 1
    assert mse(a, b, mask) == pytest.approx((3 * 0.04 + 0.16) / 4)
    assert mse(a, b, mask == 3) == pytest.approx(0.04)
    with pytest.raises(InvalidValue):
        mse(a, b, np.zeros((4, 5)))


def slow_ssim_at(a, b, row, column):
    """Wang et al. 2004, one window, written out."""
    offsets = np.arange(-5, 6)
    kernel = np.exp(-(offsets[:, None] ** 2 + offsets[None] ** 2) / (2 * 1.5**2))
    kernel /= kernel.sum()
    x = a[row - 5 : row + 6, column - 5 : column + 6]
    y = b[row - 5 : row + 6, column - 5 : column + 6]
    mx, my = (kernel * x).sum(), (kernel * y).sum()
    vx, vy = (kernel * (x - mx) ** 2).sum(), (kernel * (y - my) ** 2).sum()
    cross = (kernel * (x - mx) * (y - my)).sum()
    c1, c2 = 0.01**2, 0.03**2
    return (2 * mx * my + c1) * (2 * cross + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))


def test_ssim_agrees_with_the_formula_written_out():
    random = np.random.default_rng(3)
    a = random.random((17, 19))
    b = np.clip(a + 0.1 * random.standard_normal(a.shape), 0, 1)
    full = ssim_map(a, b)
    for row, column in [(5, 5), (8, 11), (11, 13)]:
        assert full[row, column] == pytest.approx(slow_ssim_at(a, b, row, column), abs=1e-9)
    inner = [slow_ssim_at(a, b, r, c) for r in range(5, 12) for c in range(5, 14)]
    assert ssim(a, b) == pytest.approx(np.mean(inner), abs=1e-9)


def test_ssim_of_colors_is_the_mean_of_channels_and_respects_a_mask():
    random = np.random.default_rng(4)
    a, b = random.random((20, 20, 3)), random.random((20, 20, 3))
    assert ssim(a, b) == pytest.approx(np.mean([ssim(a[..., i], b[..., i]) for i in range(3)]))
    b[:, :10] = a[:, :10]
    left = np.zeros((20, 20), bool)
    left[:, :5] = True  # only border columns: nothing of the interior is left
    with pytest.raises(InvalidValue):
        ssim(a, b, left)
    left[:, 5] = True  # its window ends at column 10, of which the weight is smallest
    assert ssim(a, b, left) > 0.95 > ssim(a, b)


def test_content_ssim_ignores_a_change_that_keeps_luma():
    random = np.random.default_rng(5)
    photo = 0.3 + 0.4 * random.random((24, 24, 3))
    shifted = photo + np.array([0.2, -0.2 * 0.2126 / 0.7152, 0.0])
    assert content_ssim(shifted, photo) == pytest.approx(1.0, abs=1e-6)
    assert ssim(shifted, photo) < 0.99


def test_not_finite_and_unequal_sizes_are_refused():
    good = np.zeros((12, 12, 3))
    bad = good.copy()
    bad[3, 3, 1] = np.nan
    for metric in (mse, psnr, ssim):
        with pytest.raises(InvalidValue, match="1 values"):
            metric(good, bad)
        with pytest.raises(InvalidValue):
            metric(good, np.zeros((12, 13, 3)))
    with pytest.raises(InvalidValue):
        ssim(good[:10], good[:10])


def test_explained_structure_is_that_of_a_line_in_each_window():
    """Written out at every pixel; whole of any straight line, rising or falling; none of a flat picture."""
    generator = np.random.default_rng(3)
    photo, other = generator.random((20, 24, 3)), generator.random((20, 24, 3))
    assert explained_structure(0.2 + 0.5 * photo, photo) == pytest.approx(1, abs=2e-3)
    assert explained_structure(1 - photo, photo) == pytest.approx(1, abs=2e-3)
    assert explained_structure(np.full_like(photo, 0.4), photo) < 1e-12
    half = np.concatenate([photo[:, :12], np.full((20, 12, 3), 0.4)], 1)
    assert 0.4 < explained_structure(half, photo) < 0.6

    weights = np.array([0.2126, 0.7152, 0.0722])
    render, wanted, sigma = other @ weights, photo @ weights, 0.05 * 24
    reach = int(3.5 * sigma + 0.5)
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    window = np.outer(taps, taps) / taps.sum() ** 2
    mirrored = [np.pad(x, reach, mode="symmetric") for x in (render, wanted)]
    explained = of_wanted = 0.0
    for row in range(20):
        for column in range(24):
            r, p = (x[row : row + len(window), column : column + len(window)] for x in mirrored)
            r, p = r - (window * r).sum(), p - (window * p).sum()
            explained += (window * r * p).sum() ** 2 / ((window * r * r).sum() + 1 / 255**2)
            of_wanted += (window * p * p).sum()
    expected = explained / 480 / (of_wanted / 480 + 1 / 255**2)
    assert explained_structure(other, photo) == pytest.approx(expected, rel=1e-6) and expected < 0.2


def test_explained_structure_ignores_smooth_and_masked_pixels():
    generator = np.random.default_rng(4)
    photo = np.full((40, 40, 3), 0.5)
    photo[:, :16] = generator.random((40, 16, 3))
    strokes = photo.copy()
    strokes[:, 24:] = generator.random((40, 16, 3))
    assert ssim(strokes, photo) < 0.7 and explained_structure(strokes, photo) > 0.98
    textured = generator.random((40, 40, 3))
    half, mask = textured.copy(), np.zeros((40, 40))
    half[:, 20:], mask[:, :12] = 0.5, 1
    assert explained_structure(half, textured, mask) > 0.98 and explained_structure(half, textured) < 0.7


def waves(right: float = 0.0, down: float = 0.0, size: tuple[int, int] = (96, 128), seed: int = 0) -> np.ndarray:
    """[h, w]: forty waves of 6 to 40 pixels, moved exactly."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[: size[0], : size[1]].astype(float)
    out = np.zeros(size)
    for length, angle, phase in zip(random.uniform(6, 40, 40), *random.uniform(0, 2 * np.pi, (2, 40))):
        along = np.cos(angle) * (columns - right) + np.sin(angle) * (rows - down)
        out += np.sin(2 * np.pi * along / length + phase)
    return 0.5 + 0.05 * out


@pytest.mark.parametrize("moved", [(0, 0), (0.4, 0), (0, -0.7), (1.3, -2.6), (-9, 5.5), (20, -17)])
def test_a_shift_is_found_to_a_tenth_of_a_pixel(moved):
    found, alike = shift_between(waves(), waves(*moved))
    assert found == pytest.approx(moved, abs=0.1 + 0.02 * np.hypot(*moved))
    assert alike > (0.97 if np.hypot(*moved) < 1 else 0.6)


@pytest.mark.parametrize("moved", [(0, 0), (1.3, -2.6)])
@pytest.mark.parametrize("blur", [1, 3])
def test_blur_and_exposure_move_nothing(moved, blur):
    """A render of a coarse field of right poses is blurred, and not shifted."""
    found, _ = shift_between(waves(), 0.1 + 0.5 * gaussian_filter(waves(*moved), blur))
    assert found == pytest.approx(moved, abs=0.2)


def test_pictures_of_different_things_are_not_alike():
    assert max(shift_between(waves(seed=seed), waves(seed=seed + 1))[1] for seed in range(4)) < 0.5


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (24, 16)])
def test_a_plain_picture_has_no_shift(size):
    found, alike = shift_between(np.full(size, 0.5), waves(size=size))
    assert found.tolist() == [0, 0] and alike == 0


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (2, 3), (3, 200)])
def test_a_picture_of_any_size_lies_on_itself(size):
    picture = np.random.default_rng(0).random(size)
    found, alike = shift_between(picture, picture)
    assert np.abs(found).max() <= 0.5 and (alike == pytest.approx(1) or size == (1, 1))
