"""A color that is a mix of a palette: values and gradients against a float64 writing-out; edits, restoring."""

import json

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.fields.palette_color import MOST_EDITS, PaletteColor
from stylerf.fields.palette_edits import PaletteEdits, Recoloring, SpaceFilter
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.region_color import RegionColor
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import render_rays
from tests.stylerf.kernels import torch_reference
from tests.stylerf.kernels.cpu.test_vm import RAYS, added, basis_of, buffers, owned, samples
from tests.stylerf.small import close, field_of, float64, rays_into

PALETTE = np.float32([[0.7, 0.2, 0.1], [0.1, 0.3, 0.6], [0.2, 0.5, 0.2], [0.8, 0.8, 0.7]])
BOX = SpaceWarp.box([-1, -1, -1], [1, 1, 1])


def made(seed: int = 4) -> PaletteColor:
    """Features and head such that no place is like another, and few colors end at 0 or 1."""
    color = PaletteColor.create(np.random.default_rng(seed), PALETTE, 8, 40, 512, base=3)
    generator = np.random.default_rng(seed)
    color.table[:] = generator.normal(scale=0.6, size=len(color.table))
    numbers = color.rest[12:]
    numbers += generator.normal(scale=0.05, size=len(numbers)).astype(np.float32)
    return color


