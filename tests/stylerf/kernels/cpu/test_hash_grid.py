"""The hash color, its gradients to the table and to the position, against the oracle."""

import numpy as np
import pytest
import torch

from stylerf.fields.hash_grid import HashColor
from stylerf.kernels.cpu.ray_samples import Samples, ShadingPoints
from tests.stylerf.kernels.cpu.test_vm import added, buffers, owned, samples
from tests.stylerf.small import close, float64, hash_color, oracle_color

# Levels of one kind only, of both, one level alone, and so few entries that most vertices share one.
LAYOUTS = {
    "mixed": {},
    "dense": {"base": 2, "finest": 7},
    "hashed": {"base": 9, "finest": 64, "table": 64},
    "single": {"levels": 1, "base": 5, "finest": 5},
}


def made_of(layout: str) -> tuple[HashColor, Samples]:
    made = hash_color(1, **LAYOUTS[layout])
    hashed = made.layout[5] < 0
    assert (hashed.any(), hashed.all()) == {"mixed": (1, 0), "dense": (0, 0), "hashed": (1, 1), "single": (0, 0)}[
        layout
    ]
    return made, samples(2)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_color_and_table_gradient_equal_the_oracle(layout):
    made, s = made_of(layout)
    s.weights[[5, 17]] = 0
    at = owned(s)
    shown = s.weights[at] > 0
    values = float64(made.values).requires_grad_()
    expected = oracle_color(made, values, None, float64(s.x[at]))
    gradients = np.random.default_rng(3).normal(size=(len(s.x), 3)).astype(np.float32)
    (expected * float64(gradients[at]))[shown].sum().backward()
    for threads in (1, 2):
        found = made.colors(s.shading_points(), None, threads)
        close(found[at][shown], expected[shown], 3e-6)
        assert (found[at][~shown, 0] == -1).all() and (~shown).sum() == 2
        to = buffers(threads, len(made.values))
        made.backward(s.shading_points(), None, found, gradients, to)
        close(added(to), values.grad, 1e-5)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_position_gradient_equals_the_oracle(layout):
    made, s = made_of(layout)
    s.x[:] = np.random.default_rng(4).uniform(0.01, 0.99, s.x.shape)  # on a cell's side the slope has two answers
    s.weights[[5, 17]] = 0
    at = owned(s)
    x = float64(s.x[at]).requires_grad_()
    gradients = np.random.default_rng(3).normal(size=(len(s.x), 3)).astype(np.float32)
    colors = made.colors(s.shading_points(), None, 1)
    shown = torch.from_numpy(s.weights[at] > 0)
    (oracle_color(made, float64(made.values), None, x) * float64(gradients[at]))[shown].sum().backward()
    for threads in (1, 3):
        out = np.full(s.x.shape, 0.5, np.float32)
        made.add_position_gradients(s.shading_points(), None, colors, gradients, out, threads)
        close(out[at] - 0.5, x.grad, 1e-5)
        assert (np.delete(out, at, 0) == 0.5).all()


def colored(made, x):
    """[n, 3] colors of points [n, 3], as one ray."""
    ends = np.array([len(x)], np.int64)
    points = ShadingPoints(np.zeros(1, np.int64), ends, x, np.ones(len(x), np.float32))
    return made.colors(points, None, 1)


def test_far_logits_saturate_without_leaving_the_finite_numbers():
    made = hash_color(1, levels=1, base=5, finest=5)
    x = np.full((1, 3), 0.3, np.float32)
    for level in (-1e30, -200.0, -50.0, 50.0, 200.0, 1e30):
        made.values[:] = level / 2
        assert colored(made, x)[0].tolist() == pytest.approx([float(level > 0)] * 3, rel=2e-7, abs=1e-20)


def test_sigmoid_is_exact_over_its_range():
    made = hash_color(1, levels=1, base=1, finest=1, table=8)
    for z in np.linspace(-20, 20, 801, dtype=np.float32):
        made.values[:] = z / 2
        found = colored(made, np.full((1, 3), 0.5, np.float32))[0]
        # The polynomial's 3e-7, and the rounding of an exponent as large as z.
        np.testing.assert_allclose(found, 1 / (1 + np.exp(-np.float64(z))), rtol=5e-7 + 1e-7 * abs(z))
