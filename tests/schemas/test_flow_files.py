"""Flow files: Middlebury's .flo byte by byte, .npy, and what is neither."""

import os
import struct

import numpy as np
import pytest

from schemas.errors import BadInput
from schemas.flow_files import read_flow


def test_a_flo_is_read_byte_by_byte(tmp_path):
    vectors = [[(0.5, -1.25), (2.0, 3.0), (1e10, 0.0)], [(4.0, 5.0), (-6.5, 7.0), (8.0, 9.0)]]  # the third is unknown
    data = struct.pack("<f", 202021.25) + struct.pack("<ii", 3, 2)
    data += b"".join(struct.pack("<ff", *pair) for row in vectors for pair in row)
    path = tmp_path / "0000_to_0001.flo"
    path.write_bytes(data)
    found = read_flow(path)
    assert found.shape == (2, 3, 2) and found.dtype == np.float32
    assert np.isnan(found[0, 2]).all()
    assert found[0, 0].tolist() == [0.5, -1.25] and found[1, 1].tolist() == [-6.5, 7.0]


def test_an_npy_is_taken_as_it_is(tmp_path):
    flow = np.random.default_rng(0).normal(size=(4, 5, 2))
    np.save(tmp_path / "f.npy", flow)
    np.testing.assert_array_equal(read_flow(tmp_path / "f.npy"), flow.astype(np.float32))


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("a.flo", b"PIEX" + bytes(8), "202021.25"),
        ("a.flo", b"PIEH" + struct.pack("<ii", 4, 4) + bytes(100), "4x4"),
        ("a.flo", b"PIEH" + struct.pack("<ii", -1, 2), "-1x2"),
        ("a.npy", b"no array", "numpy"),
    ],
)
def test_other_files_are_refused_in_words(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=words):
        read_flow(tmp_path / name)


def test_arrays_of_another_shape_or_with_code_in_them_are_refused(tmp_path):
    np.save(tmp_path / "chw.npy", np.zeros((2, 4, 5)))
    with pytest.raises(BadInput, match=r"\(2, 4, 5\)"):
        read_flow(tmp_path / "chw.npy")
    np.save(tmp_path / "objects.npy", np.array([{"a": 1}], dtype=object))
    with pytest.raises(BadInput, match="without running code"):
        read_flow(tmp_path / "objects.npy")
    with pytest.raises(BadInput, match="cannot be read"):
        read_flow(tmp_path / "absent.flo")


def test_a_flow_file_too_short_for_its_header_is_refused_early(tmp_path):
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (900000, 900000, 2), }"
    header += b" " * (64 - (10 + len(header) + 1) % 64) + b"\n"
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(BadInput, match="too short"):
        read_flow(tmp_path / "a.npy")
    np.savez(tmp_path / "b.npz", a=np.zeros(3))
    (tmp_path / "b.npz").rename(tmp_path / "b.npy")
    with pytest.raises(BadInput, match=r"b\.npy"):
        read_flow(tmp_path / "b.npy")


@pytest.mark.parametrize("name", ["a.npy", "a.flo"])
def test_pipes_and_devices_are_no_flows(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(BadInput, match="named pipe"):
        read_flow(tmp_path / name)
    (tmp_path / name).unlink()
    (tmp_path / name).symlink_to("/dev/zero")
    with pytest.raises(BadInput, match="device"):
        read_flow(tmp_path / name)
