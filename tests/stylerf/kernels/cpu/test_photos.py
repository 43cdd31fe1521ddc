"""Rays and colors of chosen pixels against the cameras' own rays and the images themselves."""

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.training.common.even_draws import drawn_evenly
from stylerf.training.common.ray_dataset import RayDataset


def camera(index: int, width: int, height: int) -> Camera:
    angle = 0.7 * index
    center = np.array([3 * np.cos(angle), 3 * np.sin(angle), 1.0 + 0.3 * index])
    pose = look_at(center, np.array([0.1, 0.2, 0]), np.array([0, 0, 1.0]))
    return Camera(f"v{index}", width, height, 20.0 + index, 22.0, width / 2 + 0.7, height / 2 - 1.2, pose)


def bank_of(channels: int) -> tuple[RayDataset, list[np.ndarray]]:
    sizes = [(7, 5), (4, 9), (6, 6)]
    generator = np.random.default_rng(channels)
    images = [generator.integers(0, 256, (h, w, channels), dtype=np.uint8) for w, h in sizes]
    return RayDataset([camera(i, *size) for i, size in enumerate(sizes)], images), images


@pytest.mark.parametrize("channels", [3, 4])
def test_every_pixel_of_every_view(channels):
    bank, images = bank_of(channels)
    for view, image in enumerate(images):
        pixels = np.arange(image.shape[0] * image.shape[1])
        origins, directions, colors = bank.at(np.full(len(pixels), view), pixels)
        expected = bank.cameras[view].rays()
        np.testing.assert_allclose(origins, expected[0], atol=1e-6)
        np.testing.assert_allclose(directions, expected[1], atol=1e-6)
        rgba = np.full((len(pixels), 4), 255.0)
        rgba[:, :channels] = image.reshape(-1, channels)
        np.testing.assert_allclose(colors, rgba / 255, atol=1e-7)
        assert colors.max() <= 1


def test_drawn_rays_belong_to_their_views_and_to_the_first_ones_only():
    bank, images = bank_of(3)
    origins, _, colors, views = bank.draw(4000, np.random.default_rng(0), among=2)
    assert set(views) == {0, 1} and len(bank) == 35 + 36 + 36
    centers = np.array([c.center for c in bank.cameras])
    np.testing.assert_allclose(origins, centers[views], atol=1e-6)
    # Every pixel alike: 4000 draws of 71 pixels give view 0 a share of 35/71.
    assert abs((views == 0).mean() - 35 / 71) < 0.03
    seen = {tuple(c) for c in np.round(colors[views == 1, :3] * 255).astype(int)}
    assert seen == {tuple(c) for c in images[1].reshape(-1, 3).astype(int)}


def test_rays_near_an_object_are_drawn_more_often():
    images = [np.zeros((40, 40, 4), np.uint8) for _ in range(2)]
    for image in images:
        image[10:12, 10:12] = 255
    bank = RayDataset([camera(i, 40, 40) for i in range(2)], images)
    _, _, colors, views = bank.draw(5000, np.random.default_rng(0), lit_share=0.9)
    # Two rounds of dilation by a cross around 2x2 pixels light 4 + 8 + 12 = 24 of the 1600; 4 of these are opaque.
    assert abs((colors[:, 3] == 1).mean() - (0.9 * 4 / 24 + 0.1 * 4 / 1600)) < 0.02
    assert abs(views.mean() - 0.5) < 0.03
    # A batch that continues another's draws starts where that one ended, near the object and in all.
    batches = (0, 700), (700, 300)
    parts = [bank.choose(count, np.random.default_rng(0), earlier=at) for at, count in batches]
    numbers = np.concatenate([views * 1600 + pixels for views, pixels in parts])
    lit = bank.lit[np.arange(48)]
    generator = np.random.default_rng(0)
    assert np.array_equal(numbers[np.r_[:630, 700:970]], lit[drawn_evenly(900, 48, generator)])
    assert np.array_equal(numbers[np.r_[630:700, 970:1000]], drawn_evenly(100, 3200, generator))
    _, _, colors, _ = bank.draw(5000, np.random.default_rng(0), lit_share=0.0)
    assert (colors[:, 3] == 1).mean() < 0.01


def test_an_image_that_does_not_fit_its_camera_is_refused():
    with pytest.raises(InvalidValue, match="v0"):
        RayDataset([camera(0, 7, 5)], [np.zeros((7, 5, 3), np.uint8)])
    with pytest.raises(InvalidValue, match="v0"):
        RayDataset([camera(0, 7, 5)], [np.zeros((5, 7, 3), np.float32)])
