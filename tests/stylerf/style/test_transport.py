"""Transport targets against a dense solution, and what diversity does."""

import numpy as np
import pytest
import torch

from stylerf.style import transport
from stylerf.style.feature_matching import unit_rows
from stylerf.style.transport import transport_targets


def rows(count: int, seed: int, channels: int = 6) -> torch.Tensor:
    return unit_rows(torch.randn(count, channels, generator=torch.Generator().manual_seed(seed)))


def dense_targets(content, style, diversity, source, rounds):
    """The same fixed point by dense matrices in float64; every style row is an edge."""
    f, s = content.double().numpy(), style.double().numpy()
    kernel = np.exp((f @ s.T - 1) / transport.BLUR)
    wanted, v = np.full(len(s), 1 / len(s)), np.ones(len(s))
    for _ in range(rounds):
        u = source / (kernel @ v)
        v = (wanted / (kernel.T @ u)) ** (diversity / (diversity + transport.BLUR))
    plan = kernel * v
    return plan / plan.sum(1, keepdims=True) @ s


@pytest.mark.parametrize("diversity", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("weighted", [False, True])
def test_targets_are_those_of_a_dense_plan(diversity, weighted):
    content, style = rows(30, 1), rows(12, 2)
    weights = torch.rand(30, generator=torch.Generator().manual_seed(3)) + 0.1 if weighted else None
    source = np.full(30, 1 / 30) if weights is None else (weights / weights.sum()).double().numpy()
    found = transport_targets(content, style, diversity, weights)
    expected = dense_targets(content, style, diversity, source, transport.ROUNDS)
    np.testing.assert_allclose(found.numpy(), expected, atol=2e-5)


def test_features_of_the_style_image_itself_are_matched_with_themselves():
    style = torch.eye(8)
    assert float((style * transport_targets(style, style, 0.5)).sum(1).min()) > 0.999


def test_more_diversity_uses_more_of_the_style_image():
    # All content prefers the first of three style rows, and would settle for the others.
    style = unit_rows(torch.tensor([[1.0, 0.0, 0.0], [0.9, 0.4, 0.0], [0.9, 0.0, 0.4]]))
    content = unit_rows(torch.tensor([[1.0, 0.05, 0.0]]).repeat(9, 1) + 0.01 * rows(9, 4, 3))
    used = [torch.linalg.lstsq(style.T, transport_targets(content, style, d).mean(0)).solution for d in (0.0, 0.5, 5.0)]
    assert [float(one.max()) for one in used] == sorted((float(one.max()) for one in used), reverse=True)
    assert float(used[0][0]) > 0.5 and float(used[2].max() - used[2].min()) < 0.15


def test_only_the_nearest_neighbors_are_used(monkeypatch):
    monkeypatch.setattr(transport, "NEIGHBORS", 1)
    content, style = rows(20, 5), rows(9, 6)
    found = transport_targets(content, style, 0.5)
    torch.testing.assert_close(found, style[(content @ style.T).argmax(1)])
