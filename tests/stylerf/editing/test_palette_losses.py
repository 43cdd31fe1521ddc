"""Every loss by hand numbers, gradients by finite differences, and the same picture at twice the size."""

import numpy as np
import pytest
import torch

from stylerf.editing import palette_losses
from stylerf.editing.palette_losses import REFERENCE_PIXELS, Neighbors
from tests.stylerf.editing.region_pictures import tiny_view, view_of

COLORS = [[0.1, 0.2, 0.3], [0.5, 0.2, 0.3], [0.5, 0.0, 0.3], [0.1, 0.2, 0.3], [0.1, 0.2, 0.3], [0.5, 0.0, 0.9]]


def tensor(values) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_losses_of_pixels():
    colors, target = tensor([[0.5, 0.5, 0.5], [1, 0, 0]]), tensor([[0.2, 0.5, 0.9], [1, 0, 0]])
    assert palette_losses.reconstruction(colors, target).tolist() == pytest.approx([0.25 / 3, 0])
    weights = tensor([[0.7, 0.2, 0.1], [0.0, 0.0, 1.0]])
    assert palette_losses.uncertainty(weights).tolist() == pytest.approx([0.3, 0])
    assert float(palette_losses.largest_share(weights)) == pytest.approx(0.55)
    assert palette_losses.offset_size(tensor([[0.1, -0.2, 0.2], [0, 0, 0]])).tolist() == pytest.approx([0.09, 0])
    error = palette_losses.transition_error(colors, target, tensor([0.5, 1]))
    assert error.tolist() == pytest.approx([0.125, 0])


def test_losses_of_the_palette():
    assert float(palette_losses.outside_gamut(tensor([[0, 0.999, 0.5]]))) == 0
    # floor(-0.2) (-0.2) + floor(1.5) 1.5 + floor(2.5) 2.5
    assert float(palette_losses.outside_gamut(tensor([[-0.2, 1.5, 2.5]]))) == pytest.approx(0.2 + 1.5 + 5)
    # Squared distances 0, 1, 4, 1 over 4: mean of (1, 3/4, 0) over nine pairs.
    palette = tensor([[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert float(palette_losses.likeness(palette)) == pytest.approx((3 * 1 + 4 * 0.75 + 2 * 0) / 9)
    assert float(palette_losses.likeness(tensor([[0.3] * 3] * 2))) == 1


def test_losses_of_a_picture():
    """Rows (a b c) (a a d): pairs below a-a 0, b-a .16, c-d .36; beside a-b .16, b-c .04, a-a 0, a-d .16+.04+.36."""
    edges = np.zeros((6, 2), np.float32)
    edges[1, 0], edges[2, 0] = 4.0, 1.0  # below: b-a is the view's sharpest, c-d a quarter of it
    edges[0, 1] = 2.0  # beside: a-b the sharpest
    transition = [0, 0, 0, 0, 0, 0.5]
    view = tiny_view(edges=edges, transition=transition)
    neighbors = Neighbors.of(view)
    differences = neighbors.differences(torch.tensor(COLORS))
    kept = 0.36 * 0.75 * 0.5 + 0.04 + 0.56 * 0.5
    assert float(palette_losses.variation(differences, neighbors)) * REFERENCE_PIXELS == pytest.approx(kept, rel=1e-5)
    sharp = 0.16 + 0.36 * 0.25 + 0.16
    expected = -sharp / (6 * REFERENCE_PIXELS) ** 0.5
    assert float(palette_losses.edge_contrast(differences, neighbors)) == pytest.approx(expected, rel=1e-5)


def test_a_view_without_edges_has_no_edge_contrast():
    neighbors = Neighbors.of(tiny_view())
    differences = neighbors.differences(torch.tensor(COLORS))
    assert float(palette_losses.edge_contrast(differences, neighbors)) == 0 and float(differences.sum()) > 0


def test_gradients():
    generator = torch.Generator().manual_seed(0)
    colors, target = (torch.rand(6, 3, generator=generator, dtype=torch.float64) for _ in range(2))
    edges = np.random.default_rng(0).random((6, 2))
    view = tiny_view(edges=edges, transition=np.linspace(0, 1, 6))
    neighbors = Neighbors.of(view)
    checked = {
        "reconstruction": lambda c: palette_losses.reconstruction(c, target),
        "uncertainty": palette_losses.uncertainty,
        "share": palette_losses.largest_share,
        "offset": palette_losses.offset_size,
        "gamut": lambda c: palette_losses.outside_gamut(3 * c - 1),
        "likeness": palette_losses.likeness,
        "variation": lambda c: palette_losses.variation(neighbors.differences(c), neighbors) * REFERENCE_PIXELS,
        "edges": lambda c: palette_losses.edge_contrast(neighbors.differences(c), neighbors) * REFERENCE_PIXELS,
        "smooth": lambda c: palette_losses.transition_error(c, target, target[:, 0]),
    }
    for name, loss in checked.items():
        assert torch.autograd.gradcheck(loss, (colors.clone().requires_grad_(),)), name


def smooth_picture(side: int) -> tuple[dict, float]:
    """All image losses of one smooth picture of a disc, sampled at `side` pixels, geometry edges along its middle."""
    view = view_of(0, side)
    place = view.x[:, :2]
    columns = view.pixels % view.width
    view.edges[:, 1] = 3.0 * (columns == 6 + side // 2 - 1)
    view.transition[:] = np.clip((place[:, 0] - 0.3) / 0.2, 0, 1)
    colors = 0.5 + 0.4 * np.sin(np.column_stack([30 * place[:, 0], 20 * place[:, 1], 25 * place.sum(1)]))
    colors[:, 0] += 0.3 * (columns >= 6 + side // 2)
    found, neighbors = torch.from_numpy(colors), Neighbors.of(view)
    differences = neighbors.differences(found)
    target = torch.from_numpy(colors) * 0.5
    transition = torch.from_numpy(view.transition).double()
    return {
        "reconstruction": float(palette_losses.reconstruction(found, target).mean()),
        "variation": float(palette_losses.variation(differences, neighbors)),
        "edges": float(palette_losses.edge_contrast(differences, neighbors)),
        "smooth": float(palette_losses.transition_error(found, target, transition).mean()),
    }


def test_the_same_picture_at_twice_the_size_gives_nearly_the_same():
    small, large = smooth_picture(80), smooth_picture(160)
    for name, value in small.items():
        assert large[name] == pytest.approx(value, rel=0.08), name  # a sum would be 4 times, a mean of pairs a quarter


def test_sparsity_and_variation_of_weights():
    assert palette_losses.sparsity(np.eye(3)) == 0
    assert palette_losses.sparsity(np.full((5, 4), 0.25)) == pytest.approx(3)
    assert palette_losses.sparsity(np.array([[0.5, 0.5], [1, 0]])) == pytest.approx(0.5)
    assert palette_losses.sparsity(np.zeros((0, 3))) == 0
    weights = np.array([[1, 0], [1, 0], [0, 1], [1, 0], [0.5, 0.5], [0, 1]])
    view = tiny_view()
    view.weight[5] = 0.5
    # Below: 0, .5, 0. Beside: 0, 2, .5 and .5, the last gated by the half-covered pixel, and that is squared.
    assert palette_losses.weight_variation(weights, view) == pytest.approx((0.5 + 2 + 0.5 + 0.5 / 4) / 6)
    view.weight[4] = 0.5  # which gates .5 below, .5 on its left, and once more .5 on its right
    assert palette_losses.weight_variation(weights, view) == pytest.approx((0.5 / 4 + 2 + 0.5 / 4 + 0.5 / 16) / 6)
