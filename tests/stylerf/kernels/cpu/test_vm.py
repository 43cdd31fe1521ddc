"""vm density and color: the planes' smoothness, growth and the grid's far side, against the oracle.

Their values and gradients: test_densities.py and test_encoded_color.py.
"""

import numpy as np
import pytest
import torch

from stylerf.fields.vm import VmDensity, split_table
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.ray_samples import Samples
from tests.stylerf.kernels import torch_reference
from tests.stylerf.small import SIZE, close, density, float64, oracle_color, vm_color

RAYS = 9


def samples(seed=0, count=57) -> Samples:
    """Points anywhere in the cube, on its sides and corners, on uneven rays (one empty), with a gap between."""
    generator = np.random.default_rng(seed)
    x = generator.random((count, 3)).astype(np.float32)
    x[:8] = [[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    x[8, 0], x[9, 1], x[10, 2] = 0, 1, 1
    cuts = np.sort(generator.integers(0, count - 3, RAYS - 1))
    cuts[3] = cuts[2]
    starts = np.concatenate([[0], cuts]).astype(np.int64)
    ends = np.concatenate([cuts, [count]]).astype(np.int64)
    starts[5] = min(starts[5] + 2, ends[5])  # two samples that no ray owns
    ones = np.ones(count, np.float32)
    return Samples(starts, ends, ones, ones, x, ones.copy(), ones.copy())


def owned(s: Samples) -> np.ndarray:
    return np.concatenate([np.arange(a, b) for a, b in zip(s.starts, s.ends)])


def basis_of(s: Samples, degree: int) -> np.ndarray:
    way = np.random.default_rng(1).normal(size=(len(s.ends), 3))
    return harmonics(way / np.linalg.norm(way, axis=1, keepdims=True), degree)


def buffers(threads: int, length: int) -> np.ndarray:
    """Not empty: kernels add to what is there."""
    return np.tile(np.linspace(-1, 1, length, dtype=np.float32), (threads, 1))


def added(to: np.ndarray) -> np.ndarray:
    return (to.astype(np.float64) - np.linspace(-1, 1, to.shape[1], dtype=np.float32)).sum(0)


def test_a_sample_at_the_far_side_reads_the_last_vertex():
    made = density(3)
    made.values[:] = 0
    planes, lines = split_table(made.table, made.size, made.rank)
    for m in range(3):
        planes[m][-1, -1, 0], lines[m][-1, 0] = 1 + m, 2
    found = made.sigma(np.ones((1, 3), np.float32), 1)
    assert found[0] == pytest.approx(np.exp(2 * (1 + 2 + 3)), rel=1e-6)


def smoothness_energy(values: torch.Tensor, size, rank: int) -> torch.Tensor:
    """Half the summed squared differences between neighboring texels of the three planes."""
    total, at = values.new_zeros(()), 0
    for m in range(3):
        shape = (size[(m + 1) % 3], size[(m + 2) % 3], rank)
        plane, at = values[at : at + int(np.prod(shape))].reshape(shape), at + int(np.prod(shape))
        total = total + ((plane[1:] - plane[:-1]) ** 2).sum() / 2 + ((plane[:, 1:] - plane[:, :-1]) ** 2).sum() / 2
    return total


@pytest.mark.parametrize("made", [density(7), vm_color(8)], ids=["density", "color"])
def test_smoothness_is_the_gradient_of_the_planes_squared_differences(made):
    values = float64(made.values).requires_grad_()
    smoothness_energy(values, SIZE, made.rank).backward()
    to = buffers(1, len(made.values))[0]
    before, length = to.copy(), len(made.values) if isinstance(made, VmDensity) else len(made.table)
    made.smooth(3.0, to)
    close(to.astype(np.float64) - before, 3.0 / length * values.grad, 1e-4)  # small beside what it was added to
    assert np.array_equal(to[-4:], before[-4:])
    lines = float64(made.values)
    assert smoothness_energy(lines * 0 + 5, SIZE, made.rank) == 0


def test_a_finer_grid_and_more_ranks_hold_the_same_field():
    made, s = density(3), samples()
    finer = np.array([2 * (n - 1) + 1 for n in SIZE])  # every old vertex is one of the new
    close(made.resized(finer).sigma(s.x, 1), made.sigma(s.x, 1), 5e-6)
    wider = made.with_rank(24, np.random.default_rng(0))
    expected = torch_reference.vm_density(float64(wider.values), list(SIZE), 24, float64(s.x))
    close(made.sigma(s.x, 1), expected, 5e-6)
    color, basis = vm_color(4, rank=16), basis_of(s, 1)
    rays = np.repeat(np.arange(RAYS), s.ends - s.starts)
    at = owned(s)
    before = oracle_color(color, float64(color.values), float64(basis[rays]), float64(s.x[at]))
    for other in (color.with_rank(24, np.random.default_rng(0)), color.resized(finer), color.with_degree(2)):
        turned = basis_of(s, other.degree)[rays]
        close(oracle_color(other, float64(other.values), float64(turned), float64(s.x[at])), before, 1e-6)
