"""Which weight of the total variation the colors of a local edit get."""

import numpy as np
import pytest

from stages.finetune import kind_of
from stylerf.fields.encoded_color import EncodedColor
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.protocol import Capacity
from stylerf.fields.region_color import RegionColor
from tests.stylerf.small import hash_color, vm_color


def encoded(kind: str) -> EncodedColor:
    capacity = Capacity(np.array([8, 8, 8]), 8, color_rank=4, finest=16)
    return EncodedColor.create(kind, "mlp", capacity, 1, np.random.default_rng(0))


def palette() -> PaletteColor:
    return PaletteColor.create(np.random.default_rng(0), np.eye(3), levels=2, finest=16, table=64)


@pytest.mark.parametrize(
    ("color", "expected"),
    [
        (vm_color(0), "vm"),
        (hash_color(0), "hash"),
        (encoded("vm"), "vm"),
        (encoded("hash"), "hash"),
        (palette(), "hash"),
        (RegionColor.create(vm_color(0), np.ones((8, 8, 8), bool), 32), "hash"),
    ],
)
def test_a_region_has_a_grid_of_its_own_whatever_the_colors_beneath(color, expected):
    assert kind_of(color) == expected
