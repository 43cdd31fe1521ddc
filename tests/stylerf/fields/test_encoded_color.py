"""Every encoder with every head, and the vm color: colors, gradients to numbers and positions, growth; against the
float64 oracle.
"""

import numpy as np
import pytest
import torch

from stylerf.fields.radiance_field import COLOR_KINDS
from tests.stylerf.fields.test_densities import LARGER, OCCUPIED
from tests.stylerf.kernels.cpu.test_vm import RAYS, added, basis_of, buffers, owned, samples
from tests.stylerf.small import SMALL, SPARSE, close, float64, headed, oracle_color, vm_color

PAIRS = [("hash", "linear"), ("voxel", "linear"), ("hash", "mlp"), ("vm", "mlp"), ("voxel", "mlp")]


def encoded(encoder: str, head: str):
    return headed(4, encoder, head, capacity=SPARSE if encoder == "voxel" else SMALL)


@pytest.fixture(params=PAIRS, ids="-".join)
def made(request):
    return encoded(*request.param)


@pytest.fixture(params=[*PAIRS, 0, 1, 2], ids=lambda p: f"vm of degree {p}" if isinstance(p, int) else "-".join(p))
def color(request):
    return vm_color(4, degree=request.param) if isinstance(request.param, int) else encoded(*request.param)


def test_colors_and_gradients_equal_the_oracle(color):
    s, basis = samples(5), basis_of(samples(5), color.degree)
    s.weights[[4, 11, 30]] = 0
    at, rays = owned(s), np.repeat(np.arange(RAYS), s.ends - s.starts)
    values = float64(color.values).requires_grad_()
    expected = oracle_color(color, values, float64(basis[rays]), float64(s.x[at]))
    shown = s.weights[at] > 0
    gradients = np.random.default_rng(6).normal(size=(len(s.x), 3)).astype(np.float32)
    (expected * float64(gradients[at]))[shown].sum().backward()
    vm = color.kind == "vm"
    for threads in (1, 2, 3):
        found = color.colors(s.shading_points(), basis, threads)
        close(found[at][shown], expected[shown], 2e-6 if vm else 3e-6)
        assert (found[at][~shown, 0] == -1).all() and (~shown).sum() == 3
        to = buffers(threads, len(color.values))
        color.backward(s.shading_points(), basis, found, gradients, to)
        fixed = color.groups()[0][0]
        assert not to[:, :fixed].any() and bool(values.grad[:fixed].any()) == (fixed > 0)
        close(added(to)[fixed:], values.grad[fixed:], 1e-5 if vm else 2e-5)


def test_position_gradient_equals_the_oracle(color):
    s, basis = samples(5), basis_of(samples(5), color.degree)
    s.x[:] = np.random.default_rng(4).uniform(0.01, 0.99, s.x.shape)
    s.weights[[4, 11, 30]] = 0
    at, rays = owned(s), np.repeat(np.arange(RAYS), s.ends - s.starts)
    x = float64(s.x[at]).requires_grad_()
    gradients = np.random.default_rng(6).normal(size=(len(s.x), 3)).astype(np.float32)
    colors = color.colors(s.shading_points(), basis, 1)
    expected = oracle_color(color, float64(color.values), float64(basis[rays]), x)
    (expected * float64(gradients[at]))[torch.from_numpy(s.weights[at] > 0)].sum().backward()
    for threads in (1, 3):
        out = np.full(s.x.shape, 0.25, np.float32)
        color.add_position_gradients(s.shading_points(), basis, colors, gradients, out, threads)
        close(out[at] - 0.25, x.grad, 2e-5)
        assert (np.delete(out, at, 0) == 0.25).all()


def test_points_without_weight_get_no_color(color):
    s = samples()
    s.weights[:21] = 0
    found = color.colors(s.shading_points(), basis_of(s, color.degree), 1)
    assert np.array_equal(found[owned(s), 0] >= 0, owned(s) > 20)


def test_a_grown_color_is_the_same_color_and_a_restored_one_the_same_bits(made):
    s, basis, kind = samples(5), basis_of(samples(5), 1), made.features.kind
    if kind == "voxel":
        s.x[:] *= np.float32(OCCUPIED)
    at = owned(s)
    before = made.colors(s.shading_points(), basis, 1)[at]
    grown = made.grown(LARGER[kind], np.random.default_rng(0))
    assert len(grown.values) > 2 * len(made.values)
    close(grown.colors(s.shading_points(), basis, 1)[at], before, 5e-6)
    again = COLOR_KINDS[made.kind].restore(made.describe(), made.values.copy())
    assert np.array_equal(again.colors(s.shading_points(), basis, 1)[at], before)
    assert again.describe() == made.describe()
