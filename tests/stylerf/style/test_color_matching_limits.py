"""A painting that colors are matched to: a least spread of luma, and no more than the scene can follow."""

from dataclasses import replace

import pytest
import torch

from stylerf.srgb import LUMA
from stylerf.style.color_matching import color_statistics, match_colors, spread_at_least, spread_at_most, strokes_in
from stylerf.style.style_loss import StyleWeights
from stylerf.training.stylize.settings import DesrfSettings
from tests.stylerf.style.small_trunk import picture
from tests.stylerf.training.stylizing import arf


def luma(image: torch.Tensor) -> torch.Tensor:
    return (torch.tensor(LUMA, dtype=torch.float64) @ image.double().flatten(1)).flatten()


@pytest.mark.parametrize("level", [0.5, 1.0, 0.0])
def test_a_blank_sheet_gets_the_spread_requested(level):
    spread = spread_at_least(torch.full((3, 8, 10), level), 0.08)
    assert luma(spread).std(correction=0) == pytest.approx(0.08, rel=1e-5)
    assert luma(spread).mean() == pytest.approx(min(max(level, 0.08), 0.92), rel=1e-5)
    assert 0 <= spread.min() and spread.max() <= 1


def test_a_faint_one_gets_the_rest_and_keeps_its_mean_and_hues():
    faint = 0.5 + 0.04 * (picture(12, 12, 1) - 0.5)
    spread = spread_at_least(faint, 0.1)
    assert luma(spread).var(correction=0) == pytest.approx(0.01, rel=0.05)  # its pixels need not be square to the signs
    assert luma(spread).mean() == pytest.approx(float(luma(faint).mean()), abs=1e-6)
    torch.testing.assert_close(spread[0] - spread[1], faint[0] - faint[1], atol=1e-6, rtol=0)


def test_one_with_enough_is_left_alone():
    painting = picture(12, 12, 2)
    assert spread_at_least(painting, 0.1) is painting and spread_at_least(torch.ones(3, 4, 4), 0.0).eq(1).all()


def test_a_blank_sheet_has_no_strokes_to_teach():
    assert strokes_in(torch.ones(3, 8, 8), 0.1) == 0 and strokes_in(torch.ones(3, 8, 8), 0.0) == 1
    faint = 0.5 + 0.04 * (picture(12, 12, 1) - 0.5)
    spread = float(faint.double().std((1, 2), correction=0).square().mean()) ** 0.5
    assert strokes_in(faint, 0.1) == pytest.approx(spread / 0.1)
    # Red beside blue differs little in luma, and has strokes all the same.
    blots = torch.zeros(3, 8, 8)
    blots[0, :4], blots[2, 4:] = 1, 1
    assert strokes_in(blots, 0.2) == 1
    one = arf({"style_image": torch.ones(3, 16, 16)}, min_spread=0.1)
    assert one.settings.weights.style == 0 and one.settings.weights.content > 0
    grainy = replace(DesrfSettings(), weights=StyleWeights(grain=8.0))
    assert grainy.for_style(0.5).weights.grain == 4
    # Adam's steps are as long for what a weak loss leaves of a gradient: shapes would move by rounding.
    assert DesrfSettings().for_style(0.0).deform_rate == 0 < DesrfSettings().for_style(1.0).deform_rate


def test_matching_to_a_blank_sheet_keeps_light_and_shade():
    """Without it every color becomes white; with it luma keeps its order along the colors' main direction."""
    gray = torch.linspace(0.2, 0.8, 50)[:, None].expand(50, 3) + 0.01 * picture(50, 1, 3)[..., 0].T
    sheet = torch.ones(3, 8, 8)
    flat = match_colors(gray, sheet.flatten(1).T)(gray.double())
    kept = match_colors(gray, spread_at_least(sheet, 0.08).flatten(1).T)(gray.double())
    weights = torch.tensor(LUMA, dtype=torch.float64)
    assert (flat @ weights).std() < 2e-3
    found = kept @ weights
    assert found.std(correction=0) == pytest.approx(0.08, rel=0.02)
    assert torch.corrcoef(torch.stack([found, gray.double() @ weights]))[0, 1] > 0.99


def nearly_gray(count: int, hue: float) -> torch.Tensor:
    """Colors along gray, `hue` beside it."""
    generator = torch.Generator().manual_seed(4)
    gray = torch.rand(count, 1, generator=generator).expand(count, 3)
    return (0.2 + 0.6 * gray + hue * torch.randn(count, 3, generator=generator)).double()


@pytest.mark.parametrize("most", [2.0, 4.0])
def test_no_axis_of_a_grayish_scene_is_stretched_beyond_the_limit(most):
    content, painting = nearly_gray(4000, 0.01), picture(30, 30, 5)
    axes = torch.linalg.eigh(color_statistics(content)[1])[1]
    free = match_colors(content, painting.flatten(1).T)
    assert float((free.matrix @ axes).norm(dim=0).max()) > 2 * most
    bounded = match_colors(content, spread_at_most(painting, content, most).flatten(1).T)
    gains = (bounded.matrix @ axes).norm(dim=0)
    assert float(gains.max()) == pytest.approx(most, rel=1e-4)
    # What is brought nearer is brought no nearer than needed, and around the painting's own mean.
    assert float(gains[2]) == pytest.approx(float((free.matrix @ axes).norm(dim=0)[2]), rel=1e-4)
    torch.testing.assert_close(bounded(content).mean(0), painting.double().flatten(1).mean(1), atol=1e-6, rtol=0)


def test_a_scene_with_colors_enough_is_matched_exactly():
    content, painting = nearly_gray(4000, 0.2), picture(30, 30, 5)
    assert spread_at_most(painting, content, 4.0) is painting
    assert spread_at_most(painting, nearly_gray(4000, 0.01), 0.0) is painting


@pytest.mark.parametrize("match", ["after", "both"])
def test_both_matches_of_a_stylization_together_stay_below_the_bound(match):
    """The second aims at what the first could reach: two bounds one after the other would be their product."""
    painting = picture(16, 16, 2)
    one = arf({"style_image": painting}, match=match, max_gain=0.5)
    free = arf({"style_image": painting}, match=match, max_gain=0.0)
    assert torch.equal(free.scene.style_colors, painting)
    drawn, full = (color_statistics(x.flatten(1).T)[1].trace() for x in (one.scene.style_colors, painting))
    assert drawn < 0.9 * full
    before = color_statistics(torch.cat([torch.from_numpy(free.scene.photos[v].reshape(-1, 3)) for v in range(2)]))[1]
    after = color_statistics(torch.cat([torch.from_numpy(one.scene.photos[v].reshape(-1, 3)) for v in range(2)]))[1]
    assert (after.trace() < 0.9 * before.trace()) == (match == "both")
