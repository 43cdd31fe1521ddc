"""Total variation of hash and voxel grids: the gradient of an energy that torch works out in float64."""

import numpy as np
import pytest
import torch

from stylerf.fields.hash_grid import Levels
from stylerf.fields.voxel import Grid
from tests.stylerf.kernels.cpu.test_vm import buffers
from tests.stylerf.small import SMALL, SPARSE, close, float64, hash_density, headed, voxel_density


def differences(grid: torch.Tensor, there: torch.Tensor | None = None) -> torch.Tensor:
    """Half the summed squared differences of neighbors of [a, b, c, f]; there [a, b, c]: of pairs that both are."""
    total = grid.new_zeros(())
    for axis in range(3):
        count = grid.shape[axis] - 1
        steps = grid.narrow(axis, 1, count) - grid.narrow(axis, 0, count)
        if there is not None:
            steps = steps * (there.narrow(axis, 1, count) & there.narrow(axis, 0, count))[..., None]
        total = total + (steps**2).sum() / 2
    return total


def energy_of_levels(levels: Levels, table: torch.Tensor) -> torch.Tensor:
    total = table.new_zeros(())
    for level in range(levels.active):
        own = table[levels.firsts[level] : levels.firsts[level + 1]]
        side = levels.cells[level] + 1
        if side**3 * levels.width == len(own):
            total = total + differences(own.reshape(side, side, side, levels.width))
        else:
            total = total + (own**2).sum() / 2
    return total


def energy_of_grid(grid: Grid, table: torch.Tensor, width: int) -> torch.Tensor:
    """Laid out vertex by vertex: a slow loop over the blocks."""
    a, b, c = (int(n) for n in grid.size)
    numbers = np.full((a, b, c), -1)
    for number, (i, j, k) in enumerate(np.argwhere(grid.kept), start=1):
        for u, v, w in np.ndindex(4, 4, 4):
            place = 4 * i + u, 4 * j + v, 4 * k + w
            if all(p < n for p, n in zip(place, (a, b, c))):
                numbers[place] = ((number * 4 + u) * 4 + v) * 4 + w
    rows = table.reshape(-1, width)[torch.from_numpy(numbers.clip(0))]
    return differences(rows, torch.from_numpy(numbers >= 0))


MADE = {
    "hash density": lambda: hash_density(3),
    "voxel density": lambda: voxel_density(3),
    "hash color": lambda: headed(4, "hash", "linear", capacity=SMALL),
    "voxel color": lambda: headed(4, "voxel", "linear", capacity=SPARSE),
}


@pytest.mark.parametrize("name", MADE)
def test_smoothness_is_the_gradient_of_neighbors_squared_differences(name):
    made = MADE[name]()
    values = float64(made.values).requires_grad_()
    features = made if made.kind != "headed" else made.features
    length = len(made.table)
    if features.kind == "hash":
        assert 0 < sum(map(features.levels.is_direct, range(8))) < features.levels.active < 8
        energy = energy_of_levels(features.levels, values[:length])
    else:
        assert not features.grid.kept.all()
        energy = energy_of_grid(features.grid, values[:length], length // features.grid.rows)
    energy.backward()
    to = buffers(1, len(made.values))[0]
    before = to.copy()
    made.smooth(3.0, to)
    close(to.astype(np.float64) - before, 3.0 / length * values.grad, 1e-3)  # small beside what it was added to
    assert np.array_equal(to[length:], before[length:])
