"""Fields between a source and its stylizations: colors, shapes, occupancy."""

from dataclasses import replace

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.fields.blended_color import MOST_LAYERS
from stylerf.fields.blending import Style, at_strength, blended
from stylerf.fields.deformation import displaced_occupancy
from stylerf.fields.occupancy_grid import OccupancyGrid
from tests.stylerf.blends import corner, fields, picture
from tests.stylerf.small import SPACES, density, field_of

ROUNDING = 1e-6


def test_strength_goes_from_the_source_to_the_field():
    made = fields()
    source, stylized = picture(made["source"]), picture(made["mapped"])
    ends = [picture(at_strength(made["source"], made["mapped"], strength)) for strength in (0, 1)]
    np.testing.assert_array_equal(ends[0], source)
    np.testing.assert_array_equal(ends[1], stylized)
    for strength in (0.25, 0.5):
        found = picture(at_strength(made["source"], made["mapped"], strength))
        np.testing.assert_allclose(found, (1 - strength) * source + strength * stylized, atol=ROUNDING)


def test_strength_scales_the_displacement_of_a_bent_field():
    """Half of it is the mean of two pictures that are both bent half as far."""
    made, strength = fields(), 0.5
    grid = made["bent"].displacement
    found = at_strength(made["source"], made["bent"], strength)
    np.testing.assert_allclose(found.displacement, strength * grid, atol=1e-8)
    half = {"displacement": np.float32(strength) * grid, "occupancy": found.occupancy}
    expected = sum(0.5 * picture(replace(made[name], **half)) for name in ("source", "bent"))
    np.testing.assert_allclose(picture(found), expected, atol=ROUNDING)
    marked = displaced_occupancy(made["source"].occupancy, half["displacement"])
    np.testing.assert_array_equal(found.occupancy.distances, marked.distances)


def test_a_field_of_a_longer_step_than_its_source_has_every_strength():
    """DeSRF's steps are longer than those of a fit that has grown."""
    made = fields()
    source, bent = replace(made["source"], step=made["source"].step / 2), made["bent"]
    assert at_strength(source, bent, 0) is source
    assert at_strength(source, bent, 1) is bent
    found, expected = (at_strength(one, bent, 0.5) for one in (source, made["source"]))
    assert found.step == bent.step
    np.testing.assert_allclose(picture(found), picture(expected), atol=ROUNDING)


def test_a_longer_step_has_cells_that_are_occupied_at_it():
    """Half of these densities matter to a step of 1/50 and not to one of 1/100."""
    made = fields()
    short, long = (OccupancyGrid(8, np.tile(np.float32([0.0075, 1]), 256)) for _ in range(2))
    short.decide(1 / 100)
    long.decide(1 / 50)
    assert (short.share, long.share) == (0.5, 1.0)
    source = replace(made["source"], step=1 / 100, occupancy=short)
    found = blended(source, [Style("a", replace(made["plain"], step=1 / 50), 0.5)])
    np.testing.assert_array_equal(found.occupancy.distances, long.distances)


def test_what_both_are_bent_by_stays_to_the_bit():
    made = fields()
    source = replace(made["source"], displacement=made["bent"].displacement)
    found = at_strength(source, replace(made["bent"], displacement=source.displacement.copy()), 0.3)
    np.testing.assert_array_equal(found.displacement, source.displacement)
    assert found.occupancy is source.occupancy


def test_what_weights_leave_is_the_sources():
    made = fields()
    found = picture(blended(made["source"], [Style("a", made["mapped"], 0.5), Style("b", made["plain"], 0.2)]))
    expected = 0.3 * picture(made["source"]) + 0.5 * picture(made["mapped"]) + 0.2 * picture(made["plain"])
    np.testing.assert_allclose(found, expected, atol=ROUNDING)


def test_a_region_alone_lies_over_the_source():
    made, marked = fields(), corner()
    found = blended(made["source"], [Style("a", made["plain"], 1.0, marked)])
    assert [one.within is None for one in found.color.layers] == [True, False]
    other = blended(made["source"], [Style("a", made["plain"], 1.0, np.ones_like(marked))])
    np.testing.assert_allclose(picture(other), picture(made["plain"]), atol=ROUNDING)


def test_a_region_bends_what_comes_to_lie_in_it():
    made, marked = fields(), corner()
    found = blended(made["source"], [Style("a", made["bent"], 0.5, marked)]).displacement
    grid, side = made["bent"].displacement, 5
    for vertex in np.ndindex(side, side, side):
        place = np.float32(vertex) / np.float32(side - 1) + grid[vertex]
        cell = np.clip((place * len(marked)).astype(int), 0, len(marked) - 1)
        expected = 0.5 * grid[vertex] if marked[tuple(cell)] else np.zeros(3)
        np.testing.assert_allclose(found[vertex], expected, atol=1e-8)


def test_fields_that_hold_other_things_are_refused():
    made = fields()
    source = made["source"]
    others = {
        "trained further": replace(made["plain"], density=density(9)),
        "another kind or size": replace(made["plain"], density=density(3, size=(8, 8, 8))),
        "kind or size": replace(made["plain"], space=field_of(SPACES["frustum"], 3).space),
    }
    for why, field in others.items():
        with pytest.raises(InvalidValue, match=f"field x cannot be blended: .*{why}"):
            blended(source, [Style("field x", field, 0.5)])
        with pytest.raises(InvalidValue, match=why):
            at_strength(source, field, 1)


def test_weights_grids_and_layers_that_cannot_be_mixed_are_refused():
    made = fields()
    other = replace(made["bent"], displacement=np.zeros((7, 7, 7, 3), np.float32))
    for why, styles in {
        "add up to 1.2": [Style("a", made["plain"], 0.6), Style("b", made["mapped"], 0.6)],
        "5 and 7 vertices": [Style("a", made["bent"], 0.5), Style("b", other, 0.5)],
        "at most": [Style("a", made["plain"], 0.0)] * MOST_LAYERS,
    }.items():
        with pytest.raises(InvalidValue, match=why):
            blended(made["source"], styles)
