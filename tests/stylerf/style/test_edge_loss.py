"""Missing edges of the photo, and grain beyond the style image's."""

import numpy as np
import pytest
import torch

from stylerf.style import edge_loss


def test_missing_edges_are_those_of_the_photo_that_an_image_lacks():
    ramp = torch.linspace(0, 0.9, 32).expand(3, 24, 32)
    wanted = edge_loss.luma_gradient(ramp)
    step = 4 * 0.9 / 31  # of luma from cell to cell, in 7 of 8 columns
    enough = edge_loss.EDGE_CONTRAST
    plain = float(edge_loss.missing_edges(torch.zeros(3, 24, 32), wanted))
    assert plain == pytest.approx(enough * step * 7 / 8, rel=1e-3)
    assert float(edge_loss.missing_edges(enough * ramp, wanted)) == pytest.approx(0, abs=1e-6)
    assert float(edge_loss.missing_edges(0.8 * enough * ramp, wanted)) == pytest.approx(0.2 * plain, rel=1e-3)
    down = torch.linspace(0, 0.5, 24)[:, None].expand(3, 24, 32)
    assert float(edge_loss.missing_edges(ramp + down, wanted)) == pytest.approx(0, abs=1e-6)  # more is free
    turned = float(edge_loss.missing_edges(ramp.flip(2), wanted))
    assert turned == pytest.approx(edge_loss.PAINTED * (1 + enough) * step * 7 / 8, rel=1e-3)
    grain = 0.05 * torch.randn(3, 24, 32, generator=torch.Generator().manual_seed(0))
    assert float(edge_loss.missing_edges(grain, wanted)) > 0.9 * plain  # grain makes no edges
    left = torch.zeros(24, 32)
    left[:, :16] = 1
    half = torch.cat([ramp[:, :, :20], torch.zeros(3, 24, 12)], dim=2)
    assert float(edge_loss.missing_edges(half, wanted, left)) == pytest.approx(0, abs=1e-6)


def test_missing_edges_weigh_most_where_a_picture_is_blank():
    photo = edge_loss.luma_gradient(torch.linspace(0, 0.9, 96).expand(3, 64, 96))
    length = torch.linalg.vector_norm(photo, dim=0)
    floor = edge_loss.PAINTED
    for share, expected in ((0, 1), (0.5, 1), (0.75, (1 + floor) / 2), (1, floor), (3, floor)):
        found = edge_loss.blank_weights(share * photo.flip(0), length)  # in any direction
        torch.testing.assert_close(found, torch.full_like(length, expected))
    left = photo.clone()
    left[:, :, 12:] = 0  # strokes count only nearby
    found = edge_loss.blank_weights(left, length)
    assert (found[:, :10] == floor).all() and (found[:, 14:] == 1).all()
    image = torch.rand(3, 64, 96, generator=torch.Generator().manual_seed(0), requires_grad=True)
    assert not edge_loss.blank_weights(edge_loss.luma_gradient(image), length).requires_grad
    black = edge_loss.blank_weights(torch.zeros_like(photo), torch.zeros_like(length))
    assert torch.isfinite(black).all()


def test_strokes_may_replace_edges_that_plain_paint_may_not():
    """Of two pictures without the photo's edges, the plain one misses more."""
    wanted = edge_loss.luma_gradient(torch.linspace(0, 0.9, 96).expand(3, 64, 96))
    across = torch.linspace(0, 0.9, 64)[:, None].expand(3, 64, 96)
    plain, painted = (float(edge_loss.missing_edges(image, wanted)) for image in (torch.zeros(3, 64, 96), across))
    assert painted == pytest.approx(edge_loss.PAINTED * plain, rel=1e-3)


def bar(deviation: float) -> torch.Tensor:
    """A white bar on black, with noise; its edges are inside of cells."""
    image = torch.zeros(3, 64, 96)
    image[:, :, 31:61] = 1
    return image + deviation * torch.randn(1, 64, 96, generator=torch.Generator().manual_seed(0))


