"""Cryptomatte: published hashes, and mattes decoded from the file by the specification alone, read by OpenImageIO."""

import json
from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas.cryptomatte import LAYER, cryptomatte_channels, id_of, murmur3_32, ranks_of
from schemas.exr import ExrView, read_exr, write_exr

NAMES = ("cup", "left+part", "table-2")


def view(mattes: dict) -> ExrView:
    alpha = np.clip(sum(mattes[name] for name in sorted(mattes)), 0, 1)
    rgb = np.repeat(alpha[..., None], 3, axis=2)
    return ExrView(rgb, alpha, alpha + 1, alpha + 1, np.eye(4), (50, 50, 5, 4), 0.1, 9, {}, {}, mattes=mattes)


@pytest.fixture
def mattes() -> dict[str, np.ndarray]:
    """Parts of each pixel; the last name is nowhere in a corner."""
    parts = np.random.default_rng(0).dirichlet([0.5] * 4, (8, 10)).astype(np.float32)
    parts[:2, :2, 2] = 0
    return {name: parts[..., index] for index, name in enumerate(NAMES)}


def decoded(path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Coverage by name, and the metadata without their key, as a compositor finds them."""
    image = oiio.ImageBuf(str(path))
    pixels = image.get_pixels(oiio.FLOAT)
    planes = {name: pixels[..., index] for index, name in enumerate(image.spec().channelnames)}
    found = {one.name: one.value for one in image.spec().extra_attribs if one.name.startswith("cryptomatte/")}
    (key,) = {name.split("/")[1] for name in found}
    metadata = {name.split("/")[2]: value for name, value in found.items()}
    # The key is the beginning of the hash of the layer's name.
    assert len(key) == 7 and f"{id_of(metadata['name']):08x}".startswith(key)
    layers = sorted(name[:-2] for name in planes if name.startswith(metadata["name"]) and name.endswith(".R"))
    coverages = {}
    for name, code in json.loads(metadata["manifest"]).items():
        own = np.frombuffer(bytes.fromhex(code)[::-1], np.float32)[0]
        pairs = [(planes[f"{one}.{a}"], planes[f"{one}.{b}"]) for one in layers for a, b in ("RG", "BA")]
        coverages[name] = sum(np.where(ids == own, coverage, 0) for ids, coverage in pairs)
    return coverages, metadata


@pytest.mark.parametrize(
    ("data", "seed", "value"),
    [
        (b"", 0, 0),
        (b"", 1, 0x514E28B7),
        (b"test", 0, 0xBA6BD213),
        (b"Hello, world!", 0, 0xC0363E43),
        (b"The quick brown fox jumps over the lazy dog", 0, 0x2E4FF723),
    ],
)
def test_hashes_are_those_published_for_murmurhash3(data, seed, value):
    assert murmur3_32(data, seed) == value


@pytest.mark.parametrize(
    ("name", "value"),
    [("hello", 6.0705627102400005616e-17), ("cube", -4.08461912519e15), ("sphere", 2.79018604383e15),
     ("plane", 3.66557617593e-11)],
)  # fmt: skip
def test_ids_are_those_of_cryptomatte_s_own_tests(name, value):
    assert np.uint32(id_of(name)).view(np.float32) == pytest.approx(value, rel=1e-9)


def test_no_id_is_zero_subnormal_infinite_or_nan():
    names = [f"region{number}" for number in range(3000)]
    changed = [name for name in names if murmur3_32(name.encode()) != id_of(name)]
    assert 5 < len(changed) < 60  # one of 128 hashes has such an exponent
    ids = np.array([id_of(name) for name in names], np.uint32).view(np.float32)
    assert np.isfinite(ids).all() and (np.abs(ids) >= np.finfo(np.float32).tiny).all()
    assert all(murmur3_32(name.encode()) ^ id_of(name) == 1 << 23 for name in changed)


def test_the_file_decodes_to_every_matte(tmp_path, mattes):
    write_exr(tmp_path / "v.exr", view(mattes))
    coverages, metadata = decoded(tmp_path / "v.exr")
    assert (metadata["hash"], metadata["conversion"]) == ("MurmurHash3_32", "uint32_to_float32")
    assert metadata["name"] == LAYER and set(coverages) == set(NAMES)
    for name, matte in mattes.items():
        np.testing.assert_array_equal(coverages[name], matte)
    write_exr(tmp_path / "again.exr", view(dict(reversed(mattes.items()))))
    assert (tmp_path / "again.exr").read_bytes() == (tmp_path / "v.exr").read_bytes()


def test_ranks_are_sorted_and_empty_ones_have_no_id(mattes):
    channels = cryptomatte_channels(mattes)
    assert sorted(channels) == [f"{LAYER}0{layer}.{name}" for layer in (0, 1) for name in "ABGR"]
    coverage = np.stack([channels[f"{LAYER}0{layer}.{name}"] for layer in (0, 1) for name in "GA"])
    ids = np.stack([channels[f"{LAYER}0{layer}.{name}"] for layer in (0, 1) for name in "RB"])
    assert (np.diff(coverage, axis=0) <= 0).all() and not coverage[3].any()
    assert ((ids == 0) == (coverage == 0)).all()
    assert all(plane.dtype == np.float32 for plane in channels.values())


@pytest.mark.parametrize(("count", "ranks"), [(1, 2), (2, 2), (3, 4), (6, 6), (40, 6)])
def test_layers_hold_two_ranks_and_at_most_six(count, ranks):
    assert ranks_of(count) == ranks
    planes = {f"n{number}": np.full((2, 2), 1 / (number + 2), np.float32) for number in range(count)}
    channels = cryptomatte_channels(planes)
    assert len(channels) == 2 * ranks
    kept = sum(plane for name, plane in channels.items() if name[-1] in "GA")
    np.testing.assert_allclose(kept, sum(1 / (number + 2) for number in range(min(count, 6))), rtol=1e-6)


def test_a_view_without_mattes_has_no_layer(tmp_path, mattes):
    write_exr(tmp_path / "v.exr", replace(view(mattes), mattes={}))
    image = oiio.ImageBuf(str(tmp_path / "v.exr"))
    assert not any(name.startswith("crypto") for name in image.spec().channelnames)
    assert not any(one.name.startswith("cryptomatte") for one in image.spec().extra_attribs)
    write_exr(tmp_path / "w.exr", view(mattes))
    assert read_exr(tmp_path / "w.exr").masks == {}
