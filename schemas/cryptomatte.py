"""Cryptomatte 1.2: mattes by name as pairs of id and coverage (Friedman and Jones 2015).

Layer `crypto_region00` holds the two names that cover most of a pixel: R and B are their ids, G and A their coverage.
The next two are in `crypto_region01`, and so on. Where a name's coverage is 0, so is its id.
"""

import json
from collections.abc import Iterable, Mapping

import numpy as np

LAYER = "crypto_region"
MAX_RANKS = 6  # names per pixel, as renderers write by default; a seventh would be lost
_MASK = 0xFFFFFFFF


def murmur3_32(data: bytes, seed: int = 0) -> int:
    """Return MurmurHash3_x86_32 of `data` (Appleby 2011, public domain)."""
    value = seed
    whole = len(data) // 4 * 4
    for at in range(0, whole, 4):
        value ^= _mixed(int.from_bytes(data[at : at + 4], "little"))
        value = (_rotated(value, 13) * 5 + 0xE6546B64) & _MASK
    if rest := data[whole:]:
        value ^= _mixed(int.from_bytes(rest, "little"))
    value ^= len(data)
    value = ((value ^ value >> 16) * 0x85EBCA6B) & _MASK
    value = ((value ^ value >> 13) * 0xC2B2AE35) & _MASK
    return value ^ value >> 16


def _mixed(word: int) -> int:
    return _rotated((word * 0xCC9E2D51) & _MASK, 15) * 0x1B873593 & _MASK


def _rotated(word: int, by: int) -> int:
    return (word << by | word >> 32 - by) & _MASK


def id_of(name: str) -> int:
    """Return the id of a name, 32 bits that are a finite float, neither 0 nor subnormal."""
    value = murmur3_32(name.encode())
    # An exponent of all zeros or all ones is subnormal, infinite or NaN: flip its lowest bit.
    return value ^ 1 << 23 if value >> 23 & 255 in (0, 255) else value


def ranks_of(count: int) -> int:
    """Return how many names a pixel can hold where there are `count`: an even number, two per layer."""
    return min(MAX_RANKS, max(2, count + count % 2))


def cryptomatte_channels(coverages: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return float32 channels [h, w] by name.

    Args:
        coverages: By name, [h, w] 0..1. Names that overlap in space both keep their coverage, so that the sum may
            exceed alpha there.
    """
    names = sorted(coverages)
    planes = np.stack([np.asarray(coverages[name], np.float32) for name in names])
    ids = np.array([id_of(name) for name in names], np.uint32).view(np.float32)
    ranks = ranks_of(len(names))
    order = np.argsort(-planes, axis=0, kind="stable")[:ranks]
    sorted_planes = np.take_along_axis(planes, order, axis=0)
    channels: dict[str, np.ndarray] = {}
    for rank in range(ranks):
        layer, (id_channel, coverage_channel) = f"{LAYER}{rank // 2:02d}", ("RG", "BA")[rank % 2]
        coverage = sorted_planes[rank] if rank < len(names) else np.zeros(planes.shape[1:], np.float32)
        held = np.where(coverage > 0, ids[order[rank]], np.float32(0)) if rank < len(names) else coverage
        channels |= {f"{layer}.{id_channel}": held, f"{layer}.{coverage_channel}": coverage}
    return channels


def cryptomatte_attributes(names: Iterable[str]) -> dict[str, str]:
    """Return the header's entries: name, hash, conversion and the manifest, which maps names to their ids in hex."""
    key = f"cryptomatte/{id_of(LAYER):08x}"[: len("cryptomatte/") + 7]
    manifest = {name: f"{id_of(name):08x}" for name in sorted(names)}
    return {
        f"{key}/name": LAYER,
        f"{key}/hash": "MurmurHash3_32",
        f"{key}/conversion": "uint32_to_float32",
        f"{key}/manifest": json.dumps(manifest, separators=(",", ":")),
    }
