"""A painting that colours are matched to keeps a least spread of luma."""

import pytest
import torch

from stylerf.light import LUMA
from stylerf.style.colour import match_colours, spread_at_least, strokes_in
from stylerf.training.stylize import Stylizer
from tests.stylerf.style.small_trunk import picture
from tests.stylerf.training.stylizing import made


def luma(image: torch.Tensor) -> torch.Tensor:
    return (torch.tensor(LUMA, dtype=torch.float64) @ image.double().flatten(1)).flatten()


@pytest.mark.parametrize("level", [0.5, 1.0, 0.0])
def test_a_blank_sheet_gets_the_spread_asked_for(level):
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
    one = made(Stylizer, painting=torch.ones(3, 16, 16), least_spread=0.1)
    assert one.settings.weights.style == 0 and one.settings.weights.content > 0


def test_matching_to_a_blank_sheet_keeps_light_and_shade():
    """Without it every colour becomes white; with it luma keeps its order along the colours' main direction."""
    grey = torch.linspace(0.2, 0.8, 50)[:, None].expand(50, 3) + 0.01 * picture(50, 1, 3)[..., 0].T
    sheet = torch.ones(3, 8, 8)
    flat = match_colours(grey, sheet.flatten(1).T)(grey.double())
    kept = match_colours(grey, spread_at_least(sheet, 0.08).flatten(1).T)(grey.double())
    weights = torch.tensor(LUMA, dtype=torch.float64)
    assert (flat @ weights).std() < 2e-3
    found = kept @ weights
    assert found.std(correction=0) == pytest.approx(0.08, rel=0.02)
    assert torch.corrcoef(torch.stack([found, grey.double() @ weights]))[0, 1] > 0.99
