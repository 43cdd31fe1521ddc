"""Nearest style features against a double loop, reductions and what they cost."""

import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.style.feature_matching import StyleRows, nearest, style_rows, unit_rows


def rows(count: int, channels: int, seed: int) -> torch.Tensor:
    return torch.rand(count, channels, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def brute_force(content: torch.Tensor, style: torch.Tensor) -> list[int]:
    found = []
    for f in content.tolist():
        best, place = -2.0, -1
        for j, s in enumerate(style.tolist()):
            dot = sum(a * b for a, b in zip(f, s))
            cosine = dot / (sum(a * a for a in f) ** 0.5 * sum(b * b for b in s) ** 0.5)
            if cosine > best:
                best, place = cosine, j
        found.append(place)
    return found


def test_nearest_equals_a_double_loop_whatever_the_blocks(monkeypatch):
    content, style = rows(37, 6, 0) - 0.3, unit_rows(rows(53, 6, 1) - 0.3)
    expected = brute_force(content, style)
    for block, memory in ((4096, 64.0), (7, 64.0), (7, 1e-4), (1, 1e-9)):
        monkeypatch.setattr("stylerf.style.feature_matching.STYLE_BLOCK", block)
        index, cosine = nearest(content, style, memory)
        assert index.tolist() == expected
        truth = (unit_rows(content) * style[index]).sum(dim=1)
        torch.testing.assert_close(cosine, truth)


def test_float32_agrees_with_float64_to_rounding():
    content, style = rows(200, 64, 2), unit_rows(rows(300, 64, 3))
    exact = nearest(content, style)[1]
    found = nearest(content.float(), style.float())[0]
    reached = (unit_rows(content) * style[found]).sum(dim=1)
    assert float((exact - reached).max()) < 1e-6


def test_the_first_of_equal_rows_wins_and_dead_positions_are_finite():
    style = unit_rows(torch.ones(5, 3))
    assert nearest(torch.ones(2, 3), style)[0].tolist() == [0, 0]
    index, cosine = nearest(torch.zeros(2, 3), style)
    assert index.tolist() == [0, 0] and cosine.tolist() == [0, 0]


def test_wrong_shapes_are_refused():
    with pytest.raises(InvalidValue):
        nearest(torch.ones(2, 3), torch.ones(2, 4))
    with pytest.raises(InvalidValue):
        nearest(torch.ones(2, 3), torch.ones(0, 3))


def test_style_rows_are_unit_and_bounded():
    features = rows(6 * 40, 5, 4).T.reshape(5, 6, 40)
    full = style_rows(features, None)
    assert full.rows.shape == (240, 5)
    torch.testing.assert_close(full.rows[41], features[:, 1, 1] / features[:, 1, 1].norm())
    reduced = style_rows(features, 50, seed=3)
    assert reduced.rows.shape[0] == 50
    assert torch.equal(reduced.rows, style_rows(features, 50, seed=3).rows)
    members = (reduced.rows[:, None] - full.rows[None]).abs().sum(dim=2).min(dim=1).values
    assert float(members.max()) == 0


def lost(content: torch.Tensor, full: StyleRows, reduced: StyleRows) -> float:
    """Mean cosine that content rows lose by being matched to `reduced` instead of `full`."""
    exact, found = full.rows[nearest(content, full.rows)[0]], reduced.rows[reduced.match(content)]
    return float((unit_rows(content) * (exact - found)).sum(1).mean())


def test_a_full_basis_changes_nothing_and_a_short_one_costs_little():
    generator = torch.Generator().manual_seed(6)
    mixing = torch.randn(6, 40, generator=generator, dtype=torch.float64)

    def make(count):
        return torch.randn(count, 6, generator=generator, dtype=torch.float64) @ mixing

    style, content = StyleRows(unit_rows(make(150))), make(60)
    assert abs(lost(content, style, style.with_basis(40))) < 1e-12
    assert torch.equal(style.with_basis(6).match(content), style.match(content))  # six directions hold everything
    assert lost(content, style, style.with_basis(3)) > 1e-3
    with pytest.raises(InvalidValue):
        style.with_basis(41)
