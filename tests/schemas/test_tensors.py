"""Tensors read back as they were, in every process as the same bytes, and damage is told."""

import subprocess
import sys

import numpy as np
import pytest

from schemas.errors import ArtefactDamaged
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
    with pytest.raises(ArtefactDamaged, match="missing"):
        load_tensors(path)
    save_tensors(path, {"a": np.ones(100)})
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ArtefactDamaged, match=r"a.safetensors"):
        load_tensors(path)
