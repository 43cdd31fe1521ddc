"""Which kind of values the colors have that a fine-tuning smooths."""

import numpy as np
import pytest

from stages.finetune import kind_of
from stylerf.fields.encoded_color import EncodedColor
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.protocol import Capacity
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
    ],
)
def test_colors_are_smoothed_by_the_kind_of_their_values(color, expected):
    assert kind_of(color) == expected
