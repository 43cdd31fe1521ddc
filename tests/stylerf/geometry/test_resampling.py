"""Making pictures smaller and bending them: against OpenImageIO, closed forms and slow loops."""

import numpy as np
import OpenImageIO as oiio
import pytest

from stylerf.geometry.resampling import nearest, shrunk
from stylerf.kernels.cpu.photos import remapped

RANDOM = np.random.default_rng(3)


def test_integer_factors_are_plain_means_as_openimageio_makes_them():
    pixels = RANDOM.random((12, 20, 3), dtype=np.float32)
    box = oiio.ImageBufAlgo.resize(oiio.ImageBuf(pixels), "box", 0, oiio.ROI(0, 5, 0, 3))
    np.testing.assert_allclose(shrunk(pixels, (5, 3)), box.get_pixels(oiio.FLOAT), atol=1e-6)


@pytest.mark.parametrize("size", [(4, 3), (7, 5), (10, 7), (11, 2)])
def test_other_factors_are_area_averages(size):
    pixels = RANDOM.random((7, 11, 2), dtype=np.float32)
    fine = np.repeat(np.repeat(pixels.astype(np.float64), size[1], axis=0), size[0], axis=1)
    expected = fine.reshape(size[1], 7, size[0], 11, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(shrunk(pixels, size), expected, atol=1e-6)


def test_the_mean_of_the_picture_stays():
    pixels = RANDOM.random((53, 31, 4), dtype=np.float32)
    np.testing.assert_allclose(shrunk(pixels, (13, 17)).mean((0, 1)), pixels.mean((0, 1)), atol=1e-6)
    assert shrunk(pixels, (31, 53)) is pixels


def test_nearest_takes_the_pixel_under_each_center():
    values = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(nearest(values, (2, 3)), [[1, 3], [5, 7], [9, 11]])


def catmull_rom(values, t):
    a, b, c, d = values
    return 0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)


def test_remapped_is_catmull_rom():
    pixels = RANDOM.uniform(0.3, 0.7, (9, 8, 3)).astype(np.float32)
    positions = RANDOM.uniform([0.2, 0.2], [7.8, 8.8], (4, 5, 2)).astype(np.float32)
    found = remapped(pixels, positions)
    padded = np.pad(pixels.astype(np.float64), ((3, 3), (3, 3), (0, 0)), mode="edge")
    for i in range(4):
        for j in range(5):
            x, y = positions[i, j].astype(np.float64) - 0.5
            column, row = int(np.floor(x)), int(np.floor(y))
            patch = padded[row + 2 : row + 6, column + 2 : column + 6]
            along = [catmull_rom(line, x - column) for line in patch]
            np.testing.assert_allclose(found[i, j], catmull_rom(along, y - row), atol=2e-6)


def test_remapped_at_pixel_centers_is_the_picture_itself():
    pixels = RANDOM.random((6, 7, 3), dtype=np.float32)
    rows, columns = np.meshgrid(np.arange(6) + 0.5, np.arange(7) + 0.5, indexing="ij")
    np.testing.assert_allclose(remapped(pixels, np.stack([columns, rows], -1).astype(np.float32)), pixels, atol=1e-6)
