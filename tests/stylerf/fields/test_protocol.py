"""Every kind of part offers what the protocol says, under the same names of arguments."""

import inspect

import pytest

from stylerf.fields.hash_color import HashColour
from stylerf.fields.palette_color import PaletteColour
from stylerf.fields.protocol import ColourPart, DensityPart, Growing, Part
from stylerf.fields.radiance_field import COLOUR_KINDS, DENSITY_KINDS

KINDS = [(kind, DensityPart) for kind in DENSITY_KINDS.values()] + [
    (kind, ColourPart) for kind in COLOUR_KINDS.values()
]


def asked_of(protocol: type) -> dict[str, list[str]]:
    """Names of the arguments by method."""
    found = {}
    for one in (Part, protocol):
        methods = inspect.getmembers(one, inspect.isroutine)
        found |= {name: list(inspect.signature(m).parameters) for name, m in methods if not name.startswith("_")}
    return found


@pytest.mark.parametrize(("kind", "protocol"), KINDS, ids=lambda one: one.__name__)
def test_a_kind_offers_all_that_is_asked_for(kind, protocol):
    # A stylisation's colour never grows.
    asked = asked_of(protocol) | ({} if kind in (HashColour, PaletteColour) else asked_of(Growing))
    assert {"backward", "add_position_gradients", "smooth", "groups", "describe", "restore"} <= set(asked)
    for name, arguments in asked.items():
        assert list(inspect.signature(getattr(kind, name)).parameters) == arguments, name
    assert isinstance(kind.kind, str) and len({k.kind for k, p in KINDS if p is protocol}) == sum(
        p is protocol for _, p in KINDS
    )
