"""Which vertices of a displacement grid matter: those around what rays see, by a loop over samples."""

import numpy as np

from stylerf.fields.displacement_grid import occupancy_of_seen, seen_cells, vertices_of
from stylerf.kernels.cpu.ray_samples import Rays
from tests.stylerf.small import SPACES, field_of, hash_color, rays_into


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
