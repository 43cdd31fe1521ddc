"""Every kind of density: values, gradients to numbers and positions, the march, growth; against the float64 oracle."""

from dataclasses import replace

import numpy as np
import pytest

from stylerf.fields.radiance_field import DENSITY_KINDS
from tests.stylerf.kernels.cpu.test_march import march
from tests.stylerf.kernels.cpu.test_vm import added, buffers, owned, samples
from tests.stylerf.small import (
    SMALL,
    SPACES,
    SPARSE,
    Packed,
    close,
    density,
    float64,
    hash_density,
    oracle_density,
    rays_into,
    voxel_density,
)

MADE = {
    "vm": density,
    "vm of rank 16": lambda seed: density(seed, rank=16),
    "vm of rank 3": lambda seed: density(seed, rank=3),
    "hash": hash_density,
    "voxel": voxel_density,
}


@pytest.fixture(params=MADE)
def made(request):
    return MADE[request.param](3)


def test_density_and_its_gradient_equal_the_oracle(made):
    s = samples()
    values = float64(made.values).requires_grad_()
    expected = oracle_density(made, values, float64(s.x))
    assert float(expected.detach().max() / expected.detach().min()) > 5
    vm = made.kind == "vm"
    for threads in (1, 4):
        close(made.sigma(s.x, threads), expected, 2e-6 if vm else 3e-6)
    gradients = np.random.default_rng(2).normal(size=len(s.x)).astype(np.float32)
    gradients[3] = 0
    s.sigma[:] = expected.detach()
    at = owned(s)
    assert len(at) < len(s.x)
    (expected[at] * float64(gradients[at])).sum().backward()
    for threads in (1, 2):
        to = buffers(threads, len(made.values))
        made.backward(s, gradients, to)
        fixed = made.groups()[0][0]  # the shared block of unallocated ones never learns: its gradient is cleared
        assert not to[:, :fixed].any() and bool(values.grad[:fixed].any()) == (fixed > 0)
        close(added(to)[fixed:], values.grad[fixed:], 5e-6 if vm else 1e-5)
        assert threads == 1 or np.abs(to[0] - to[1]).max() > 1e-3  # each chunk has its own


def test_position_gradient_equals_the_oracle(made):
    s = samples()
    s.x[:] = np.random.default_rng(4).uniform(0.01, 0.99, s.x.shape)  # on a cell's side the slope has two answers
    at = owned(s)
    x = float64(s.x[at]).requires_grad_()
    gradients = np.random.default_rng(2).normal(size=len(s.x)).astype(np.float32)
    gradients[[3, 9]] = 0
    expected = oracle_density(made, float64(made.values), x)
    s.sigma[at] = expected.detach()
    (expected * float64(gradients[at])).sum().backward()
    for threads in (1, 2, 3):
        out = np.full(s.x.shape, 0.25, np.float32)
        made.add_position_gradients(s, gradients, out, threads)
        close(out[at] - 0.25, x.grad, 2e-5)
        assert (np.delete(out, at, 0) == 0.25).all()


def test_a_march_meets_the_density_at_its_samples(made):
    made.values[-1] = -4.5
    rays = rays_into(SPACES["contraction"], 40, 4)
    one, two = (Packed.of(march(made, SPACES["contraction"], rays, opaque_background=True, threads=c)) for c in (1, 2))
    assert np.array_equal(one.sigma, two.sigma) and np.array_equal(one.weights, two.weights)
    inside = ~one.background
    expected = oracle_density(made, float64(made.values), one.x)
    close(one.sigma[inside], expected[inside], 3e-6)
    assert 200 < int(inside.sum()) and not one.sigma[~inside].any()


@pytest.mark.parametrize(("shift", "limit"), [(-40.0, np.exp(-15.0)), (40.0, np.exp(12.0))])
def test_the_exponent_is_clamped_and_lets_gradients_pass(made, shift, limit):
    s = samples()
    made.values[-1] = shift
    s = s._replace(sigma=made.sigma(s.x, 1))
    np.testing.assert_allclose(s.sigma, limit, rtol=1e-6)
    to = np.zeros((1, len(made.values)), np.float32)
    made.backward(s, np.full(len(s.x), 1 / limit, np.float32), to)
    assert to[0, -1] == pytest.approx(len(owned(s)), rel=1e-5)  # a field stuck at the clamp can still come back


LARGER = {
    "vm": replace(SMALL, size=2 * SMALL.size - 1),  # every old vertex is one of the new
    "hash": replace(SMALL, resolution=64, table=2048),
    "voxel": replace(SPARSE, size=2 * SPARSE.size - 1),
}
OCCUPIED = np.array([0.25, 0.5, 0.5])  # of SPARSE


@pytest.mark.parametrize("kind", LARGER)
def test_a_grown_density_is_the_same_density(kind):
    made, s = MADE[kind](3), samples()
    x = s.x * np.float32(OCCUPIED) if made.kind == "voxel" else s.x
    grown = made.grown(LARGER[made.kind], np.random.default_rng(0))
    assert len(grown.values) > 2 * len(made.values)
    close(grown.sigma(x, 1), made.sigma(x, 1), 5e-6)
    if made.kind == "voxel":
        dense = len(np.ravel(grown.grid.kept)) * 64
        assert len(grown.values) < dense / 2  # what is not occupied is not kept
        far = np.full((1, 3), 0.9, np.float32)
        np.testing.assert_allclose(grown.sigma(far, 1), np.exp(-2 - 8.0), rtol=1e-5)


def test_a_restored_density_is_the_same_bits(made):
    s = samples()
    again = DENSITY_KINDS[made.kind].restore(made.describe(), made.values.copy())
    assert np.array_equal(again.sigma(s.x, 1), made.sigma(s.x, 1)) and again.describe() == made.describe()
