"""Changes of a palette, of weights and of a decomposed field: by hand, by colorsys, and as far as filters reach."""

import colorsys
import json

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.fields.palette_edits import (
    MOST_CENTERS,
    PaletteEdits,
    Recoloring,
    SpaceFilter,
    from_hsv,
    recolored,
    shifted,
    tinted,
    to_hsv,
)
from stylerf.geometry.space_warp import SpaceWarp

PALETTE = torch.tensor([[0.8, 0.2, 0.1], [0.1, 0.3, 0.9], [0.5, 0.5, 0.5]])
SPACE = SpaceWarp.box([-2, -2, -2], [2, 2, 2])
WEIGHTS = np.array([[0.5, 0.3, 0.2], [0.0, 1.0, 0.0]], np.float32)


def test_weights_are_scaled_shifted_cut_at_zero_and_brought_back_to_one():
    changed = PaletteEdits(scales={0: 0.5}, biases={2: -0.3, 1: 0.25}).weights(WEIGHTS)
    # 0.25, 0.55, max(-0.1, 0): sum 0.8; and 0, 1.25, 0.
    np.testing.assert_allclose(changed, [[0.3125, 0.6875, 0], [0, 1, 0]], rtol=1e-6)


def test_a_row_that_loses_everything_stays_as_it_was():
    changed = PaletteEdits(scales={1: 0.0}).weights(WEIGHTS)
    np.testing.assert_allclose(changed, [[5 / 7, 0, 2 / 7], [0, 1, 0]], rtol=1e-6)


def test_colors_are_replaced_and_the_others_kept():
    palette = np.arange(9, dtype=np.float32).reshape(3, 3) / 10
    changed = PaletteEdits(colors={1: (1.5, 0, -0.5)}).palette(palette)
    np.testing.assert_allclose(changed, [palette[0], [1.5, 0, -0.5], palette[2]])
    assert palette[1, 0] == np.float32(0.3)


@pytest.mark.parametrize("name", ["colors", "scales", "biases"])
def test_a_color_that_does_not_exist_is_named_with_those_that_do(name):
    edits = PaletteEdits(**{name: {7: (0, 0, 0) if name == "colors" else 1.0}})
    for count, exist in ((5, "0 to 4"), (1, "0 alone")):
        with pytest.raises(InvalidValue, match=f"palette color 7 does not exist; there are {exist}"):
            edits.check(count)
    with pytest.raises(InvalidValue, match="color -1 does not"):
        PaletteEdits(scales={-1: 1.0}).weights(WEIGHTS)


def test_nonsense_is_refused():
    for wrong in ({"scales": {0: float("nan")}}, {"colors": {0: (0, 1)}}, {"colors": {0: (0, 1, float("inf"))}}):
        with pytest.raises(InvalidValue, match="palette color 0"):
            PaletteEdits(**wrong)


def test_go_through_json():
    edits = PaletteEdits({1: (0.1, 0.2, 0.3)}, {0: 2.0}, {3: -0.5})
    assert PaletteEdits.restore(json.loads(json.dumps(edits.describe()))) == edits
    assert edits and not PaletteEdits()


def test_a_tint_keeps_lights_and_darks_about_their_mean():
    palette = np.array([[0.8, 0.8, 0.8], [0.4, 0.4, 0.4], [0.0, 0.0, 0.0]])
    found = tinted(palette, np.array([0.5, 0.5, 0.0]), (0.5, 0.2, 0.1))
    # The mean luma is 0.6: 4/3 and 2/3 of the target, and black.
    np.testing.assert_allclose(found, [[2 / 3, 0.8 / 3, 0.4 / 3], [1 / 3, 0.4 / 3, 0.2 / 3], [0, 0, 0]], rtol=1e-6)
    assert tinted(palette, np.array([0.1, 0.9, 0.0]), (0.9, 0.9, 0.9)).max() == 1.0  # cut, not wrapped
    assert np.isfinite(tinted(palette[2:], np.array([1.0]), (0.5, 0.5, 0.5))).all()


