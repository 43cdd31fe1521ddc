"""Faults of photos: what a regression, a closed form, Pillow and another blur find in them."""

import io

import numpy as np
import pytest
from PIL import Image
from skimage.filters import gaussian

from schemas.images import linear_from_srgb, srgb_from_linear
from stylerf import srgb
from stylerf.corruption import photos


def photo(seed: int = 0, channels: int = 3) -> np.ndarray:
    """Smooth, so that an encoder has something to keep; no value near white."""
    rows, columns = np.mgrid[0:40, 0:48]
    phases = np.arange(channels) + seed
    return (0.35 + 0.2 * np.sin(rows[..., None] / 6 + columns[..., None] / 9 + phases)).astype(np.float32)


def test_a_regression_recovers_the_drift_of_exposure():
    """log2 of the ratio of light between a faulty photo and the photo, against its place: slope and ends."""
    stops = photos.exposure_stops(9, 0.75, np.random.default_rng(1))
    found = []
    for place, one in enumerate(stops):
        clean = photo(place)
        faulty = srgb.exposed(clean, float(one))
        ratio = linear_from_srgb(faulty.astype(np.float64)) / linear_from_srgb(clean.astype(np.float64))
        found.append(np.log2(ratio).mean())
        assert np.log2(ratio).std() < 1e-4
    slope, start = np.polyfit(np.linspace(0, 1, 9), found, 1)
    assert abs(slope) == pytest.approx(1.5, abs=1e-4) and start == pytest.approx(-slope / 2, abs=1e-4)
    assert {np.sign(photos.exposure_stops(3, 1.0, np.random.default_rng(i))[0]) for i in range(20)} == {-1, 1}


def test_light_beyond_white_is_clipped_and_alpha_is_not_light():
    faulty = srgb.exposed(np.full((2, 2, 4), 0.9, np.float32), 2.0)
    assert (faulty[..., :3] == 1).all() and (faulty[..., 3] == np.float32(0.9)).all()
    values = np.linspace(0, 1, 300)
    np.testing.assert_allclose(srgb.decoded(values), linear_from_srgb(values), atol=1e-12)
    np.testing.assert_allclose(srgb.encoded(values), srgb_from_linear(values), atol=1e-12)


def test_blur_is_the_gaussian_of_another_library_and_keeps_light():
    clean = np.random.default_rng(2).random((30, 34, 3)).astype(np.float32)
    blurred = photos.blurred(clean, 1.5)
    np.testing.assert_allclose(blurred, gaussian(clean, 1.5, mode="reflect", channel_axis=-1), atol=1e-5)
    np.testing.assert_allclose(blurred.mean((0, 1)), clean.mean((0, 1)), atol=1e-5)
    point = np.zeros((61, 61, 3), np.float32)
    point[30, 30] = 1
    weights = photos.blurred(point, 3.0)[..., 0]
    assert (weights * (np.arange(61) - 30.0) ** 2).sum() / weights.sum() == pytest.approx(9.0, rel=0.02)


def test_blur_does_not_mix_in_colors_that_are_not_seen():
    """A red half beside green that is fully transparent: red stays red where its coverage fades."""
    picture = np.zeros((20, 20, 4), np.float32)
    picture[:, :10] = [1, 0, 0, 1]
    picture[:, 10:] = [0, 1, 0, 0]
    blurred = photos.blurred(picture, 2.0)
    seen = blurred[..., 3] > 1e-3
    np.testing.assert_allclose(blurred[seen][:, :3], np.broadcast_to([1, 0, 0], (seen.sum(), 3)), atol=1e-4)
    assert 0.3 < blurred[10, 10, 3] < 0.5


@pytest.mark.parametrize("quality", [10, 90])
def test_jpeg_is_pillows_round_trip(quality):
    clean = photo(3, 4)
    stored = io.BytesIO()
    Image.fromarray(np.rint(clean[..., :3] * 255).astype(np.uint8)).save(
        stored, format="JPEG", quality=quality, subsampling="4:2:0"
    )
    expected = np.asarray(Image.open(io.BytesIO(stored.getvalue())))
    faulty = photos.through_jpeg(clean, quality)
    np.testing.assert_array_equal(np.rint(faulty[..., :3] * 255), expected)
    np.testing.assert_array_equal(faulty[..., 3], clean[..., 3])


def test_less_quality_is_more_noise():
    clean = photo(4) + 0.1 * np.random.default_rng(5).random((40, 48, 3)).astype(np.float32)
    errors = [np.abs(photos.through_jpeg(clean, quality) - clean).mean() for quality in (10, 40, 90)]
    assert errors[0] > 1.3 * errors[1] > 1.3 * errors[2]