def test_grain_is_what_gradients_exceed_those_of_the_style_image_by():
    clean, noisy = (edge_loss.style_gradients(bar(deviation), edge_loss.GRAIN_CELL) for deviation in (0, 0.1))
    assert clean[0] == 0 < clean[-1] and (clean.diff() >= 0).all()
    assert float(edge_loss.grain(bar(0), clean)) == float(edge_loss.grain(bar(0), noisy)) == 0
    for contrast in (0.3, 3.0):
        assert float(edge_loss.grain(contrast * bar(0.1), noisy)) == pytest.approx(0, abs=1e-6)
    stronger = float(edge_loss.grain(bar(0.1), 3 * noisy))
    assert stronger == pytest.approx(0, abs=1e-6)  # a style image of more contrast allows more
    assert float(edge_loss.grain(3 * bar(0.1), clean)) > 2.9 * float(edge_loss.grain(bar(0.1), clean))
    assert float(edge_loss.grain(bar(0.1), clean)) > 1.5 * float(edge_loss.grain(bar(0.05), clean)) > 0.01


def test_grain_equals_a_comparison_of_sorted_gradients():
    style, image = bar(0.02), bar(0.1)
    ranks = np.linspace(0, edge_loss.HIGHEST, edge_loss.RANKS)
    allowed = edge_loss.style_gradients(style, edge_loss.GRAIN_CELL)
    found = np.sort(edge_loss.gradient_lengths(image).numpy().ravel())
    at = np.linspace(0, 1, len(found))
    scale = max(1, np.quantile(found, edge_loss.HIGHEST) / float(allowed[-1]))
    excess = np.maximum(found - scale * np.interp(at, ranks, allowed.numpy()), 0)[at < edge_loss.HIGHEST]
    expected = excess.sum() / len(found)
    assert expected > 0
    assert float(edge_loss.grain(image, allowed)) == pytest.approx(expected, rel=0.05)


def test_less_grain_leaves_edges():
    image = bar(0.05).requires_grad_()
    edge_loss.grain(image, edge_loss.style_gradients(bar(0), edge_loss.GRAIN_CELL)).backward()
    slope = image.grad.abs().sum((0, 1))
    assert (slope[:28] > 0).all() and (slope[34:58] > 0).all()
    steeper = image.detach() - 1e3 * image.grad
    across = steeper[0].mean(0)
    assert float(across[32:60].mean() - across[:30].mean()) > 0.95


def test_grain_counts_only_within_the_object():
    alpha = torch.zeros(64, 96)
    alpha[:, :64] = 1
    allowed = edge_loss.style_gradients(torch.cat([bar(0), alpha[None]]), edge_loss.GRAIN_CELL)
    mixed = torch.cat([bar(0)[:, :, :66], bar(0.2)[:, :, 66:]], dim=2)  # cells are compared with the next
    assert float(edge_loss.grain(mixed, allowed)) > 0.01
    assert float(edge_loss.grain(mixed, allowed, alpha)) == pytest.approx(0, abs=1e-6)
    assert float(edge_loss.grain(mixed, allowed, torch.zeros(64, 96))) == 0


def test_a_style_image_without_edges_says_nothing_of_grain():
    for plain in (torch.full((3, 64, 96), 0.5), torch.cat([bar(0), torch.zeros(1, 64, 96)])):
        allowed = edge_loss.style_gradients(plain, edge_loss.GRAIN_CELL)
        assert allowed.isinf().all()
        assert float(edge_loss.grain(bar(0.1), allowed)) == pytest.approx(0, abs=1e-6)


def test_edges_are_wanted_only_as_far_as_the_style_image_has_such():
    photo = edge_loss.luma_gradient(bar(0.1))
    found = {}
    for deviation in (0, 0.02, 0.3):
        style = edge_loss.style_gradients(bar(deviation), edge_loss.EDGE_CELL)
        found[deviation] = edge_loss.possible_edges(photo, style)
    lengths = {key: torch.linalg.vector_norm(edges, dim=0) for key, edges in found.items()}
    weak = lengths[0.3] < 0.15
    torch.testing.assert_close(found[0.3], photo)  # a rough style image has them all
    medians = [float(lengths[deviation][weak].median()) for deviation in (0, 0.02, 0.3)]
    assert 0 == medians[0] < medians[1] < medians[2]
    torch.testing.assert_close(found[0][:, lengths[0.3] > 0.6], photo[:, lengths[0.3] > 0.6])  # hard edges stay
    everything = edge_loss.style_gradients(torch.zeros(3, 64, 96), edge_loss.EDGE_CELL)
    torch.testing.assert_close(edge_loss.possible_edges(photo, everything), photo)
