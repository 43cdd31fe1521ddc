"""Which vertices of a displacement grid matter: those around what rays see, by a loop over samples."""

import numpy as np

from stylerf.fields.displacement import visible_vertices
from stylerf.fields.samples import Rays
from tests.stylerf.small import SPACES, field_of, hash_colour, rays_into


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
        field, rays = field_of(SPACES[kind], 3, hash_colour(2)), rays_into(SPACES[kind], 30, 4, jitter=False)
        for share, at_once in ((0.1, 8192), (0.9, 7)):
            found = visible_vertices(field, rays, 9, share, 2, at_once)
            assert (np.diff(found) > 0).all() and 20 < len(found) < 9**3
            assert set(found.tolist()) == expected_vertices(field, rays, 9, share)
