"""Color matching: statistics after it are the painting's, on colors and through spherical harmonics."""

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.style import color_matching


def colors(count: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    mixing = torch.rand(3, 3, generator=generator, dtype=torch.float64)
    return torch.rand(count, 3, generator=generator, dtype=torch.float64) @ mixing * 0.5 + 0.1


def test_matched_colors_have_exactly_the_mean_and_covariance_of_the_style():
    content, style = colors(500, 0), colors(700, 1)
    found = color_matching.match_colors(content, style)(content).numpy()
    np.testing.assert_allclose(found.mean(axis=0), style.numpy().mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(np.cov(found.T, bias=True), np.cov(style.numpy().T, bias=True), atol=1e-12)


def test_weights_count_pixels():
    content, style = colors(400, 2), colors(300, 3)
    weights = torch.randint(0, 4, (400,), generator=torch.Generator().manual_seed(0))
    repeated = torch.repeat_interleave(content, weights, dim=0)
    one, other = color_matching.match_colors(content, style, weights), color_matching.match_colors(repeated, style)
    torch.testing.assert_close(one.matrix, other.matrix)
    torch.testing.assert_close(one.offset, other.offset)


def test_colors_already_matched_stay_and_the_matrix_is_of_symmetric_roots():
    content = colors(400, 4)
    same = color_matching.match_colors(content, content)
    torch.testing.assert_close(same.matrix, torch.eye(3, dtype=torch.float64), atol=1e-9, rtol=0)
    root = color_matching.symmetric_power(color_matching.color_statistics(content)[1], 0.5)
    torch.testing.assert_close(root, root.T)
    torch.testing.assert_close(root @ root, color_matching.color_statistics(content)[1])


def test_a_gray_picture_stays_finite():
    gray = torch.linspace(0, 1, 50, dtype=torch.float64)[:, None].expand(50, 3)
    found = color_matching.match_colors(gray, colors(300, 5))
    assert torch.isfinite(found.matrix).all()
    torch.testing.assert_close(found(gray).mean(dim=0), colors(300, 5).mean(dim=0))
    assert torch.isfinite(color_matching.match_colors(torch.full((9, 3), 0.5), colors(300, 5)).matrix).all()


def test_noise_of_a_gray_picture_does_not_become_colors():
    """Grays with one code value of noise a channel: exactly matched, the noise would grow a hundredfold."""
    generator = torch.Generator().manual_seed(16)
    gray = torch.linspace(0.1, 0.9, 3000, dtype=torch.float64)[:, None]
    noisy = gray + (torch.rand(3000, 3, generator=generator, dtype=torch.float64) - 0.5) / 127.5
    assert float(torch.linalg.svdvals(color_matching.match_colors(noisy, colors(300, 5)).matrix).max()) < 40
    tinted = gray * torch.tensor([1.0, 0.9, 0.8]) + 0.02 * torch.randn(3000, 3, generator=generator).double()
    found = color_matching.match_colors(tinted, colors(300, 5))
    torch.testing.assert_close(found(tinted).T.cov(correction=0), colors(300, 5).T.cov(correction=0))


def test_maps_compose_and_act_on_images_and_premultiplied_colors():
    first, second = (color_matching.match_colors(colors(300, a), colors(300, a + 1)) for a in (9, 11))
    sample = colors(10, 13)
    torch.testing.assert_close(second.after(first)(sample), second(first(sample)))
    image = sample[:6].T.reshape(3, 2, 3).float()
    torch.testing.assert_close(
        first.image(image).flatten(1).T, first(sample[:6].float()).clamp(0, 1), atol=1e-6, rtol=0
    )
    alpha = torch.linspace(0, 1, 10, dtype=torch.float64)
    torch.testing.assert_close(first.premultiplied(sample * alpha[:, None], alpha), first(sample) * alpha[:, None])


def test_pixels_are_sampled_with_their_alpha():
    images = [torch.rand(4, 50, 40), torch.rand(3, 20, 10)]
    everything, weights = color_matching.pixels_of(images)
    assert everything.shape == (2200, 3) and weights.shape == (2200,)
    assert torch.equal(weights[:2000], images[0][3].flatten()) and float(weights[2000:].min()) == 1
    few, _ = color_matching.pixels_of(images, most=220)
    assert few.shape == (220, 3) and torch.equal(few, color_matching.pixels_of(images, most=220)[0])


def test_samples_are_drawn_from_pixels_that_count_alone():
    """An object seen by one view in four, in a hundredth of its pixels: its own pixels are sampled, as often each."""
    images = [torch.zeros(4, 100, 100) for _ in range(4)]
    images[2][:, 50:60, 20:30] = 1
    found, weights = color_matching.pixels_of(images, most=50)
    assert len(found) == len(weights) == 50 and weights.min() == found.min() == 1
    images[0][3, :, 0:3] = 0.5  # three times as many pixels
    found, weights = color_matching.pixels_of(iter(images), most=100, count=400)
    assert (weights == 0.5).sum() == 75 and (weights == 1).sum() == 25


def test_where_every_pixel_counts_alpha_changes_no_draw():
    image = torch.rand(3, 30, 40, generator=torch.Generator().manual_seed(1))
    opaque = torch.cat([image, torch.ones(1, 30, 40)])
    plain, opaque = (color_matching.pixels_of([one], most=99)[0] for one in (image, opaque))
    drawn = torch.randint(1200, (99,), generator=torch.Generator().manual_seed(0))
    assert torch.equal(plain, image.flatten(1).T[drawn]) and torch.equal(opaque, plain)


def test_nonsense_is_refused():
    for wrong in (torch.zeros(0, 3), torch.zeros(5, 4), torch.full((5, 3), torch.nan)):
        with pytest.raises(InvalidValue):
            color_matching.match_colors(wrong, colors(10, 0))
    with pytest.raises(InvalidValue):
        color_matching.match_colors(colors(10, 0), colors(10, 1), torch.zeros(10))


def test_a_style_image_takes_the_weighted_mean_and_covariance_of_colors():
    painting = torch.rand(3, 20, 30, generator=torch.Generator().manual_seed(5))
    generator = np.random.default_rng(0)
    axes = np.array([[1, 0.5, 0], [0, 1, 0], [0, 0.2, 0.5]])
    colors = (0.5 + 0.08 * generator.normal(size=(4000, 3)) @ axes).astype(np.float32)
    weights = np.ones(4000, np.float32)
    weights[::2] = 0
    colors[::2] = 0.9  # what has no weight
    taken = color_matching.in_colors_of(painting, torch.from_numpy(colors), torch.from_numpy(weights))
    pixels = taken.flatten(1).T.numpy()
    np.testing.assert_allclose(pixels.mean(0), colors[1::2].mean(0), atol=2e-3)
    np.testing.assert_allclose(np.cov(pixels.T), np.cov(colors[1::2].T), atol=5e-4)
