"""A colour that is a mix of a palette: values and gradients against a float64 writing-out; edits, restoring."""

import json

import numpy as np
import pytest
import torch

from stylerf.editing.palette_edits import PaletteEdits
from stylerf.editing.recoloring import Recolouring, SpaceFilter
from stylerf.errors import InvalidValue
from stylerf.fields.palette_color import PaletteColour
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.ray_samples import Rays
from stylerf.geometry.space_warp import Space
from stylerf.kernels import torch_reference
from stylerf.rendering.rays import render_rays
from tests.stylerf.kernels.cpu.test_vm import RAYS, added, basis_of, buffers, owned, samples
from tests.stylerf.small import close, field_of, float64, rays_into

PALETTE = np.float32([[0.7, 0.2, 0.1], [0.1, 0.3, 0.6], [0.2, 0.5, 0.2], [0.8, 0.8, 0.7]])
BOX = Space.box([-1, -1, -1], [1, 1, 1])


def made(seed: int = 4) -> PaletteColour:
    """Features and head such that no place is like another, and few colours end at 0 or 1."""
    colour = PaletteColour.create(np.random.default_rng(seed), PALETTE, 8, 40, 512, base=3)
    generator = np.random.default_rng(seed)
    colour.table[:] = generator.normal(scale=0.6, size=len(colour.table))
    numbers = colour.rest[12:]
    numbers += generator.normal(scale=0.05, size=len(numbers)).astype(np.float32)
    return colour


