"""Sizes of the painting."""

import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.style import image_sizes


def test_halving_averages_and_stays_in_range():
    image = torch.rand(3, 64, 96, generator=torch.Generator().manual_seed(0))
    half = image_sizes.resized(image, 32, 48)
    # the antialiasing triangle at factor 2 weighs 1 3 3 1 along each axis
    padded = torch.tensor([1.0, 3, 3, 1]) / 8
    expected = torch.einsum("i,j,cij->c", padded, padded, image[:, 9:13, 19:23])
    torch.testing.assert_close(half[:, 5, 10], expected)
    assert float(half.min()) >= float(image.min()) and float(half.max()) <= float(image.max())
    assert image_sizes.resized(image, 64, 96) is image


def test_long_sides_and_scale():
    painting = torch.rand(3, 640, 1024)
    assert image_sizes.style_picture(painting, 378, 504).shape == (3, 158, 252)
    assert image_sizes.style_picture(painting, 800, 400, 1.0).shape == (3, 500, 800)
    assert image_sizes.fitted(torch.rand(3, 1, 900), 30).shape == (3, 1, 30)
    assert image_sizes.feature_size(378, 505, 0.5) == (189, 252)
    with pytest.raises(InvalidValue):
        image_sizes.resized(painting, 0, 5)
