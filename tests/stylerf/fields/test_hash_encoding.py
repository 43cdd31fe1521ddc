"""The hash encoding and its gradient to the table against the oracle, and as part of a graph."""

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.fields.hash_encoding import HashEncoding
from tests.stylerf.kernels import torch_reference
from tests.stylerf.small import close, float64

# 3 to 40 cells: levels of 4^3 and 6^3 vertices are indexed directly, finer ones share 512 entries.
LAYOUT = {"levels": 8, "base": 3, "finest": 40, "table": 512}


def encoding(seed: int = 0) -> HashEncoding:
    made = HashEncoding.create(np.random.default_rng(seed), **LAYOUT, spread=1.0)
    assert (made.layout[5] < 0).any() and (made.layout[5] == 0).any()
    return made


def points(count: int = 61, seed: int = 1) -> np.ndarray:
    x = np.random.default_rng(seed).random((count, 3)).astype(np.float32)
    x[:3] = [[0, 0, 0], [1, 1, 1], [0, 1, 0.5]]
    return x


def expected(made: HashEncoding, values: torch.Tensor, x: np.ndarray) -> torch.Tensor:
    return torch_reference.hash_levels(values, made.levels, made.base, made.finest, made.table, float64(x)).flatten(1)


def test_features_and_table_gradient_equal_the_oracle_in_any_chunks():
    made, x = encoding(), points()
    values = float64(made.values).requires_grad_()
    right = expected(made, values, x)
    gradients = np.random.default_rng(3).normal(size=(len(x), made.width)).astype(np.float32)
    (right * float64(gradients)).sum().backward()
    for threads in (1, 2):
        close(made.forward(x, threads), right, 3e-6)
        to = np.zeros((threads, len(made.values)), np.float32)
        made.backward(x, gradients, to)
        close(to.sum(0, dtype=np.float64), values.grad, 1e-5)
        assert (np.abs(to).max(1) > 0).all()


def test_a_graph_brings_gradients_to_the_buffers():
    """A network behind the features: the table's slope by finite differences, where the features are linear in it."""
    made, x = encoding(), points(9)
    mix = torch.randn(made.width, 2, generator=torch.Generator().manual_seed(4))
    to = np.zeros((2, len(made.values)), np.float32)
    (made(x, to) @ mix).sum().backward()
    found = to.sum(0)
    for at in np.flatnonzero(found)[::97]:
        sums = []
        for step in (-0.5, 0.5):
            values = float64(made.values)
            values[at] += step
            sums.append(float((expected(made, values, x) @ mix.double()).sum()))
        assert found[at] == pytest.approx(sums[1] - sums[0], rel=1e-4, abs=1e-5)


def test_places_outside_the_cube_read_inside_the_table():
    made = encoding()
    x = np.array([[-3, 0.5, 9], [np.nan, 0.5, 0.5], [1e9, -1e9, 0]], np.float32)
    assert made.forward(x, 1).shape == (3, made.width)


def test_describes_itself_and_refuses_what_does_not_fit():
    made = encoding()
    again = HashEncoding.restore(made.describe(), made.values)
    assert torch.equal(again.forward(points(), 1), made.forward(points(), 2))
    with pytest.raises(InvalidValue, match="float32 values expected"):
        HashEncoding.restore(made.describe(), made.values[:-4])
    with pytest.raises(InvalidValue, match="a power of two"):
        HashEncoding(8, 3, 40, 500, made.values)
