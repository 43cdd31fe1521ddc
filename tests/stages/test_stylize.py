"""What the stylise stage decides by itself: the grain of its colours, and which rays learn."""

import numpy as np
import pytest

from stages.configs.stylize import COLOUR_CELLS, StylizeConfig
from stages.stylize import new_colour, rays_of


@pytest.mark.parametrize(
    ("pixel_cells", "finest"),
    [(128.0, 160), (180.0, 224), (5.0, COLOUR_CELLS[0]), (4000.0, COLOUR_CELLS[1]), (float("nan"), COLOUR_CELLS[0])],
)
def test_colours_are_a_quarter_finer_than_a_pixel_within_bounds(pixel_cells, finest):
    config = StylizeConfig(style="x", levels=2, table_bits=10)
    assert new_colour(config, np.random.default_rng(0), pixel_cells).finest == finest


def test_cells_that_are_asked_for_are_taken():
    config = StylizeConfig(style="x", levels=2, table_bits=10, finest=48)
    assert new_colour(config, np.random.default_rng(0), 500.0).finest == 48


@pytest.mark.parametrize(
    ("options", "side", "rays"),
    [
        ({"method": "arf"}, 1008, "deferred"),
        ({"method": "desrf"}, 256, "deferred"),
        ({"method": "desrf"}, 257, "dilated"),
        ({"method": "desrf", "rays": "patch"}, 100, "patch"),
    ],
)
def test_rays_follow_from_method_and_size_unless_asked_for(options, side, rays):
    assert rays_of(StylizeConfig(style="x", **options), side) == rays
