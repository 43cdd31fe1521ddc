"""Pictures of blended colors against pictures of the fields that they mix."""

import numpy as np
import pytest
import torch

from stylerf.fields.blended_color import BlendedColor
from stylerf.rendering.rays import render_rays
from tests.stylerf.blends import RAYS, corner, fields, layer, meets, over, picture
from tests.stylerf.small import SPACES, field_of

ROUNDING = 1e-6


def test_a_picture_of_a_mix_is_the_mix_of_the_pictures():
    """Also where a field's color map is clamped, and with each field's own threshold."""
    made = fields()
    weights = {"source": 0.2, "mapped": 0.5, "plain": 0.3}
    mixed = picture(over(made["source"], *(layer(made[name], weight) for name, weight in weights.items())))
    expected = sum(weight * picture(made[name])[:, :3] for name, weight in weights.items())
    clamped = picture(made["mapped"])[:, :3]
    assert (clamped == 0).any() and (clamped > 0.1).any()
    np.testing.assert_allclose(mixed[:, :3], expected, atol=ROUNDING)
    np.testing.assert_array_equal(mixed[:, 3:], picture(made["source"])[:, 3:])


@pytest.mark.parametrize("name", ["source", "mapped", "plain"])
def test_a_layer_that_counts_all_is_its_field_to_the_bit(name):
    made = fields()
    found = picture(over(made["source"], layer(made[name], 1.0), layer(made["plain"], 0.0)))
    np.testing.assert_array_equal(found, picture(made[name]))


def test_rays_that_miss_a_region_keep_every_bit():
    made, marked = fields(), corner()
    found = picture(over(made["source"], layer(made["mapped"], 1.0), layer(made["plain"], 1.0, marked)))
    before, met = picture(made["mapped"]), meets(made["source"], marked)
    assert 5 < met.sum() < len(met) - 5
    np.testing.assert_array_equal(found[~met], before[~met])
    assert (np.abs(found - before)[met].max(1) > 1e-4).mean() > 0.5


def test_shares_of_samples_weigh_colors_as_a_slow_sum_does():
    """Without color maps a pixel is the sum of w (1 - v m) c and w v m c' over samples, taken here one by one."""
    made, marked, opacity = fields(), corner(), 0.7
    below, above = made["source"], made["plain"]
    blend = over(below, layer(below, 1.0), layer(above, opacity, marked))
    for part in blend.color.layers:  # every sample is colored
        object.__setattr__(part, "weight_threshold", 0.0)
    found = picture(blend)
    seen = [render_rays(field, RAYS, threads=2, weight_threshold=0.0) for field in (below, above)]
    samples, expected = seen[0].samples, np.zeros((len(found), 3))
    for ray, (start, end) in enumerate(zip(samples.starts, samples.ends)):
        for k in range(start, end):
            cell = np.clip((samples.x[k] * np.float32(len(marked))).astype(int), 0, len(marked) - 1)
            share = opacity * float(marked[tuple(cell)])
            mixed = (1 - share) * seen[0].colors[k].astype(float) + share * seen[1].colors[k]
            expected[ray] += float(samples.weights[k]) * mixed if samples.weights[k] > 0 else 0
    np.testing.assert_allclose(found[:, :3], expected, atol=1e-5)


def test_of_two_regions_the_later_covers_the_earlier():
    made, marked = fields(), corner()
    stack = {"source": None, "plain": marked, "mapped": marked}
    layers = [layer(made[name], 1.0, where) for name, where in stack.items()]
    found = picture(over(made["source"], *layers))
    np.testing.assert_array_equal(found, picture(over(made["source"], layers[0], layers[2])))


def test_a_blend_of_blends_mixes_their_pictures():
    made, marked = fields(), corner()
    inner = [
        over(made["source"], layer(made["source"], 1.0), layer(made["mapped"], 0.6, marked)),
        over(made["source"], layer(made["plain"], 0.25), layer(made["mapped"], 0.75)),
    ]
    found = picture(over(made["source"], layer(inner[0], 0.4), layer(inner[1], 0.6)))
    expected = 0.4 * picture(inner[0]) + 0.6 * picture(inner[1])
    np.testing.assert_allclose(found[:, :3], expected[:, :3], atol=ROUNDING)


def test_threads_do_not_change_a_blend():
    made = fields()
    field = over(made["source"], layer(made["plain"], 1.0), layer(made["mapped"], 0.5, corner()))
    np.testing.assert_array_equal(picture(field, threads=1), picture(field, threads=3))


def test_opaque_backgrounds_are_blended_too():
    source = field_of(SPACES["contraction"], 3)
    other = fields("contraction")["plain"]
    found, first, second = (
        render_rays(field, RAYS, threads=2, weight_threshold=field.weight_threshold).out
        for field in (over(source, layer(source, 0.5), layer(other, 0.5)), source, other)
    )
    np.testing.assert_allclose(found[:, :3], 0.5 * (first + second)[:, :3], atol=ROUNDING)


def test_colors_at_samples_are_mapped_clamped_and_mixed():
    made = fields()
    blend = BlendedColor([layer(made["source"], 0.25), layer(made["mapped"], 0.75)])
    seen = {name: render_rays(made[name], RAYS, threads=2, weight_threshold=0.0) for name in ("source", "mapped")}
    samples = seen["source"].samples
    points = samples.shading_points()
    found = blend.colors(points, seen["source"].basis, 2)
    there = np.concatenate([np.arange(*pair) for pair in zip(samples.starts, samples.ends)])
    there = there[samples.weights[there] > 0]
    mapped = made["mapped"].color_map(torch.from_numpy(seen["mapped"].colors[there])).clamp(0, 1).numpy()
    expected = 0.25 * seen["source"].colors[there] + 0.75 * mapped
    np.testing.assert_allclose(found[there], expected, atol=ROUNDING)
