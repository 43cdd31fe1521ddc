"""Photos brought to a painting's colors: what is background stays, edges included."""

import weakref

import numpy as np
import pytest
import torch

from stylerf.style.color_matching import match_colors
from stylerf.training.stylize import geometry, scene
from stylerf.training.stylize.scene import ObjectPhotos, StyledScene, rendered_match
from tests.stylerf.style.small_trunk import picture
from tests.stylerf.training.stylizing import new_color, problem, settings


def matched(photo: np.ndarray, alpha: np.ndarray, background: float, painting: torch.Tensor) -> np.ndarray:
    of_object = ObjectPhotos([photo], lambda view: alpha, np.float32(background))
    colors, weights = of_object.colors(0)
    return of_object.mapped(0, match_colors(colors, painting.flatten(1).T, weights))


@pytest.mark.parametrize("background", [0.0, 1.0])
def test_photos_in_their_own_colors_stay_even_where_half_covered(background):
    """Straight colors of two kinds, their mean and covariance those of the painting: the map is none."""
    generator = np.random.default_rng(0)
    straight = generator.random((20, 24, 3), dtype=np.float32)
    alpha = np.where(np.arange(24) < 8, 0.0, np.where(np.arange(24) < 16, 0.5, 1.0)).astype(np.float32)
    alpha = np.repeat(alpha[None], 20, 0)
    seen = straight[alpha > 0]
    weights = np.repeat(seen, (2 * alpha[alpha > 0]).astype(int), 0)  # the fully covered count twice
    painting = torch.from_numpy(weights.T[:, None].copy())
    photo = straight * alpha[..., None] + (1 - alpha[..., None]) * np.float32(background)
    np.testing.assert_allclose(matched(photo, alpha, background, painting), photo, atol=2e-5)


def test_a_half_covered_pixel_is_half_painting_half_background():
    photo = np.full((6, 6, 3), 0.5, np.float32)
    photo[:3] = np.random.default_rng(1).random((3, 6, 3), dtype=np.float32)
    alpha = np.full((6, 6), 0.5, np.float32)
    found = matched(photo, alpha, 1.0, picture(8, 8, 3))
    assert found.min() >= 0.5 - 1e-6 and found.max() <= 1 + 1e-6


def test_what_lies_beside_a_part_of_a_photo_stays_and_half_of_it_half():
    photo, alpha = picture(6, 8, 1).permute(1, 2, 0).numpy(), np.zeros((6, 8), np.float32)
    alpha[:3], alpha[3] = 1, 0.5
    of_part = ObjectPhotos([photo], lambda view: alpha, None)
    colors, weights = of_part.colors(0)
    found = of_part.mapped(0, match_colors(colors, torch.tensor([[0.2, 0.4, 0.6]] * 9), weights))
    np.testing.assert_array_equal(found[4:], photo[4:])
    wanted = np.array([0.2, 0.4, 0.6], np.float32)  # of a painting of one color
    np.testing.assert_allclose(found[:3], np.broadcast_to(wanted, (3, 8, 3)), atol=1e-2)
    np.testing.assert_allclose(found[3], (photo[3] + wanted) / 2, atol=1e-2)


def test_half_covered_pixels_count_where_there_are_no_others():
    """Haze, or rods thinner than a pixel, would otherwise end a stylization after its last step."""
    painting, colors = picture(16, 16, 5), picture(12, 12, 6).permute(1, 2, 0).numpy()

    def after(coverage: float, beside: float) -> np.ndarray:
        alpha = np.full((12, 12), coverage, np.float32)
        alpha[:6] = beside
        change = rendered_match([(colors * alpha[..., None], alpha)], painting, 0)
        return np.cov(change(torch.from_numpy(colors[6:].reshape(-1, 3)).double()).numpy().T, ddof=0)

    wanted = np.cov(painting.flatten(1).double().numpy(), ddof=0)
    np.testing.assert_allclose(after(0.3, 0.0), wanted, atol=1e-4)
    np.testing.assert_allclose(after(0.9, 0.4), wanted, atol=1e-4)  # the upper half does not count


def test_the_last_match_keeps_samples_of_renders_and_weighs_each_by_its_pixels(monkeypatch):
    """Of 400 red pixels and twice 100 blue ones, 20 of each picture are sampled, which stand for 2 to 1."""
    monkeypatch.setattr(scene, "SAMPLE", 60)
    made = []

    def render(color: list[float], side: int) -> tuple[np.ndarray, np.ndarray]:
        assert sum(other() is not None for other in made) <= 1  # the one before
        rgb = np.full((side, side, 3), color, np.float32)
        made.append(weakref.ref(rgb))
        return rgb, np.ones((side, side), np.float32)

    painting, shown = picture(16, 16, 5), (([1.0, 0, 0], 20), ([0, 0, 1.0], 10), ([0, 0, 1.0], 10))
    found = rendered_match((render(*one) for one in shown), painting, 0, 3)
    colors = torch.tensor([[1.0, 0, 0], [0, 0, 1]])
    expected = match_colors(colors, painting.flatten(1).T, torch.tensor([2.0, 1]))
    np.testing.assert_allclose(found(colors.double()), expected(colors.double()), atol=1e-6)


def test_a_view_that_no_cache_holds_is_marched_once_and_not_for_every_chunk(monkeypatch):
    marches, march = [], geometry.surface_of
    monkeypatch.setattr(geometry, "surface_of", lambda *given: marches.append(1) or march(*given))
    monkeypatch.setattr(scene, "PIXELS_AT_ONCE", 50)  # of 252
    one = StyledScene(problem(settings(), memory=0.0), new_color)
    for views, expected in (([0], 1), ([1, 1], 1), ([0, 1], 2)):
        marches.clear()
        for view in views:
            one.render_over(view)
        assert len(marches) == expected