def given(count: int, seed: int = 0) -> tuple[torch.Tensor, ...]:
    """weights, offsets, intensity, specular of places."""
    generator = torch.Generator().manual_seed(seed)
    weights = torch.rand(count, 3, generator=generator)
    offsets = 0.1 * torch.randn(count, 3, 3, generator=generator)
    specular = 0.1 * torch.randn(count, 3, generator=generator)
    intensity = 0.5 + torch.rand(count, 1, generator=generator)
    return weights / weights.sum(1, keepdim=True), offsets, intensity, specular


def test_hues_are_those_of_colorsys():
    colors = np.random.default_rng(0).random((200, 3))
    colors[:4] = [[0.3, 0.3, 0.3], [0, 0, 0], [1, 0, 0], [0.2, 0.7, 0.7]]
    found = torch.stack(to_hsv(torch.from_numpy(colors)), -1)
    np.testing.assert_allclose(found, [colorsys.rgb_to_hsv(*color) for color in colors], atol=1e-7)
    np.testing.assert_allclose(from_hsv(*found.unbind(-1)), colors, atol=1e-7)


def test_a_shift_turns_and_scales_as_the_palette_color_does():
    colors = torch.tensor([[0.5, 0.1, 0.1], [0.4, 0.2, 0.0], [0.0, 0.0, 0.0]])
    red, green, dim = torch.tensor([1.0, 0, 0]), torch.tensor([0, 1.0, 0]), torch.tensor([0.5, 0.25, 0.25])
    turned = [[0.1, 0.5, 0.1], [0.0, 0.4, 0.2], [0, 0, 0]]  # a third around: red becomes green, green blue
    np.testing.assert_allclose(shifted(colors, red, green), turned, atol=1e-6)
    # Half the value and half the saturation: 0.5, 0.1, 0.1 has value 0.5, saturation 0.8.
    np.testing.assert_allclose(shifted(colors, red, dim)[0], [0.25, 0.15, 0.15], atol=1e-6)


def test_a_changed_gray_palette_color_gives_a_new_hue_and_scales_light():
    gray, new = torch.tensor([0.5, 0.5, 0.52]), torch.tensor([0.52, 0.13, 0.13])
    found = shifted(torch.tensor([[0.26, 0.26, 0.27]]), gray, new)
    np.testing.assert_allclose(found, [[0.27, 0.0675, 0.0675]], atol=1e-4)


def test_without_edits_colors_are_the_sum_of_their_parts():
    weights, offsets, intensity, specular = given(5)
    found = recolored(weights, offsets, intensity, specular, PALETTE, (), np.zeros((5, 3), np.float32))
    for k in range(5):
        expected = specular[k].clone()
        for i in range(3):
            expected += weights[k, i] * intensity[k, 0] * (PALETTE[i] + offsets[k, i])
        np.testing.assert_allclose(found[k], expected, atol=1e-6)


def test_offsets_gloss_and_weights_are_changed_by_their_factors():
    weights, offsets, intensity, specular = given(4)
    x = np.zeros((4, 3), np.float32)
    edit = Recoloring(PaletteEdits(scales={0: 0.0}), offset_scale=0.0, view_scale=2.0)
    found = recolored(weights, offsets, intensity, specular, PALETTE, (edit,), x)
    rest = weights[:, 1:] / weights[:, 1:].sum(1, keepdim=True)
    np.testing.assert_allclose(found, intensity * (rest @ PALETTE[1:]) + 2 * specular, atol=1e-6)


def test_an_edit_falls_off_around_its_place():
    """Places at the click, at its reach, and far: all of the change, 1/e of it, none."""
    x = np.float32([[0.5, 0.5, 0.5], [0.5, 0.75, 0.5], [0.0, 0.5, 0.5]])  # 0, 1 and 2 scene units away
    weights = torch.tensor([[1.0, 0, 0]]).expand(3, 3)
    zeros, ones = torch.zeros(3, 3, 3), torch.ones(3, 1)
    blue = (0.1, 0.2, 0.8)
    edit = Recoloring(PaletteEdits({0: blue}), within=SpaceFilter(SPACE, ((0.0, 0.0, 0.0),), 1.0))
    found = recolored(weights, zeros, ones, torch.zeros(3, 3), PALETTE, (edit,), x)
    shares = np.exp([0.0, -1.0, -4.0])[:, None]
    np.testing.assert_allclose(found, shares * np.array(blue) + (1 - shares) * PALETTE[0].numpy(), atol=1e-5)
    everywhere = recolored(weights, zeros, ones, torch.zeros(3, 3), PALETTE, (Recoloring(PaletteEdits({0: blue})),), x)
    np.testing.assert_allclose(everywhere, np.tile(blue, (3, 1)), atol=1e-5)


