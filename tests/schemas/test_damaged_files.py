"""Damaged files of every kind that is read here: refused in words, or read; quickly, and within memory.

`python -m tests.campaign` goes on for longer, over all readers.
"""

import random
import struct
import time

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas.errors import StylerfError
from schemas.exr import ExrView, read_depth, read_exr, write_exr
from schemas.flow_files import read_flow
from schemas.images import image_channels, image_size, read_srgb
from stylerf_cli.arguments import read_toml

NUMBERS = (0, 1, 30_000, 65_536, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
PICTURES = ("png", "jpg", "tif", "webp", "bmp", "jp2", "exr", "hdr", "gif")


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Small files by name, each as a program writes it."""
    folder = tmp_path_factory.mktemp("sound")
    pixels = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    kinds = {"exr": oiio.HALF, "hdr": oiio.FLOAT}
    for suffix in PICTURES:
        spec = oiio.ImageSpec(64, 48, 3, kinds.get(suffix, oiio.UINT8))
        spec.attribute("Orientation", 6)
        target = oiio.ImageOutput.create(str(folder / f"a.{suffix}"))
        assert target.open(str(folder / f"a.{suffix}"), spec) and target.write_image(pixels) and target.close()
    plane = np.ones((12, 16))
    view = ExrView(np.ones((12, 16, 3)), plane, plane, plane, np.eye(4), (9.0, 9.0, 8.0, 6.0), 0.1, 10.0, {"m": plane})
    write_exr(folder / "view.exr", view)
    np.save(folder / "flow.npy", np.zeros((6, 8, 2), np.float32))
    (folder / "flow.flo").write_bytes(b"PIEH" + struct.pack("<ii", 8, 6) + bytes(8 * 6 * 8))
    (folder / "options.toml").write_bytes(b'seed = 7\n[fit]\nbudget = "60s"\n[stylize]\nlayers = ["a", "b"]\n')
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def readers_of(name):
    if name.startswith("flow"):
        return (read_flow,)
    if name.endswith("toml"):
        return (read_toml,)
    return (image_size, image_channels, read_srgb, *((read_exr, read_depth) if name.endswith("exr") else ()))


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Bits flipped, numbers set, parts taken out, repeated or moved, or the end cut off; mostly near the beginning."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        at = rng.randrange(min(len(data), rng.choice((64, 512, 1 << 30))))
        kind = rng.randrange(6)
        if kind == 0:
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            data[at : at + 4] = rng.choice(NUMBERS).to_bytes(4, rng.choice(("little", "big")))
        elif kind == 2:
            del data[at : at + rng.randrange(1, 200)]
        elif kind == 3:
            data[at:at] = data[at : at + rng.randrange(1, 100)] * rng.choice((1, 3, 1000))
        elif kind == 4:
            data[at : at + 20] = data[(start := rng.randrange(len(data))) : start + 20]
        else:
            del data[at:]
        if not data:
            break
    return bytes(data)


@pytest.mark.parametrize("seed", range(8))
def test_damaged_files_are_refused_or_read(tmp_path, sound, seed):
    rng = random.Random(seed)
    for name, data in sound.items():
        for trial in range(5):
            (tmp_path / name).write_bytes(damaged(data, rng))
            for read in readers_of(name):
                began = time.perf_counter()
                try:
                    read(tmp_path / name)
                except StylerfError as error:
                    assert name in str(error), (name, trial)
                assert time.perf_counter() - began < 20


@pytest.mark.parametrize("read", [read_exr, read_depth, read_srgb, image_size])
def test_words_of_a_codec_that_are_no_text(tmp_path, sound, read):
    data = sound["a.exr"].replace(b"chlist\0", b"chl\x8fst\0")  # the codec quotes what it does not know
    (tmp_path / "a.exr").write_bytes(data)
    with pytest.raises(StylerfError, match=r"a\.exr"):
        read(tmp_path / "a.exr")


def test_a_header_of_an_array_that_is_no_python(tmp_path, sound):
    (tmp_path / "flow.npy").write_bytes(sound["flow.npy"].replace(b"}", b"("))
    with pytest.raises(StylerfError, match=r"flow\.npy"):
        read_flow(tmp_path / "flow.npy")