def written_out(colour: PaletteColour, values: torch.Tensor, basis: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """The formula of fields/palette_head.py, term by term."""
    levels, m = colour.features.levels, colour.bases
    table, palette, numbers = values.split([colour.features.length, 3 * m, colour.head.length])
    rows = torch_reference.hash_levels(table, levels.count, levels.base, levels.finest, levels.table, x, 4, levels.active)
    phi, at, nets = rows.flatten(1), 0, []
    for inside, outside in ((32, 3), (41, 32), (32, 3), (35, 64), (64, 15), (15, 4 * m + 1)):
        weight = numbers[at : at + inside * outside].reshape(outside, inside)
        nets.append((weight, numbers[at + inside * outside : at + (inside + 1) * outside]))
        at += (inside + 1) * outside
    a, s1, s2, f1, f2, o = (lambda v, w=w, b=b: v @ w.T + b for w, b in nets)
    diffuse = 1 / (1 + torch.exp(-a(phi)))
    specular = torch.tanh(s2(torch.relu(s1(torch.cat([phi, basis], 1)))))
    told = o(f2(torch.relu(f1(torch.cat([phi, diffuse], 1)))))
    raw = torch.log1p(torch.exp(told[:, :m])) + 0.05
    total = specular
    for i in range(m):
        offset = told[:, m + 3 * i : m + 3 * i + 3]
        share = raw[:, i] / raw.sum(1)
        total = total + (share * torch.log1p(torch.exp(told[:, -1])))[:, None] * (palette.reshape(m, 3)[i] + offset)
    return total.clamp(0, 1)


def test_colours_and_gradients_equal_the_formula():
    colour, s = made(), samples(5)
    basis = basis_of(s, 2)
    s.weights[[4, 11, 30]] = 0
    at, rays = owned(s), np.repeat(np.arange(RAYS), s.ends - s.starts)
    values = float64(colour.values).requires_grad_()
    expected = written_out(colour, values, float64(basis[rays]), float64(s.x[at]))
    shown = s.weights[at] > 0
    assert 0.02 < expected.detach()[shown].std() and ((expected > 0) & (expected < 1)).float().mean() > 0.6
    gradients = np.random.default_rng(6).normal(size=(len(s.x), 3)).astype(np.float32)
    (expected * float64(gradients[at]))[shown].sum().backward()
    for chunks in (1, 3):
        found = colour.colours(s.x, basis, s.starts, s.ends, s.weights, 0.0, chunks)
        close(found[at][shown], expected[shown], 1e-5)
        assert (found[at][~shown, 0] == -1).all() and (~shown).sum() == 3
        to = buffers(chunks, len(colour.values))
        colour.backward(s.x, basis, s.starts, s.ends, found, gradients, to)
        close(added(to), values.grad, 5e-5)


def test_position_gradient_equals_the_formula():
    colour, s = made(), samples(5)
    basis = basis_of(s, 2)
    s.x[:] = np.random.default_rng(4).uniform(0.01, 0.99, s.x.shape)
    at, rays = owned(s), np.repeat(np.arange(RAYS), s.ends - s.starts)
    x = float64(s.x[at]).requires_grad_()
    gradients = np.random.default_rng(6).normal(size=(len(s.x), 3)).astype(np.float32)
    colours = colour.colours(s.x, basis, s.starts, s.ends, s.weights, 0.0, 1)
    expected = written_out(colour, float64(colour.values), float64(basis[rays]), x)
    (expected * float64(gradients[at])).sum().backward()
    out = np.full(s.x.shape, 0.25, np.float32)
    colour.add_position_gradients(s, basis, colours, gradients, out, 1)
    close(out[at] - 0.25, x.grad, 5e-5)
    assert (np.delete(out, at, 0) == 0.25).all()


def test_least_is_a_bound_that_must_be_passed():
    colour, s = made(), samples()
    s.weights[:] = np.linspace(0, 1, len(s.x))
    found = colour.colours(s.x, basis_of(s, 2), s.starts, s.ends, s.weights, float(s.weights[20]), 1)
    assert np.array_equal(found[owned(s), 0] >= 0, owned(s) > 20)


def test_parts_of_values_learn_at_their_own_rates_and_none_twice():
    colour = made()
    begins, ends = zip(*((begin, end) for begin, end, _ in colour.groups()))
    assert begins == (0, *ends[:-1]) and ends[-1] == len(colour.values)
    assert colour.values[begins[1] : ends[1]].tolist() == PALETTE.ravel().tolist()


def test_the_branch_kept_apart_teaches_the_diffuse_colour_nothing():
    colour = made()
    rest = torch.from_numpy(colour.rest.copy()).requires_grad_()
    phi = torch.rand(6, 32, generator=torch.Generator().manual_seed(0))
    for apart, learns in ((True, False), (False, True)):
        parts, palette = colour.parts(rest, phi, torch.ones(6, 9), apart)
        (slope,) = torch.autograd.grad(parts.mixed(palette).sum(), rest)
        diffuse = slope[12 : 12 + 33 * 3]
        assert (diffuse.abs().max() > 0) == learns and slope[:12].abs().max() > 0


def test_an_edited_field_is_an_ordinary_one_that_comes_back_to_the_bit():
    """Through describe, JSON and arrays, as on disk; edits here and everywhere."""
    plain = field_of(BOX, 3, made())
    within = SpaceFilter(BOX, ((0.1, 0.0, -0.2),), 0.5)
    plain.colour = plain.colour.edited(Recolouring(PaletteEdits({0: (0.1, 0.8, 0.2)}), within=within))
    edited = field_of(BOX, 3, plain.colour.edited(Recolouring(PaletteEdits({}, {2: 0.0}), 0.5, 0.0)))
    assert edited.colour.values is plain.colour.values and len(edited.colour.edits) == 2
    rays = rays_into(BOX, 40, 1)
    first = render_rays(edited, rays, chunks=2)
    again = RadianceField.restore(json.loads(json.dumps(edited.describe())), edited.arrays())
    assert np.array_equal(render_rays(again, rays, chunks=2).out, first.out)
    assert again.colour.describe() == edited.colour.describe()
    assert np.abs(first.out - render_rays(plain, rays, chunks=2).out).max() > 0.02
    np.testing.assert_allclose(edited.colour.present_palette, [[0.1, 0.8, 0.2], *PALETTE[1:]], atol=1e-7)


def test_an_edit_around_a_place_leaves_far_rays_as_they_were():
    colour = made()
    here = SpaceFilter(BOX, ((0.8, 0.8, 0.8),), 0.1)
    plain, edited = field_of(BOX, 3, colour), field_of(BOX, 3, colour)
    edited.colour = colour.edited(Recolouring(PaletteEdits({i: (0.0, 1.0, 0.0) for i in range(4)}), within=here))
    rays = Rays.of(np.float32([[0.8, 0.8, 4], [-0.8, -0.8, 4]]), np.tile(np.float32([0, 0, -1]), (2, 1)), 0.0)
    before, after = (render_rays(one, rays, chunks=1).out for one in (plain, edited))
    np.testing.assert_allclose(before[1], after[1], atol=2e-6)
    assert np.abs(before[0, :3] - after[0, :3]).max() > 1e-3


def test_gradients_of_an_edited_colour_pass_through_the_edit():
    """Against differences in float64, along random ways of palette and head.

    The new colour is less saturated than the old: at a ratio of 1 the purest colours lie where saturation is clamped.
    """
    colour = made().edited(Recolouring(PaletteEdits({1: (0.6, 0.5, 0.2)}, {0: 2.0}), 0.5, 0.5))
    s = samples(5)
    basis, at, rays = basis_of(s, 2), owned(s), np.repeat(np.arange(RAYS), s.ends - s.starts)
    gradients = np.random.default_rng(6).normal(size=(len(s.x), 3)).astype(np.float32)
    to = np.zeros((1, len(colour.values)), np.float32)
    found = colour.colours(s.x, basis, s.starts, s.ends, s.weights, 0.0, 1)
    colour.backward(s.x, basis, s.starts, s.ends, found, gradients, to)
    phi = float64(colour.features.encode(colour.table, s.x, at, 1))
    for seed in range(3):
        way = torch.randn(len(colour.rest), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        below, above = (
            colour._shown(float64(colour.rest) + step * way, phi, float64(basis[rays]), s.x[at])
            for step in (-1e-7, 1e-7)
        )
        expected = float(((above - below) * float64(gradients[at])).sum()) / 2e-7
        assert float(to[0, colour.features.length :] @ way.numpy()) == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_values_and_edits_that_do_not_fit_are_refused():
    colour = made()
    with pytest.raises(InvalidValue, match="values where"):
        PaletteColour(colour.features, 5, colour.values)
    with pytest.raises(InvalidValue, match="there are 0 to 3"):
        colour.edited(Recolouring(PaletteEdits({4: (0, 0, 0)})))
