"""Losses against slow loops in float64, gradients by finite differences."""

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.style import losses
from stylerf.style.feature_matching import StyleRows, style_rows, unit_rows


def features(shape: tuple[int, ...], seed: int) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) + 0.05


def test_nearest_neighbor_distance_equals_a_double_loop():
    content, style = features((4, 3, 5), 0), features((4, 6, 2), 1)
    distances, matches = losses.nearest_neighbor_distance(content, style_rows(style))
    expected = []
    for i in range(3):
        for j in range(5):
            f = content[:, i, j]
            cosines = [
                float(f @ style[:, a, b] / (f.norm() * style[:, a, b].norm())) for a in range(6) for b in range(2)
            ]
            expected.append(1 - max(cosines))
            assert matches[i * 5 + j] == int(np.argmax(cosines))
    np.testing.assert_allclose(distances.numpy(), expected, atol=1e-7)  # the 1e-8 in the norms


def test_its_gradient_and_that_of_other_losses():
    style = style_rows(features((4, 6, 2), 1))
    content = features((4, 3, 5), 0).requires_grad_()
    weights = features((3, 5), 2).round()
    gram = losses.gram_matrix(features((4, 6, 2), 1))
    reference = features((4, 3, 5), 3)
    checked = {
        "nnfm": lambda x: losses.nearest_neighbor_distance(x, style)[0],
        "weighted": lambda x: losses.nearest_neighbor_distance(x, style, weights)[0],
        "content": lambda x: losses.content_distance(x, reference),
        "gram": lambda x: losses.gram_distance(x, gram, weights),
        "variation": losses.image_variation,
        "diagonal": losses.diagonal_variation,
    }
    for name, loss in checked.items():
        assert torch.autograd.gradcheck(loss, (content,)), name


def test_gradients_are_finite_at_zero():
    flat = torch.zeros(3, 4, 4, dtype=torch.float64, requires_grad=True)
    style = StyleRows(unit_rows(torch.ones(2, 3, dtype=torch.float64)))
    distances, _ = losses.nearest_neighbor_distance(flat, style)
    total = distances.sum() + losses.diagonal_variation(flat).sum() + losses.image_variation(flat)
    (gradient,) = torch.autograd.grad(total, flat)
    assert float(distances.detach().min()) == 1 and torch.isfinite(gradient).all()


def test_a_transparent_background_takes_no_part():
    style = style_rows(features((4, 6, 2), 1))
    content = features((4, 3, 5), 0)
    weights = torch.ones(3, 5, dtype=torch.float64)
    weights[:, 3:] = 0
    weights[1, 1] = 0.25
    altered = content.clone()
    altered[:, :, 3:] = 7.0
    content.requires_grad_()
    distances, matches = losses.nearest_neighbor_distance(content, style, weights)
    assert distances.shape == matches.shape == (9,)
    assert torch.equal(distances, losses.nearest_neighbor_distance(altered, style, weights)[0])
    (gradient,) = torch.autograd.grad(distances.sum(), content)
    assert float(gradient[:, :, 3:].abs().max()) == 0 and float(gradient[:, :, :3].abs().min()) > 0
    plain, _ = losses.nearest_neighbor_distance(content[:, :, :3], style)
    expected = plain * weights[:, :3].flatten()
    torch.testing.assert_close(distances, expected)


def test_given_matches_are_used_instead_of_a_search():
    style, content = style_rows(features((4, 6, 2), 1)), features((4, 3, 5), 0)
    distances, found = losses.nearest_neighbor_distance(content, style)
    again, same = losses.nearest_neighbor_distance(content, style, matches=found)
    assert torch.equal(distances, again) and torch.equal(found, same)
    worse, _ = losses.nearest_neighbor_distance(content, style, matches=(found + 1) % 12)
    assert float(worse.sum()) > float(distances.sum())


def test_position_weights_reach_beside_the_object():
    alpha = torch.zeros(8, 12)
    alpha[2:4, 4:6] = 1  # one position of the 4 x 6 features
    found = losses.position_weights(alpha, torch.zeros(5, 4, 6), around=1)
    expected = torch.zeros(4, 6)
    expected[0:3, 1:4] = 1
    torch.testing.assert_close(found, expected)


def test_position_weights_average_the_pixels_they_stand_for():
    alpha = torch.zeros(8, 12)
    alpha[:, 6:] = 1
    alpha[0, 0] = 1
    found = losses.position_weights(alpha, torch.zeros(5, 2, 3))
    assert found.tolist() == [[1 / 16, 0.5, 1], [0, 0.5, 1]]


def test_taps_of_a_block_are_joined():
    found = losses.by_block(("conv2_2", "conv3_1", "conv3_2"), [torch.ones(1, c, 4, 5) * c for c in (2, 3, 4)])
    assert {name: tuple(value.shape) for name, value in found.items()} == {"conv2": (2, 4, 5), "conv3": (7, 4, 5)}
    assert float(found["conv3"][2, 0, 0]) == 3 and float(found["conv3"][3, 0, 0]) == 4


def test_gram_matrix_equals_a_loop_and_ignores_positions_of_no_weight():
    values = features((3, 2, 4), 5)
    expected = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            expected[a, b] = sum(float(values[a, i, j] * values[b, i, j]) for i in range(2) for j in range(4)) / 24
    np.testing.assert_allclose(losses.gram_matrix(values).numpy(), expected, rtol=1e-12)
    weights = torch.tensor([[1.0, 1, 0, 0], [1, 1, 0, 0]], dtype=torch.float64)
    torch.testing.assert_close(losses.gram_matrix(values, weights), losses.gram_matrix(values[:, :, :2]))
    with pytest.raises(InvalidValue):
        losses.gram_matrix(values, weights * 0)


def test_variations_by_hand():
    image = torch.zeros(3, 2, 3)
    image[0] = torch.tensor([[0.0, 1, 1], [0, 0, 3]])
    # channel 0: dx = 1, 0 / 0, 3 ; dy = 0, -1, 2 ; means over 3*2*2 and 3*1*3 entries
    assert float(losses.image_variation(image)) == pytest.approx(((1 + 9) / 12 + (1 + 4) / 9) / 2)
    expected = torch.tensor([[1.0, 1, 2], [0, 3, 0]])  # |dx + dy| per pixel, 0 past the border
    assert torch.equal(losses.diagonal_variation(image), expected)
    assert float(losses.content_distance(image, torch.zeros(3, 2, 3))[1, 2]) == 3
