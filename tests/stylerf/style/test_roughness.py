"""Roughness of style images: by size, by stroke, without transparent parts."""

import numpy as np
import pytest
import torch

from stylerf.style.roughness import roughness


def noise(height: int, width: int, spread: float) -> torch.Tensor:
    """[3, height, width] gray noise of this standard deviation."""
    values = np.random.default_rng(0).normal(0.5, spread, (height, width)).astype(np.float32)
    return torch.from_numpy(np.broadcast_to(values, (3, height, width)).copy())


def test_a_flat_image_a_slope_and_a_broad_edge_are_smooth():
    flat, slope = torch.full((3, 40, 60), 0.3), torch.linspace(0, 1, 60).expand(3, 40, 60).contiguous()
    edge = torch.cat([torch.zeros(3, 40, 30), torch.ones(3, 40, 30)], 2)
    assert roughness(flat, 60) == 0 and roughness(edge, 60) == 0
    assert roughness(slope, 60) < 0.002


def test_noise_is_as_rough_as_its_spread_and_a_thin_line_counts():
    # |x - median of nine normals| has a mean of 0.79 standard deviations or so.
    assert roughness(noise(80, 120, 0.05), 120) == pytest.approx(0.037, rel=0.1)
    line = torch.zeros(3, 40, 60)
    line[:, 20] = 1
    assert roughness(line, 60) == pytest.approx(1 / 40)


def test_it_is_that_of_the_size_which_is_matched():
    """Half as large, neighbors of noise are averaged; twice as large, they are drawn out."""
    image = noise(80, 120, 0.1)
    small, own, large = (roughness(image, side) for side in (60, 120, 240))
    assert small < 0.7 * own and large < 0.7 * own
    assert roughness(image, 120, 2.0) == pytest.approx(large, rel=1e-5)


def test_of_a_large_picture_bands_are_looked_at(monkeypatch):
    image = noise(400, 600, 0.1)
    image[:, :200] *= 0.5  # less rough above
    whole = roughness(image, 600)
    monkeypatch.setattr("stylerf.style.roughness.MOST_PIXELS", 120_000)
    assert roughness(image, 600) == pytest.approx(whole, rel=0.05) and roughness(image, 600) != whole


def test_transparent_parts_do_not_count():
    image = torch.cat([noise(40, 60, 0.1), torch.ones(1, 40, 60)])
    image[3, :, 30:] = 0
    image[:3, :, 30:] = torch.rand(3, 40, 30, generator=torch.Generator().manual_seed(0))
    assert roughness(image, 60) == pytest.approx(roughness(image[:3, :, :30].contiguous(), 40), rel=0.05)
    image[3] = 0
    assert roughness(image, 60) == 0
