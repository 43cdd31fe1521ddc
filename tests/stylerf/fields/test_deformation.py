"""The deformation network, and the grid that it is baked to."""

import math

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.fields.deformation import (
    FARTHEST,
    SCALE,
    Deformation,
    displaced_occupancy,
    occupancy_of_seen,
    seen_cells,
    vertices_of,
)
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.kernels.cpu.ray_samples import Rays
from tests.stylerf.small import SPACES, field_of, hash_color, rays_into


def test_it_starts_as_the_identity_and_every_other_weight_is_alive():
    made = Deformation.create(np.random.default_rng(0))
    places = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
    assert not made.network(made.encode(places), torch.from_numpy(made.values)).any()
    assert np.mean(made.values != 0) > 0.95


def test_encoding_is_position_and_octaves_of_sine_and_cosine():
    made = Deformation.create(np.random.default_rng(0), frequencies=3, width=8)
    x = torch.tensor([[0.3, 0.5, 0.9]])
    p = [-0.4, 0.0, 0.8]
    expected = list(p)
    for octave in range(3):
        expected += [math.sin(2**octave * math.pi * v) for v in p] + [math.cos(2**octave * math.pi * v) for v in p]
    np.testing.assert_allclose(made.encode(x)[0], expected, atol=1e-5)


def test_network_equals_matrices_by_hand():
    random = np.random.default_rng(1)
    made = Deformation.create(random, frequencies=1, width=4)
    made.values[:] = random.normal(size=len(made.values))
    v, at, layers = made.values.astype(np.float64), 0, []
    for inside, outside in ((9, 4), (4, 4), (4, 3)):
        layers.append((v[at : at + inside * outside].reshape(outside, inside), v[at + inside * outside :][:outside]))
        at += (inside + 1) * outside
    encoded = made.encode(torch.rand(5, 3, generator=torch.Generator().manual_seed(1)))
    out = encoded.double().numpy()
    for number, (weight, bias) in enumerate(layers):
        out = out @ weight.T + bias
        out = np.maximum(out, 0) if number < 2 else out
    found = made.network(encoded, torch.from_numpy(made.values))
    np.testing.assert_allclose(found, FARTHEST * np.tanh(0.5 * SCALE / FARTHEST * out), rtol=1e-4, atol=1e-6)


def test_nothing_moves_farther_than_the_bound_whatever_the_weights():
    made = Deformation.create(np.random.default_rng(3), 2, 8)
    encoded = made.encode(torch.rand(50, 3, generator=torch.Generator().manual_seed(1)))
    wild = torch.full((len(made.values),), 30.0)
    moved = made.network(encoded, wild).abs()
    assert float(moved.max()) <= FARTHEST * 1.001
    assert float(moved.max()) > 0.9 * FARTHEST  # the bound, and not weakness, holds it


def test_values_of_another_size_are_refused():
    with pytest.raises(InvalidValue, match="do not make a network of width 4"):
        Deformation(1, 4, np.zeros(10, np.float32))


def test_occupancy_follows_a_shift_by_whole_cells():
    """x is occupied where x + D is: an even D of two cells moves the occupied block two cells back."""
    cells = 8
    occupied = np.zeros((cells,) * 3, bool)
    occupied[4:6, 3, 3] = True
    rest = OccupancyGrid(cells)
    rest.set_occupied(occupied.ravel())
    shift = np.zeros((5, 5, 5, 3), np.float32)
    shift[..., 0] = 2 / cells
    moved = displaced_occupancy(rest, shift).distances.reshape((cells,) * 3) == 0
    np.testing.assert_array_equal(moved, np.roll(occupied, -2, 0))


def test_reach_bounds_displacements_and_is_kept_with_the_network():
    made = Deformation.create(np.random.default_rng(0))
    made.reach = 0.1
    made.values[-3:] = 1e3  # the last biases: as far as it can
    again = Deformation.restore(made.describe(), made.values)
    moved = again.network(again.encode(torch.zeros(1, 3)), torch.from_numpy(again.values))
    np.testing.assert_allclose(moved, 0.1, rtol=1e-6)
    without = {key: value for key, value in made.describe().items() if key != "reach"}
    assert Deformation.restore(without, made.values).reach == FARTHEST


def expected_vertices(field, rays: Rays, vertices: int, share: float) -> set[int]:
    samples, found = field.march(rays, 512, 1e-3, 1), set()
    for a, b in zip(samples.starts, samples.ends):
        for k in range(a, b):
            if samples.weights[k] >= np.float32(share) * samples.weights[a:b].max() and samples.weights[k] > 0:
                low = np.minimum((samples.x[k] * np.float32(vertices - 1)).astype(int), vertices - 2)
                found |= {int(np.ravel_multi_index(low + d, (vertices,) * 3)) for d in np.ndindex(2, 2, 2)}
    return found


def test_vertices_around_what_is_seen():
    for kind in ("box", "frustum"):
        field, rays = field_of(SPACES[kind], 3, hash_color(2)), rays_into(SPACES[kind], 30, 4, jitter=False)
        for share in (0.1, 0.9):
            found = vertices_of(seen_cells(field, rays, 8, share, 2))
            assert (np.diff(found) > 0).all() and 20 < len(found) < 9**3
            assert set(found.tolist()) == expected_vertices(field, rays, 9, share)


def test_occupancy_without_what_no_ray_sees():
    """Nothing is added; each cell that holds a large weight stays."""
    field, rays = field_of(SPACES["box"], 3, hash_color(2)), rays_into(SPACES["box"], 30, 4, jitter=False)
    field.density.values[-1] += 3  # opaque enough that the far side of the box is out of sight
    found = occupancy_of_seen(field, rays, 2)
    before, after = field.occupancy.distances == 0, found.distances == 0
    seen = seen_cells(field, rays, field.occupancy.cells, 0.02, 2).ravel()
    assert not (after & ~before).any() and (after[seen & before]).all() and after.sum() < before.sum()
