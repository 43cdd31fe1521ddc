"""PLY files of splats: what is stored is read; what is damaged, hostile or something else is refused in one line."""

import numpy as np
import pytest

from schemas.errors import BadInput, OutOfResources
from schemas.safe_reading import set_allowance
from schemas.splat_ply import is_splat_ply, read_splat_ply
from tests.stages.splat_scene import ball, write_ply


@pytest.mark.parametrize("format", ["binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("rests", [0, 9, 24, 45])
def test_splats_are_read_as_stored(tmp_path, format, rests):
    columns = ball(50)
    random = np.random.default_rng(1)
    columns |= {f"f_rest_{k}": random.normal(size=50).astype(np.float32) for k in range(rests)}
    columns |= {"extra": np.zeros(50, np.uint8), "x": columns["x"].astype(np.float64)}
    path = write_ply(tmp_path / "a.ply", dict(sorted(columns.items())), format)
    found = read_splat_ply(path)
    assert is_splat_ply(path)
    assert found.centers == pytest.approx(np.column_stack([columns[name] for name in "xyz"]))
    assert np.array_equal(found.logits, columns["opacity"])
    assert np.array_equal(found.quaternions[:, 0], columns["rot_0"])
    assert found.harmonics.shape == (50, 1 + rests // 3, 3)
    assert np.array_equal(found.harmonics[:, 0, 2], columns["f_dc_2"])
    for channel in range(3):
        for band in range(rests // 3):
            stored = columns[f"f_rest_{channel * (rests // 3) + band}"]
            assert np.array_equal(found.harmonics[:, 1 + band, channel], stored)


def one_changed(name, value):
    def write(path):
        columns = ball(50)
        columns[name][7] = value
        write_ply(path, columns)

    return write


def without(name):
    return lambda path: write_ply(path, {key: values for key, values in ball(50).items() if key != name})


def with_rests(count):
    return lambda path: write_ply(path, ball(9) | {f"f_rest_{k}": np.zeros(9, np.float32) for k in range(count)})


def cut(path):
    write_ply(path, ball(50))
    path.write_bytes(path.read_bytes()[:-5])


def with_list(path):
    path.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty list uchar int x\nend_header\n")


def with_faces(path):
    write_ply(path, ball(5))
    path.write_bytes(path.read_bytes().replace(b"end_header\n", b"element face 1000000000\nend_header\n"))


DAMAGES = {
    "a count beyond the file": (lambda path: write_ply(path, ball(50), count=10**7), "need 680000000 bytes"),
    "a count of twelve digits": (lambda path: write_ply(path, ball(50), count=10**12), "1 to 100000000 vertices"),
    "no splat": (lambda path: write_ply(path, ball(0)), "1 to 100000000 vertices"),
    "cut short": (cut, "3395 follow its header"),
    "a center that is NaN": (one_changed("y", np.nan), "y of splat 7 is nan, as of 1 splats"),
    "an infinite harmonic": (one_changed("f_dc_1", np.inf), "f_dc_1 of splat 7 is inf"),
    "a scale that overflows": (one_changed("scale_0", 80), "1 splats have scales beyond"),
    "no rotation": (one_changed("rot_0", 0), "1 splats have a rotation of length 0"),
    "a cloud of points": (without("opacity"), "lack opacity"),
    "seven coefficients": (with_rests(7), "has 7 coefficients f_rest"),
    "text": (lambda path: write_ply(path, ball(2), "ascii"), "is a text PLY"),
    "compressed": (lambda path: write_ply(path, ball(2) | {"packed_position": np.zeros(2, np.float32)}), "compressed"),
    "a list": (with_list, "a property that is not a number"),
    "faces": (with_faces, "a header of one element"),
    "no header": (lambda path: path.write_bytes(b"ply\n" + b"comment x\n" * 10_000), "header has no end"),
    "no PLY": (lambda path: path.write_bytes(b"\x89PNG"), "its header has no end|is not a PLY"),
    "empty": (lambda path: path.touch(), "header has no end"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_refused_in_one_line(tmp_path, damage):
    make, why = DAMAGES[damage]
    make(tmp_path / "a.ply")
    with pytest.raises(BadInput, match=why) as refused:
        read_splat_ply(tmp_path / "a.ply")
    assert "\n" not in str(refused.value) and "a.ply" in str(refused.value)


def test_more_splats_than_memory_are_refused(tmp_path, monkeypatch):
    write_ply(tmp_path / "a.ply", ball(50))
    monkeypatch.setattr("schemas.safe_reading.MIN_ALLOWANCE", 1)
    set_allowance(lambda: 1000)
    try:
        with pytest.raises(OutOfResources, match="holds 50 splats"):
            read_splat_ply(tmp_path / "a.ply")
    finally:
        set_allowance(None)
