"""Weights in marked cells against a loop over samples."""

import numpy as np

from stylerf.fields.radiance_field import RadianceField
from stylerf.rendering.region_alpha import alpha_inside
from tests.stylerf.small import SPACES, density, occupied, rays_into, vm_color


def test_alpha_inside_sums_the_weights_of_marked_cells():
    space = SPACES["box"]
    field = RadianceField(space, density(1), vm_color(2), occupied(), 0.02)
    samples = field.march(rays_into(space, 40, 3), 128, 1e-3, 2)
    marked = np.random.default_rng(4).random((5, 5, 5)) < 0.4
    expected = np.zeros(40)
    for ray in range(40):
        for k in range(samples.starts[ray], samples.ends[ray]):
            cell = np.minimum((samples.x[k] * 5).astype(int), 4)
            expected[ray] += samples.weights[k] * marked[tuple(cell)]
    assert expected.max() > 0.1
    np.testing.assert_allclose(alpha_inside(marked, samples, 2), expected, atol=1e-5)
