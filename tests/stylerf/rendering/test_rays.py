"""Rays to pixels and back as a whole, against the oracle's autograd; a displacement grid's gradient with them."""

import numpy as np
import pytest
import torch

from stylerf.fields.blended_color import BlendedColor
from stylerf.fields.color_map import ColorMap
from stylerf.fields.deformation import position_gradients
from stylerf.fields.radiance_field import RadianceField
from stylerf.rendering.rays import alpha_inside, backward, render_rays
from tests.stylerf.blends import RAYS, corner, fields, layer, meets, over, picture
from tests.stylerf.small import (
    SPACES,
    Packed,
    close,
    density,
    displacement_grid,
    field_of,
    float64,
    hash_color,
    occupied,
    oracle_pixels,
    rays_into,
    vm_color,
)

COLORS = {"vm": lambda: vm_color(2), "hash": lambda: hash_color(2)}
CASES = [("box", "vm"), ("contraction", "hash"), ("frustum", "vm"), ("box", "hash")]


def thin(space, color, **more) -> RadianceField:
    """A field that rays see many samples of, some too faint for a color of their own."""
    made = field_of(space, 3, color, **more)
    made.density.values[-1] = -3.5
    return made


def pixel_gradients(count: int) -> np.ndarray:
    return np.random.default_rng(7).normal(size=(count, 5)).astype(np.float32)


@pytest.mark.parametrize("displaced", [False, True])
@pytest.mark.parametrize(("kind", "color"), CASES)
def test_pixels_and_parameter_gradients_equal_the_oracle(kind, color, displaced):
    moved = displacement_grid(5) if displaced else None
    field, rays = thin(SPACES[kind], COLORS[color](), displacement=moved), rays_into(SPACES[kind], 40, 4)
    gradients = pixel_gradients(40)
    values = [float64(part.values).requires_grad_() for part in (field.density, field.color)]
    for threads in (1, 2):
        rendered = render_rays(field, rays, threads=threads, weight_threshold=0.1)
        colored = rendered.colors[Packed.of(rendered.samples).at, 0] >= 0
        assert 0.2 < colored.mean() < 0.95
        expected, _ = oracle_pixels(field, rays, rendered, *values, None if moved is None else float64(moved))
        # Distances along a contraction's rays reach a thousand units; each column is as exact as its own scale.
        for column in (slice(0, 3), slice(3, 4), slice(4, 5)):
            close(rendered.out[:, column], expected[:, column], 1e-5)
        used = gradients.copy()
        if kind != "box":
            used[:, 4] *= 1e-2
        loss = (expected * float64(used)).sum()
        wanted = torch.autograd.grad(loss, values)
        to = [np.zeros((threads, len(part.values)), np.float32) for part in (field.density, field.color)]
        backward(field, rendered, used, *to)
        for found, gradient in zip(to, wanted):
            close(found.sum(0, dtype=np.float64), gradient, 1e-4)


@pytest.mark.parametrize(("kind", "color"), [*CASES, ("frustum", "hash")])
def test_displacement_gradient_of_a_render_equals_the_oracle(kind, color):
    moved = displacement_grid(6)
    field, rays = thin(SPACES[kind], COLORS[color](), displacement=moved), rays_into(SPACES[kind], 40, 4)
    rendered, gradients = render_rays(field, rays, threads=2, weight_threshold=0.1), pixel_gradients(40)
    gradients[:, 4] *= 1e-2
    to = np.zeros((2, moved.size), np.float32)
    backward(field, rendered, gradients, None, None, to)
    grid = float64(moved).requires_grad_()
    out, _ = oracle_pixels(field, rays, rendered, *(float64(p.values) for p in (field.density, field.color)), grid)
    (wanted,) = torch.autograd.grad((out * float64(gradients)).sum(), grid)
    close(to.sum(0, dtype=np.float64), wanted.flatten(), 2e-4)


def test_a_part_may_be_held_fixed_while_the_other_bends():
    field, rays = thin(SPACES["box"], hash_color(2), displacement=displacement_grid(6)), rays_into(SPACES["box"], 9, 4)
    rendered = render_rays(field, rays, threads=2)
    s, random = rendered.samples, np.random.default_rng(0)
    at = Packed.of(s).at
    to_sigma, to_colors = (np.zeros(a.shape, np.float32) for a in (s.sigma, rendered.colors))
    to_sigma[at], to_colors[at] = random.normal(size=len(at)), random.normal(size=(len(at), 3))
    both, dense, bright = (
        position_gradients(*parts, s, rendered.basis, to_sigma, rendered.colors, to_colors, 2)[at]
        for parts in ((field.density, field.color), (field.density, None), (None, field.color))
    )
    assert dense.any() and bright.any()
    close(dense + bright, both, 1e-6)


def test_a_zero_displacement_changes_nothing_an_even_one_moves_all():
    space, rays = SPACES["box"], rays_into(SPACES["box"], 30, 4)
    plain = render_rays(thin(space, hash_color(2)), rays, threads=1)
    still = render_rays(thin(space, hash_color(2), displacement=np.zeros((4, 4, 4, 3), np.float32)), rays, threads=1)
    np.testing.assert_allclose(still.out, plain.out, atol=1e-6)
    shift = np.full((4, 4, 4, 3), 0.02, np.float32)
    moved = render_rays(thin(space, hash_color(2), displacement=shift), rays, threads=1)
    assert np.abs(moved.out - plain.out).max() > 0.02
    inside = Packed.of(moved.samples)
    where = oracle_positions(space, rays, inside) + 0.02
    np.testing.assert_allclose(inside.x, where.clamp(0, 1), atol=3e-6)


