"""Descriptions and arrays that do not belong together are refused before any kernel reads them."""

import numpy as np
import pytest
import torch

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.color_map import ColorMap
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.rendering.view import render_view
from tests.stylerf import small

BOX = small.SPACES["box"]


def restored(field: RadianceField, data: dict | None = None, arrays: dict | None = None) -> RadianceField:
    return RadianceField.restore({**field.describe(), **(data or {})}, {**field.arrays(), **(arrays or {})})


@pytest.mark.parametrize("size", [[2048] * 3, [48] * 3, [1, 6, 8], [0, 6, 8], [7.0, 6, 8], [2**62] * 3, [7, 6], "7"])
def test_a_vm_part_has_as_many_numbers_as_its_size_says(size):
    """2048^3 over a small tensor ended the process, 48^3 read what lies behind it."""
    field = small.field_of(BOX, 1)
    for part in ("density", "color"):
        with pytest.raises(InvalidValue):
            restored(field, {part: field.describe()[part] | {"size": size}})


def test_what_was_described_is_restored_to_the_bit():
    field = small.field_of(BOX, 1, displacement=small.displacement_grid(2))
    field.color_map = ColorMap(torch.eye(3), torch.zeros(3))
    again = restored(field)
    assert again.describe() == field.describe()
    for name, array in field.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], array)


@pytest.mark.parametrize("name", ["density", "color", "displacement"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
def test_a_number_that_cannot_be_learned_is_refused_by_array_name(name, value):
    field = small.field_of(BOX, 1, displacement=small.displacement_grid(2))
    array = field.arrays()[name].copy()
    array.reshape(-1)[-1] = value
    with pytest.raises(InvalidValue, match=f"the array {name} holds"):
        restored(field, arrays={name: array})


@pytest.mark.parametrize("kind", [np.float64, np.float16, np.int32])
def test_arrays_of_another_type_are_refused(kind):
    field = small.field_of(BOX, 1)
    with pytest.raises(InvalidValue, match="expected any float32"):
        restored(field, arrays={"density": field.density.values.astype(kind)})


def test_distances_of_the_chessboard_are_believed_and_no_longer_ones():
    """By a slow loop: a cell may tell less than the way to the nearest occupied one, never more."""
    rng = np.random.default_rng(0)
    occupancy = OccupancyGrid(6)
    occupancy.set_occupied(rng.random(216) < 0.02)
    arrays = {"occupancy.highest": np.ones(216, np.float32), "occupancy.distances": occupancy.distances}
    OccupancyGrid.restore(6, arrays)
    where = np.argwhere(np.ones((6, 6, 6)))
    there = where[occupancy.distances == 0]
    nearest = np.abs(where[:, None] - there).max(-1).min(1)
    for cell in np.flatnonzero(nearest):
        lying = occupancy.distances.copy()
        lying[cell] = nearest[cell] + 1
        with pytest.raises(InvalidValue, match="does not hold distances"):
            OccupancyGrid.restore(6, arrays | {"occupancy.distances": lying})
    ending_at_two = np.minimum(occupancy.distances, 2)  # as those of a GPU end at 32
    OccupancyGrid.restore(6, arrays | {"occupancy.distances": ending_at_two})
    OccupancyGrid.restore(6, arrays | {"occupancy.distances": np.full(216, 255, np.uint8)})  # nothing is occupied


def test_infinity_marks_unvisited_cells_and_nan_is_refused():
    arrays = {"occupancy.highest": np.full(8, np.inf, np.float32), "occupancy.distances": np.zeros(8, np.uint8)}
    OccupancyGrid.restore(2, arrays)
    for value in (np.nan, -1.0):
        arrays["occupancy.highest"][3] = value
        with pytest.raises(InvalidValue, match="highest"):
            OccupancyGrid.restore(2, arrays)


@pytest.mark.parametrize("kind", ["box", "contraction", "frustum"])
@pytest.mark.parametrize("key", ["near", "far"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), 1e300, "1", None, True])
def test_the_reach_of_a_space_is_of_numbers_that_float32_can_march(kind, key, value):
    with pytest.raises(InvalidValue):
        SpaceWarp.restore(small.SPACES[kind].describe() | {key: value})


@pytest.mark.parametrize("kind", ["box", "contraction", "frustum"])
def test_a_space_that_would_be_divided_by_nothing_is_refused(kind):
    described = small.SPACES[kind].describe()
    for place in (0, 1, 2) if kind == "frustum" else (3, 4, 5, 6):
        for value in (0.0, -1.0, 1e-30, 1e300):
            other = [*described["parameters"]]
            other[place] = value
            with pytest.raises(InvalidValue):
                SpaceWarp.restore(described | {"parameters": other})


@pytest.mark.parametrize("kind", ["box", "contraction", "frustum"])
@pytest.mark.parametrize("far", [0.0, 1.0, 1e9, -1e9])
@pytest.mark.parametrize("focal", [1e-3, 8.0, 1e9])
def test_cameras_at_the_ends_of_what_is_allowed_see_finite_pixels(kind, far, focal):
    """Cells are looked up by where rays go: none of them may lie beyond the cube, or nowhere."""
    pose = np.eye(4)
    pose[:3, 3] = far, -far, far
    field = small.field_of(small.SPACES[kind], 3, step=1e-2)
    seen = render_view(
        field, Camera("look", 4, 3, focal, focal, 1e9 if far else 2.0, -1e9 if far else 1.0, pose), threads=1
    )
    for plane in (seen.rgb, seen.alpha, seen.z):
        assert np.isfinite(plane).all()


@pytest.mark.parametrize("value", [True, 1.0, "1", None, [], -1, 9, 2**200])
def test_whole_numbers_are_those_of_python_within_their_bounds(value):
    with pytest.raises(InvalidValue, match=r"n is .*expected a whole number from 0 to 8"):
        validation.integer({"n": value}, "n", 0, 8)
    assert validation.integer({"n": 8}, "n", 0, 8) == 8


def test_what_is_missing_is_reported_by_its_name():
    for given in ({}, [], None, 5):
        with pytest.raises(InvalidValue, match="rank"):
            validation.integer(given, "rank", 0, 8)
