"""The style distance of a region against Gram matrices taken by hand."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.editing.region_style import RegionStyle, crop_of
from stylerf.errors import InvalidValue
from tests.stylerf.editing.region_pictures import tiny_view, view_of
from tests.stylerf.style.small_trunk import picture, small_trunk


def test_a_whole_view_that_shows_the_painting_is_at_no_distance():
    painting, extractor = picture(24, 24, 3), small_trunk()
    view = view_of(0, 24, width=24)
    view = type(view)(**{**vars(view), "pixels": np.arange(24 * 24), "width": 24})
    style = RegionStyle(extractor, painting, 24)
    canvas = style.canvas(view)
    same = painting.flatten(1).T.contiguous()
    assert float(style.distance(same, canvas)) < 1e-9
    other = picture(24, 24, 4)
    expected = []
    for a, b in zip(extractor(other[None]), extractor(painting[None])):
        grams = [f[0].flatten(1) @ f[0].flatten(1).T / f[0].numel() for f in (a, b)]
        expected.append(float((grams[0] - grams[1]).square().mean() / grams[1].square().mean()))
    found = float(style.distance(other.flatten(1).T.contiguous(), canvas))
    assert found == pytest.approx(np.mean(expected), rel=1e-4) and found > 1e-3


def test_pixels_lie_in_their_window_with_proportions_kept():
    style = RegionStyle(small_trunk(), picture(30, 40, 0), 24)
    view = tiny_view()
    colors = torch.arange(18.0).view(6, 3)
    drawn = style.picture(colors, style.canvas(view))
    assert drawn.shape == (3, 16, 24)  # two rows by three columns
    whole = style.canvas(view)
    assert (whole.height, whole.width) == (2, 3) and whole.places.tolist() == [0, 1, 2, 3, 4, 5]
    assert float(drawn[0, 0, 0]) == 0 and float(drawn[2, -1, -1]) == 17


def test_features_count_by_how_much_of_the_region_they_show():
    style = RegionStyle(small_trunk("conv1_2"), picture(48, 48, 1), 48)
    view = view_of(0, 48)
    canvas = style.canvas(view)
    # The disc's window is 46 pixels wide and is drawn 48 wide.
    assert (canvas.height, canvas.width) == (46, 46) and canvas.coverage[0].shape == (48, 48)
    assert float(canvas.coverage[0].sum()) == pytest.approx(len(view) * (48 / 46) ** 2, rel=1e-3)
    flat = torch.full((len(view), 3), 0.6)
    features = style.extractor(style.picture(flat, canvas)[None])[0][0]
    gram, total = torch.zeros(6, 6), 0.0
    for row in range(48):
        for column in range(48):
            share, f = float(canvas.coverage[0][row, column]), features[:, row, column]
            gram, total = gram + share * torch.outer(f, f), total + share
    expected = float((gram / (6 * total) - style.grams[0]).square().mean() / style.units[0])
    assert float(style.distance(flat, canvas)) == pytest.approx(expected, rel=1e-3)


def test_gradient_reaches_the_regions_pixels():
    """In float64: the extractor's kinks lie so close together that only tiny steps stay between them."""
    view = view_of(0, 20)
    canvas = RegionStyle(small_trunk(), picture(30, 40, 0), 24).canvas(view)
    canvas = replace(canvas, coverage=[c.double() for c in canvas.coverage])
    style = RegionStyle(small_trunk().double(), picture(30, 40, 0).double(), 24)
    generator = torch.Generator().manual_seed(1)
    colors, along = (torch.rand(len(view), 3, generator=generator, dtype=torch.float64) for _ in range(2))
    colors.requires_grad_()
    (gradient,) = torch.autograd.grad(style.distance(colors, canvas), colors)
    assert (gradient.abs().sum(1) > 0).all()
    with torch.no_grad():
        ends = [float(style.distance(colors + step * along, canvas)) for step in (-1e-6, 1e-6)]
    assert float((gradient * along).sum()) == pytest.approx((ends[1] - ends[0]) / 2e-6, rel=1e-5)


def test_crops_lie_within_the_style_image():
    painting = picture(20, 30, 5)
    assert torch.equal(crop_of(painting, 10, 5, 15), painting[:, 5:20, 10:25])
    for wrong in ((16, 0, 15), (0, 6, 15), (-1, 0, 5), (0, 0, 21)):
        with pytest.raises(InvalidValue, match="does not fit in a style image of 30x20"):
            crop_of(painting, *wrong)
    with pytest.raises(InvalidValue, match="too small"):
        RegionStyle(small_trunk(), painting, 6)