def oracle_positions(space, rays, packed) -> torch.Tensor:
    origins, directions = float64(rays.origins)[packed.rays], float64(rays.directions)[packed.rays]
    return torch.from_numpy(space.warp((origins + packed.t[:, None] * directions).numpy()))


def test_parts_without_a_buffer_are_left_out():
    field, rays = thin(SPACES["box"], vm_color(2)), rays_into(SPACES["box"], 20, 4)
    rendered, gradients = render_rays(field, rays, threads=1), pixel_gradients(20)
    both = [np.zeros((1, len(part.values)), np.float32) for part in (field.density, field.color)]
    backward(field, rendered, gradients, *both)
    alone = [np.zeros_like(b) for b in both]
    backward(field, rendered, gradients, alone[0], None)
    backward(field, rendered, gradients, None, alone[1])
    assert all(np.array_equal(a, b) and a.any() for a, b in zip(alone, both))


def test_density_learns_within_cells_or_without_and_both_add_up_to_all():
    field, rays = thin(SPACES["box"], vm_color(2)), rays_into(SPACES["box"], 20, 4)
    rendered, gradients = render_rays(field, rays, threads=1), pixel_gradients(20)
    cells = np.random.default_rng(6).random((5, 5, 5)) < 0.4
    parts = []
    for within in (None, cells, ~cells):
        parts.append(np.zeros((1, len(field.density.values)), np.float32))
        backward(field, rendered, gradients, parts[-1], None, density_within=within)
    assert parts[1].any() and parts[2].any()
    close(parts[1] + parts[2], parts[0], 1e-5)


def test_rays_through_nothing_are_black_clear_and_teach_nothing():
    field, rays = thin(SPACES["box"], vm_color(2)), rays_into(SPACES["box"], 5, 4)
    rays.directions[:] = -rays.directions
    rendered = render_rays(field, rays, threads=2)
    assert rendered.samples.total == 0 and not rendered.out.any()
    to = [np.zeros((2, len(part.values)), np.float32) for part in (field.density, field.color)]
    backward(field, rendered, pixel_gradients(5), *to)
    assert not to[0].any() and not to[1].any()


def matched(field: RadianceField) -> RadianceField:
    field.color_map = ColorMap(torch.diag(torch.tensor([0.5, 0.4, 2.0])), torch.tensor([0.1, -0.3, 0.5]))
    return field


def test_a_color_map_acts_on_premultiplied_pixels_within_their_alpha():
    rays = rays_into(SPACES["box"], 40, 4)
    plain = render_rays(thin(SPACES["box"], vm_color(2)), rays, threads=1).out
    found = render_rays(matched(thin(SPACES["box"], vm_color(2))), rays, threads=1).out
    alpha = plain[:, 3:4]
    expected = np.clip(plain[:, :3] * [0.5, 0.4, 2.0] + alpha * [0.1, -0.3, 0.5], 0, alpha)
    np.testing.assert_allclose(found[:, :3], expected, atol=1e-6)
    assert np.array_equal(found[:, 3:], plain[:, 3:])
    assert (found[:, 1] == 0).any() and (found[:, 2:3] == alpha).any()  # the clamp has something to do


def test_gradients_are_those_of_the_colors_before_a_color_map():
    rays, gradients, found = rays_into(SPACES["box"], 40, 4), pixel_gradients(40), []
    for field in (thin(SPACES["box"], vm_color(2)), matched(thin(SPACES["box"], vm_color(2)))):
        rendered = render_rays(field, rays, threads=1, weight_threshold=0.3)
        to = [np.zeros((1, len(part.values)), np.float32) for part in (field.density, field.color)]
        backward(field, rendered, gradients, *to)
        found.append(to)
    assert all(np.array_equal(a, b) for a, b in zip(*found))


@pytest.mark.parametrize("kind", ["box", "contraction"])
def test_near_samples_learn_by_the_square_of_their_distance(kind):
    """One ray of one colored sample: what it teaches falls as (t / distance)^2, and not at all beyond `distance`."""
    field, rays = thin(SPACES[kind], vm_color(2)), rays_into(SPACES[kind], 12, 4)
    rendered = render_rays(field, rays, threads=1, weight_threshold=1.0)
    packed = Packed.of(rendered.samples).at
    lit = packed[rendered.colors[packed, 0] >= 0]
    gradients = np.zeros((12, 5), np.float32)
    ray = int(np.searchsorted(rendered.samples.ends, lit[0], side="right"))
    gradients[ray, :3] = 1.0
    at = float(rendered.samples.t[lit[0]])
    learned = {}
    for distance in (0.0, 0.5 * at, at, 2 * at, 4 * at):
        to = np.zeros((1, len(field.color.values)), np.float32)
        backward(field, rendered, gradients, None, to, near_scaling_distance=distance)
        learned[distance] = to[0]
    plain = learned.pop(0.0)
    assert np.abs(plain).max() > 0
    for distance, found in learned.items():
        np.testing.assert_allclose(found, plain * min(1.0, at / distance) ** 2, atol=1e-6 * np.abs(plain).max())


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
