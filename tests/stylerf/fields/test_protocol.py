"""Every kind of part offers what the protocol says, under the same names of arguments."""

import inspect

import pytest

from stylerf.fields.hash_grid import HashColor
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.protocol import DensityPart, Growing, Part, RestorableColor
from stylerf.fields.radiance_field import COLOR_KINDS, DENSITY_KINDS

KINDS = [(kind, DensityPart) for kind in DENSITY_KINDS.values()]
KINDS += [(kind, RestorableColor) for kind in COLOR_KINDS.values()]


def requested_of(protocol: type) -> dict[str, list[str]]:
    """Names of the arguments by method."""
    found = {}
    for one in (Part, protocol):
        methods = inspect.getmembers(one, inspect.isroutine)
        found |= {name: list(inspect.signature(m).parameters) for name, m in methods if not name.startswith("_")}
    return found


@pytest.mark.parametrize(("kind", "protocol"), KINDS, ids=lambda one: one.__name__)
def test_a_kind_offers_all_that_is_requested(kind, protocol):
    # A stylization's color never grows.
    requested = requested_of(protocol) | ({} if kind in (HashColor, PaletteColor) else requested_of(Growing))
    assert {"backward", "add_position_gradients", "smooth", "groups", "describe", "restore"} <= set(requested)
    for name, arguments in requested.items():
        assert list(inspect.signature(getattr(kind, name)).parameters) == arguments, name
    assert isinstance(kind.kind, str) and len({k.kind for k, p in KINDS if p is protocol}) == sum(
        p is protocol for _, p in KINDS
    )