def written_out(color: PaletteColor, values: torch.Tensor, basis: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """The formula of fields/palette_color.py, term by term."""
    levels, m = color.features.levels, color.bases
    table, palette, numbers = values.split([color.features.length, 3 * m, color.head.length])
    rows = torch_reference.hash_levels(
        table, levels.count, levels.base, levels.finest, levels.table, x, 4, levels.active
    )
    phi, at, nets = rows.flatten(1), 0, []
    for inside, outside in ((32, 3), (41, 32), (32, 3), (35, 64), (64, 15), (15, 4 * m + 1)):
        weight = numbers[at : at + inside * outside].reshape(outside, inside)
        nets.append((weight, numbers[at + inside * outside : at + (inside + 1) * outside]))
        at += (inside + 1) * outside
    a, s1, s2, f1, f2, o = (lambda v, w=w, b=b: v @ w.T + b for w, b in nets)
    diffuse = 1 / (1 + torch.exp(-a(phi)))
    specular = torch.tanh(s2(torch.relu(s1(torch.cat([phi, basis], 1)))))
    outputs = o(f2(torch.relu(f1(torch.cat([phi, diffuse], 1)))))
    raw = torch.log1p(torch.exp(outputs[:, :m])) + 0.05
    total = specular
    for i in range(m):
        offset = outputs[:, m + 3 * i : m + 3 * i + 3]
        share = raw[:, i] / raw.sum(1)
        total = total + (share * torch.log1p(torch.exp(outputs[:, -1])))[:, None] * (palette.reshape(m, 3)[i] + offset)
    return total.clamp(0, 1)


def test_colors_and_gradients_equal_the_formula():
    color, s = made(), samples(5)
    basis = basis_of(s, 2)
    s.weights[[4, 11, 30]] = 0
    at, rays = owned(s), np.repeat(np.arange(RAYS), s.ends - s.starts)
    values = float64(color.values).requires_grad_()
    expected = written_out(color, values, float64(basis[rays]), float64(s.x[at]))
    shown = s.weights[at] > 0
    assert 0.02 < expected.detach()[shown].std() and ((expected > 0) & (expected < 1)).float().mean() > 0.6
    gradients = np.random.default_rng(6).normal(size=(len(s.x), 3)).astype(np.float32)
    (expected * float64(gradients[at]))[shown].sum().backward()
    for threads in (1, 3):
        found = color.colors(s.shading_points(), basis, threads)
        close(found[at][shown], expected[shown], 1e-5)
        assert (found[at][~shown, 0] == -1).all() and (~shown).sum() == 3
        to = buffers(threads, len(color.values))
        color.backward(s.shading_points(), basis, found, gradients, to)
        close(added(to), values.grad, 5e-5)


def test_position_gradient_equals_the_formula():
    color, s = made(), samples(5)
    basis = basis_of(s, 2)
    s.x[:] = np.random.default_rng(4).uniform(0.01, 0.99, s.x.shape)
    at, rays = owned(s), np.repeat(np.arange(RAYS), s.ends - s.starts)
    x = float64(s.x[at]).requires_grad_()
    gradients = np.random.default_rng(6).normal(size=(len(s.x), 3)).astype(np.float32)
    colors = color.colors(s.shading_points(), basis, 1)
    expected = written_out(color, float64(color.values), float64(basis[rays]), x)
    (expected * float64(gradients[at])).sum().backward()
    out = np.full(s.x.shape, 0.25, np.float32)
    color.add_position_gradients(s.shading_points(), basis, colors, gradients, out, 1)
    close(out[at] - 0.25, x.grad, 5e-5)
    assert (np.delete(out, at, 0) == 0.25).all()


def test_position_gradient_passes_through_a_regions_colors_above():
    """The region shifts all logits alike: what slopes is the palette below alone."""
    below, shift, s = made(), 1.5, samples(5)
    color = RegionColor.create(below, np.ones((2, 2, 2), bool), 16.0, table=64)
    color.own.values[: color.own.grid.firsts[1]].reshape(-1, 4)[:, 3] = shift
    basis = basis_of(s, 2)
    s.x[:] = np.random.default_rng(4).uniform(0.01, 0.99, s.x.shape)
    at, rays = owned(s), np.repeat(np.arange(RAYS), s.ends - s.starts)
    x = float64(s.x[at]).requires_grad_()
    base = written_out(below, float64(below.values), float64(basis[rays]), x).clamp(1e-4, 1 - 1e-4)
    expected = torch.sigmoid(torch.logit(base) + shift)
    colors = color.colors(s.shading_points(), basis, 1)
    close(colors[at], expected, 1e-4)
    gradients = np.random.default_rng(6).normal(size=(len(s.x), 3)).astype(np.float32)
    (expected * float64(gradients[at])).sum().backward()
    out = np.zeros(s.x.shape, np.float32)
    color.add_position_gradients(s.shading_points(), basis, colors, gradients, out, 1)
    close(out[at], x.grad, 1e-3)


def test_points_without_weight_get_no_color():
    color, s = made(), samples()
    s.weights[:21] = 0
    found = color.colors(s.shading_points(), basis_of(s, 2), 1)
    assert np.array_equal(found[owned(s), 0] >= 0, owned(s) > 20)


def test_parts_of_values_learn_at_their_own_rates_and_none_twice():
    color = made()
    begins, ends = zip(*((begin, end) for begin, end, _ in color.groups()))
    assert begins == (0, *ends[:-1]) and ends[-1] == len(color.values)
    assert color.values[begins[1] : ends[1]].tolist() == PALETTE.ravel().tolist()


def test_the_branch_kept_apart_teaches_the_diffuse_color_nothing():
    color = made()
    rest = torch.from_numpy(color.rest.copy()).requires_grad_()
    phi = torch.rand(6, 32, generator=torch.Generator().manual_seed(0))
    for apart, learns in ((True, False), (False, True)):
        parts, palette = color.parts(rest, phi, torch.ones(6, 9), apart)
        (slope,) = torch.autograd.grad(parts.mixed(palette).sum(), rest)
        diffuse = slope[12 : 12 + 33 * 3]
        assert (diffuse.abs().max() > 0) == learns and slope[:12].abs().max() > 0


def test_an_edited_field_is_an_ordinary_one_that_comes_back_to_the_bit():
    """Through describe, JSON and arrays, as on disk; edits here and everywhere."""
    plain = field_of(BOX, 3, made())
    within = SpaceFilter(BOX, ((0.1, 0.0, -0.2),), 0.5)
    plain.color = plain.color.edited(Recoloring(PaletteEdits({0: (0.1, 0.8, 0.2)}), within=within))
    edited = field_of(BOX, 3, plain.color.edited(Recoloring(PaletteEdits({}, {2: 0.0}), 0.5, 0.0)))
    assert edited.color.values is plain.color.values and len(edited.color.edits) == 2
    rays = rays_into(BOX, 40, 1)
    first = render_rays(edited, rays, threads=2)
    again = RadianceField.restore(json.loads(json.dumps(edited.describe())), edited.arrays())
    assert np.array_equal(render_rays(again, rays, threads=2).out, first.out)
    assert again.color.describe() == edited.color.describe()
    assert np.abs(first.out - render_rays(plain, rays, threads=2).out).max() > 0.02
    np.testing.assert_allclose(edited.color.present_palette, [[0.1, 0.8, 0.2], *PALETTE[1:]], atol=1e-7)


def test_an_edit_around_a_place_leaves_far_rays_as_they_were():
    color = made()
    here = SpaceFilter(BOX, ((0.8, 0.8, 0.8),), 0.1)
    plain, edited = field_of(BOX, 3, color), field_of(BOX, 3, color)
    edited.color = color.edited(Recoloring(PaletteEdits({i: (0.0, 1.0, 0.0) for i in range(4)}), within=here))
    rays = Rays.of(np.float32([[0.8, 0.8, 4], [-0.8, -0.8, 4]]), np.tile(np.float32([0, 0, -1]), (2, 1)), 0.0)
    before, after = (render_rays(one, rays, threads=1).out for one in (plain, edited))
    np.testing.assert_allclose(before[1], after[1], atol=2e-6)
    assert np.abs(before[0, :3] - after[0, :3]).max() > 1e-3


def test_gradients_of_an_edited_color_pass_through_the_edit():
    """Against differences in float64, along random ways of palette and head.

    The new color is less saturated than the old: at a ratio of 1 the purest colors lie where saturation is clamped.
    """
    color = made().edited(Recoloring(PaletteEdits({1: (0.6, 0.5, 0.2)}, {0: 2.0}), 0.5, 0.5))
    s = samples(5)
    basis, at, rays = basis_of(s, 2), owned(s), np.repeat(np.arange(RAYS), s.ends - s.starts)
    gradients = np.random.default_rng(6).normal(size=(len(s.x), 3)).astype(np.float32)
    to = np.zeros((1, len(color.values)), np.float32)
    found = color.colors(s.shading_points(), basis, 1)
    color.backward(s.shading_points(), basis, found, gradients, to)
    phi = float64(color.features.encode(color.table, s.x, at, 1))
    for seed in range(3):
        way = torch.randn(len(color.rest), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        below, above = (
            color._shown(*color.parts(float64(color.rest) + step * way, phi, float64(basis[rays])), s.x[at])
            for step in (-1e-7, 1e-7)
        )
        expected = float(((above - below) * float64(gradients[at])).sum()) / 2e-7
        assert float(to[0, color.features.length :] @ way.numpy()) == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_more_edits_than_can_be_read_back_are_not_made():
    color = made()
    for _ in range(MOST_EDITS):
        color = color.edited(Recoloring(view_scale=0.5))
    assert len(PaletteColor.restore(color.describe(), color.values).edits) == MOST_EDITS
    with pytest.raises(InvalidValue, match="101 successive edits; at most 100"):
        color.edited(Recoloring())
    data = color.describe()
    data["edits"] *= 2
    with pytest.raises(InvalidValue, match="200 successive edits"):
        PaletteColor.restore(data, color.values)


def test_values_and_edits_that_do_not_fit_are_refused():
    color = made()
    with pytest.raises(InvalidValue, match="float32 values"):
        PaletteColor(color.features, 5, color.values)
    with pytest.raises(InvalidValue, match="there are 0 to 3"):
        color.edited(Recoloring(PaletteEdits({4: (0, 0, 0)})))