def test_weights_offsets_and_gloss_change_around_the_place_alone():
    x = np.float32([[0.5, 0.5, 0.5], [0.0, 0.5, 0.5]])  # the place, and ten reaches away
    changes = PaletteEdits(scales={0: 0.0}), 0.0, 0.0
    here = Recoloring(*changes, SpaceFilter(SPACE, ((0.0, 0.0, 0.0),), 0.2))
    found, without, everywhere = (
        recolored(*given(2), PALETTE, edits, x) for edits in ((here,), (), (Recoloring(*changes),))
    )
    np.testing.assert_allclose(found, torch.stack([everywhere[0], without[1]]), atol=1e-6)
    assert (everywhere - without).abs().max(1).values.min() > 0.02


def test_distances_are_those_of_the_scene_whatever_its_space():
    space = SpaceWarp.box([-1, -0.8, -0.5], [1.2, 0.9, 0.7], near=0.05, far=1e3, kind="contraction")
    center, way = np.array([0.3, 0.2, 0.1]), np.array([[2.0, 0, 0], [0, 3.0, 0], [0.1, 0, 0], [0, 0, 0]])
    near = SpaceFilter(space, (tuple(center), (50.0, 50.0, 50.0)), 2.0)(space.warp(center + way))
    np.testing.assert_allclose(near, np.exp(-np.square(way).sum(1) / 4), atol=1e-5)


def test_an_edit_on_top_of_an_edit_starts_from_what_is_there():
    """Red turned blue here; then, all over, blue where it is blue and red where it is red become green."""
    x = np.float32([[0.5, 0.5, 0.5], [0.02, 0.5, 0.5]])
    weights = torch.tensor([[1.0, 0, 0]]).expand(2, 3)
    here = SpaceFilter(SPACE, ((0.0, 0.0, 0.0),), 0.3)
    edits = (
        Recoloring(PaletteEdits({0: (0.1, 0.2, 0.8)}), within=here),
        Recoloring(PaletteEdits({0: (0.1, 0.7, 0.2)})),
    )
    found = recolored(weights, torch.zeros(2, 3, 3), torch.ones(2, 1), torch.zeros(2, 3), PALETTE, edits, x)
    np.testing.assert_allclose(found, np.tile([0.1, 0.7, 0.2], (2, 1)), atol=1e-5)


def test_an_edit_survives_its_writing():
    edit = Recoloring(
        PaletteEdits({1: (0.1, 0.2, 0.3)}, {0: 0.5}, {2: 0.1}), 0.5, 0.0, SpaceFilter(SPACE, ((1, 2, 3),), 0.7)
    )
    assert Recoloring.restore(json.loads(json.dumps(edit.describe()))) == edit
    assert Recoloring.restore(Recoloring().describe()) == Recoloring()


def test_a_filter_of_several_places_counts_the_nearest_and_has_a_bounded_number_of_them():
    x = np.random.default_rng(0).random((50, 3), dtype=np.float32)
    centers = tuple(map(tuple, np.random.default_rng(1).uniform(-2, 2, (MOST_CENTERS, 3)).tolist()))
    every = [SpaceFilter(SPACE, (center,), 0.5)(x) for center in centers]
    found = SpaceFilter(SPACE, centers, 0.5)
    np.testing.assert_array_equal(found(x), np.max(every, axis=0))
    data = found.describe()
    data["centers"] *= 2
    with pytest.raises(InvalidValue, match="around 512 points; at most 256"):
        SpaceFilter.restore(data)


@pytest.mark.parametrize(("centers", "reach"), [((), 1.0), (((0, 0, 0),), 0.0), (((0, np.nan, 0),), 1.0)])
def test_filters_without_a_place_or_a_reach_are_refused(centers, reach):
    with pytest.raises(InvalidValue, match="needs points and a reach"):
        SpaceFilter(SPACE, centers, reach)
