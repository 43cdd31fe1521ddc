"""The oracle itself, by closed forms: slabs, linear functions, the formulas of the papers written out once more."""

import math

import numpy as np
import pytest
import torch

from stylerf.fields.hash_grid import HashColor, Levels
from stylerf.fields.vm import VmColor, VmDensity, split_table, table_length
from stylerf.geometry.space_warp import SpaceWarp
from tests.stylerf.kernels import torch_reference
from tests.stylerf.small import SPACES, float64

TIGHT = {"rtol": 1e-12, "atol": 1e-12}
SIZE = [4, 6, 5]


def points(count=40, seed=0) -> torch.Tensor:
    """Inside the cube and on its very sides and corners."""
    inside = torch.rand(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    inside[:8] = torch.tensor([[a, b, c] for a in (0.0, 1.0) for b in (0.0, 1.0) for c in (0.0, 1.0)])
    inside[8, 0], inside[9, 1], inside[10, 2] = 0, 1, 1
    return inside


def sigmoid(z):
    return 1 / (1 + np.exp(-np.asarray(z)))


# -- interpolation --------------------------------------------------------------------------------------------------


def test_trilinear_reproduces_products_of_linear_functions():
    grid = torch.zeros(4, 3, 6, 2, dtype=torch.float64)
    for i in range(4):
        for j in range(3):
            for k in range(6):
                u, v, w = i / 3, j / 2, k / 5
                grid[i, j, k] = float64([1 + 2 * u - v + 3 * w, (2 - u) * (1 + v) * (3 * w - 1)])
    x = points()
    u, v, w = x.T
    expected = torch.stack([1 + 2 * u - v + 3 * w, (2 - u) * (1 + v) * (3 * w - 1)], 1)
    torch.testing.assert_close(torch_reference.trilinear(grid, x), expected, **TIGHT)


def test_a_displacement_moves_and_stops_at_the_sides():
    x = points().requires_grad_()
    still = torch.zeros(3, 3, 3, 3, dtype=torch.float64)
    assert torch.equal(torch_reference.displaced(still, x), x)
    grid = still + float64([0.1, -0.2, 0.0])
    found = torch_reference.displaced(grid.requires_grad_(), x)
    expected = (x.detach() + float64([0.1, -0.2, 0.0])).clamp(0, 1)
    torch.testing.assert_close(found, expected, **TIGHT)
    # What has reached a side does not move with the grid: eight corners are pushed out along x or y or both.
    (gradient,) = torch.autograd.grad(found[:, 1].sum(), grid)
    free = (x[:, 1] - 0.2 > 0).sum()
    assert float(gradient[..., 1].sum()) == pytest.approx(float(free)) and float(gradient[..., 0].abs().max()) == 0


def table_of_products(rank=2) -> np.ndarray:
    """Plane m, rank r at (u, v): (1 + r + u)(2 - v + m); line m, rank r at w: 3 - r - w/2."""
    table = np.zeros(table_length(np.array(SIZE), rank))
    planes, lines = split_table(table, np.array(SIZE), rank)
    for m in range(3):
        u = np.linspace(0, 1, SIZE[(m + 1) % 3])[:, None]
        v = np.linspace(0, 1, SIZE[(m + 2) % 3])[None, :]
        for r in range(rank):
            planes[m][..., r] = (1 + r + u) * (2 - v + m)
            lines[m][..., r] = 3 - r - np.linspace(0, 1, SIZE[m]) / 2
    return table


def products_at(x: np.ndarray, rank=2) -> np.ndarray:
    columns = []
    for m in range(3):
        u, v, w = x[:, (m + 1) % 3], x[:, (m + 2) % 3], x[:, m]
        columns += [(1 + r + u) * (2 - v + m) * (3 - r - w / 2) for r in range(rank)]
    return np.stack(columns, 1)


def test_vm_features_reproduce_bilinear_planes_times_linear_lines():
    x = points()
    found = torch_reference.vm_features(float64(table_of_products()), SIZE, 2, x)
    np.testing.assert_allclose(found.numpy(), products_at(x.numpy()), **TIGHT)


def test_vm_density_is_the_exponential_within_its_clamp():
    x = points(12)
    table = float64(table_of_products())
    for shift in (-30.0, -20.0, 0.0):
        values = torch.cat([table, torch.tensor([shift], dtype=torch.float64)]).requires_grad_()
        found = torch_reference.vm_density(values, SIZE, 2, x)
        expected = np.exp(np.clip(shift + products_at(x.numpy()).sum(1), -15, 12))
        np.testing.assert_allclose(found.detach().numpy(), expected, **TIGHT)
        (gradient,) = torch.autograd.grad(found.sum(), values)
        assert float(gradient[-1]) == pytest.approx(expected.sum(), rel=1e-12)  # d exp(e) = exp(e), clamped or not


def test_vm_color_equals_its_formula_in_loops():
    x, rank, bands = points(20), 2, 4
    generator = np.random.default_rng(0)
    head, bias = generator.normal(scale=0.1, size=(3, bands, 3 * rank)), np.array([0.1, -0.4, 0.2])
    basis = generator.normal(size=(20, bands))
    values = float64(np.concatenate([table_of_products(), head.ravel(), bias]))
    found = torch_reference.vm_color(values, SIZE, rank, float64(basis), x).numpy()
    features = products_at(x.numpy())
    for n in range(20):
        for j in range(3):
            z = bias[j] + sum(basis[n, b] * head[j, b] @ features[n] for b in range(bands))
            assert found[n, j] == pytest.approx(sigmoid(z), rel=1e-12)


def test_layouts_are_those_of_the_fields():
    assert len(table_of_products()) == table_length(np.array(SIZE), 2)
    rank, degree = 2, 1
    VmDensity(np.array(SIZE), rank, np.append(table_of_products(), 0).astype(np.float32))
    made = VmColor.create(np.array(SIZE), rank, degree, np.random.default_rng(0))
    assert len(made.values) == table_length(np.array(SIZE), rank) + 3 * 4 * 3 * rank + 3


def test_hash_color_equals_a_loop_over_levels_and_corners():
    levels, base, finest, table = 5, 2, 11, 128
    grid = Levels(levels, base, finest, table, 4, levels)
    count = grid.length
    assert sorted(set(grid.layout()[5])) == [-1, 0]  # directly indexed and hashed levels, both
    values = np.random.default_rng(1).normal(size=count)
    x = points(20)
    found = torch_reference.hash_color(float64(values), levels, base, finest, table, x).numpy()
    for n, point in enumerate(x.tolist()):
        total, at = np.zeros(4), 0
        for level in range(levels):
            cells = round(base * (finest / base) ** (level / (levels - 1)))
            entries = min((cells + 1) ** 3, table)
            rows, at = values[at : at + 4 * entries].reshape(-1, 4), at + 4 * entries
            low = [min(int(p * cells), cells - 1) for p in point]
            for corner in np.ndindex(2, 2, 2):
                i, j, k = (a + d for a, d in zip(low, corner))
                if (cells + 1) ** 3 <= table:
                    index = (i * (cells + 1) + j) * (cells + 1) + k
                else:
                    index = (i * 805459861 % 2**32 ^ j * 2654435761 % 2**32 ^ k) % table
                share = math.prod(
                    f if d else 1 - f for f, d in zip((p * cells - a for p, a in zip(point, low)), corner)
                )
                total += share * rows[index]
        np.testing.assert_allclose(found[n], sigmoid(total[:3] + total[3]), **TIGHT)
    assert len(HashColor.create(np.random.default_rng(0), levels, base, finest, table).values) == at


# -- space ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", SPACES)
def test_warps_equal_the_definition_of_space(kind):
    world = torch.randn(200, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64) * 3
    world[:, 2] += 4 if kind == "frustum" else 0
    np.testing.assert_allclose(torch_reference.warp(SPACES[kind], world), SPACES[kind].warp(world.numpy()), **TIGHT)


def test_a_contraction_written_out():
    space = SpaceWarp.box([-1, -2, -4], [1, 2, 4], near=0.1, far=1e3, kind="contraction")
    world = torch.tensor([[0.5, 0, 0], [1, 2, 4], [2, 0, 0], [0, 8, 0], [2, 4, 2], [1e9, 0, 0]], dtype=torch.float64)
    # 1/2 + x/4 inside; m (2 - 1/m)/m outside: at m = 2 and 4 the largest coordinate is at 3/2 and 7/4 of 2.
    expected = [[0.625, 0.5, 0.5], [0.75] * 3, [0.875, 0.5, 0.5], [0.5, 0.9375, 0.5], [0.875, 0.875, 0.59375]]
    torch.testing.assert_close(torch_reference.warp(space, world)[:5], float64(expected), **TIGHT)
    assert 1 - 1e-8 < float(torch_reference.warp(space, world)[5, 0]) <= 1
    along = torch.tensor([[1.0, 0, 0]], dtype=torch.float64).expand(6, 3)
    # d(2 - 1/m)/dm = 1/m^2, a quarter of it in the cube.
    speeds = torch_reference.speed(space, world, along)
    assert speeds[[0, 2]].tolist() == pytest.approx([0.25, 0.25 / 4])
    mean = (1 + 1 / 2 + 1 / 4) / 3
    assert torch_reference.density_jacobian(space, world)[[0, 2, 3]].tolist() == pytest.approx(
        [0.25 * mean, 0.25 * mean / 4, 0.25 * mean / 16]
    )


def test_a_frustum_and_a_box_written_out():
    space = SpaceWarp.frustum(0.5, 0.25, 2.0, 1e4)
    world = torch.tensor([[0, 0, 2.0], [2, 1, 4.0], [-2, -1, 4], [0, 0, 2e9]], dtype=torch.float64)
    expected = float64([[0.5, 0.5, 0], [1, 1, 0.5], [0, 0, 0.5], [0.5, 0.5, 1]])
    torch.testing.assert_close(torch_reference.warp(space, world), expected, rtol=0, atol=1e-8)
    forward = torch.tensor([[0, 0, 1.0]], dtype=torch.float64)
    assert float(torch_reference.speed(space, world[:1], forward)[0]) == pytest.approx(2 / 4)  # near / z^2
    sideways = torch.tensor([[0, 1.0, 0]], dtype=torch.float64)
    assert float(torch_reference.speed(space, world[1:2], sideways)[0]) == pytest.approx(0.5 / (4 * 0.25))
    assert torch_reference.density_jacobian(space, world)[1].item() == pytest.approx(2 / 16)
    box = SpaceWarp.box([0, 0, 0], [1, 2, 4])
    way = torch.tensor([[0.6, 0.8, 0]], dtype=torch.float64)
    assert float(torch_reference.speed(box, world[:1], way)) == pytest.approx(0.6)
    assert float(torch_reference.density_jacobian(box, world[:1])) == pytest.approx((1 + 1 / 2 + 1 / 4) / 3)


# -- volume rendering -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pieces", [1, 2, 7, 200])
def test_a_slab_is_as_opaque_as_its_thickness_says_however_it_is_cut(pieces):
    sigma, length = 0.3, 5.0
    cuts = np.random.default_rng(pieces).dirichlet(np.ones(pieces)) * length
    rays = torch.zeros(pieces, dtype=torch.long)
    none = torch.zeros(pieces, dtype=torch.bool)
    values = torch.full((pieces,), sigma, dtype=torch.float64, requires_grad=True)
    w, through = torch_reference.weights(values, float64(cuts), rays, none)
    assert float(w.sum().detach()) == pytest.approx(1 - math.exp(-sigma * length), rel=1e-12)
    assert float(through[-1].detach()) == pytest.approx(math.exp(-sigma * (length - cuts[-1])), rel=1e-12)
    (gradient,) = torch.autograd.grad(w.sum(), values)
    np.testing.assert_allclose(gradient, cuts * math.exp(-sigma * length), rtol=1e-10)


def test_rays_do_not_see_each_other_and_a_background_takes_the_rest():
    rays = torch.tensor([0, 0, 2, 2, 2, 5])
    sigma = torch.tensor([1.0, 2, 0.5, 1e9, 3, 0], dtype=torch.float64)
    lengths = torch.tensor([0.1, 0.2, 1, 1, 1, 0], dtype=torch.float64)
    opaque = torch.tensor([0, 0, 0, 0, 0, 1], dtype=torch.bool)
    w, _ = torch_reference.weights(sigma, lengths, rays, opaque)
    a, b = 1 - math.exp(-0.1), math.exp(-0.1) * (1 - math.exp(-0.4))
    half = 1 - math.exp(-0.5)
    torch.testing.assert_close(w, float64([a, b, half, 1 - half, 0, 1]), **TIGHT)
    closed, _ = torch_reference.weights(
        sigma[:2], lengths[:2] * torch.tensor([1, 0]), rays[:2], torch.tensor([False, True])
    )
    assert float(closed.sum()) == pytest.approx(1)


def test_one_opaque_sample_is_the_pixel_and_an_empty_ray_is_nothing():
    rays, colors = torch.tensor([1]), torch.tensor([[0.2, 0.5, 0.9]], dtype=torch.float64)
    w, _ = torch_reference.weights(float64([1e9]), float64([1.0]), rays, torch.tensor([False]))
    out = torch_reference.composite(w, colors, torch.tensor([True]), float64([3.5]), rays, 3)
    assert out.tolist() == [[0] * 5, [0.2, 0.5, 0.9, 1, 3.5], [0] * 5]


def test_samples_without_a_color_take_the_mean_of_the_others():
    w = float64([0.2, 0.3, 0.1, 0.4]).requires_grad_()
    colors = float64([[1, 0, 0.5], [-1, 7, 7], [0, 1, 0.5], [-1, 7, 7]]).requires_grad_()
    colored, rays = torch.tensor([True, False, True, False]), torch.tensor([0, 0, 0, 1])
    out = torch_reference.composite(w, colors, colored, float64([1, 2, 3, 4]), rays, 2)
    share = 0.6 / 0.3
    expected = [[0.2 * share, 0.1 * share, 0.15 * share, 0.6, 0.2 + 0.6 + 0.3], [0, 0, 0, 0.4, 1.6]]
    torch.testing.assert_close(out, float64(expected), **TIGHT)
    to_weights, to_colors = torch.autograd.grad(out[0, 0], (w, colors))
    # The mean (2/3 red) is a constant for those who take it; colors learn by their own weight alone.
    np.testing.assert_allclose(to_weights, [1, 2 / 3, 0, 0], **TIGHT)
    np.testing.assert_allclose(to_colors[:, 0], [0.2, 0, 0.1, 0], **TIGHT)
