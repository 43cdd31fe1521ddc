"""Tensors read back as they were, in every process as the same bytes, and damage is reported."""

import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
import torch
from safetensors.numpy import save
from safetensors.torch import save_file

from schemas.errors import ArtifactDamaged
from schemas.tensors import load_tensors, save_tensors
from tests.conftest import REPOSITORY


def test_round_trip_of_strided_empty_and_scalar_arrays(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {
        "strided": rng.random((4, 6)).T[::2],
        "half": rng.random(5).astype(np.float16),
        "bytes": np.arange(256, dtype=np.uint8),
        "empty": np.zeros((0, 3), np.int64),
        "scalar": np.array(2.5, np.float32),
    }
    save_tensors(tmp_path / "a.safetensors", arrays, {"schema": "1", "é": "ü"})
    found, metadata = load_tensors(tmp_path / "a.safetensors")
    assert metadata == {"schema": "1", "é": "ü"}
    assert found.keys() == arrays.keys()
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype and found[name].shape == array.shape
        np.testing.assert_array_equal(found[name], array)


@pytest.mark.parametrize("metadata", [None, {"state": '{"a": "é\\n"}'}])
def test_a_file_is_the_librarys_to_the_byte(tmp_path, metadata):
    kinds = (np.bool_, np.uint8, np.int8, np.int16, np.uint16, np.float16, np.int32, np.uint32)
    kinds += (np.float32, np.float64, np.int64, np.uint64)
    arrays = {f"{'ba'[k % 2]}-{k}": np.arange(k + 1).astype(kind) for k, kind in enumerate(kinds)}
    arrays |= {"empty": np.zeros((0, 3), np.float32), "scalar": np.array(7, np.int16)}
    save_tensors(tmp_path / "a.safetensors", arrays, metadata)
    assert (tmp_path / "a.safetensors").read_bytes() == save(arrays, metadata)


def test_arrays_are_written_as_they_lie_and_no_second_time_in_memory(tmp_path):
    large = {name: np.ones(4_000_000, np.float32) for name in "ab"}
    tracemalloc.start()
    try:
        save_tensors(tmp_path / "a.safetensors", large)
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


def test_bytes_do_not_depend_on_the_process(tmp_path):
    code = (
        "import sys, numpy as np; from schemas.tensors import save_tensors; "
        "save_tensors(sys.argv[1], {'b': np.ones(3), 'a': np.zeros(2)}, {c: c for c in sys.argv[2]})"
    )
    for number, order in enumerate(["abcdef", "fedcba", "cadbef"]):
        subprocess.run(
            [sys.executable, "-c", code, tmp_path / f"{number}.safetensors", order], check=True, cwd=REPOSITORY
        )
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1


@pytest.mark.parametrize("keep", [0, 4, 40, -1])
def test_truncated_and_missing_files_are_damage(tmp_path, keep):
    path = tmp_path / "a.safetensors"
    with pytest.raises(ArtifactDamaged, match="missing"):
        load_tensors(path)
    save_tensors(path, {"a": np.ones(100)})
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ArtifactDamaged, match=r"a.safetensors"):
        load_tensors(path)


@pytest.mark.parametrize(("kind", "reported"), [(torch.bfloat16, "BF16"), (torch.float8_e4m3fn, "F8_E4M3")])
def test_types_that_numpy_lacks_are_damage(tmp_path, kind, reported):
    save_file({"density": torch.zeros(4).to(kind)}, tmp_path / "a.safetensors")
    with pytest.raises(ArtifactDamaged, match=f"a.safetensors.*density has the unknown type {reported}"):
        load_tensors(tmp_path / "a.safetensors")
