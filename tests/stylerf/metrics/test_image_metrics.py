"""Image metrics against closed forms and a slow loop."""

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.metrics.images import content_ssim, mse, psnr, ssim, ssim_map


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


def test_ssim_of_colours_is_the_mean_of_channels_and_respects_a_mask():
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
