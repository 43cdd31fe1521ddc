"""Sizes of the painting."""

import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.style import images


def test_halving_averages_and_stays_in_range():
    image = torch.rand(3, 64, 96, generator=torch.Generator().manual_seed(0))
    half = images.resized(image, 32, 48)
    # the antialiasing triangle at factor 2 weighs 1 3 3 1 along each axis
    padded = torch.tensor([1.0, 3, 3, 1]) / 8
    expected = torch.einsum("i,j,cij->c", padded, padded, image[:, 9:13, 19:23])
    torch.testing.assert_close(half[:, 5, 10], expected)
    assert float(half.min()) >= float(image.min()) and float(half.max()) <= float(image.max())
    assert images.resized(image, 64, 96) is image


def test_long_sides_and_scale():
    painting = torch.rand(3, 640, 1024)
    assert images.style_picture(painting, 378, 504).shape == (3, 158, 252)
    assert images.style_picture(painting, 800, 400, 1.0).shape == (3, 500, 800)
    assert images.fitted(torch.rand(3, 1, 900), 30).shape == (3, 1, 30)
    assert images.feature_size(378, 505, 0.5) == (189, 252)
    with pytest.raises(InvalidValue):
        images.resized(painting, 0, 5)
