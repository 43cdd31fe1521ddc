"""Whether Triton's kernels can run here, as far as that can be reported without a GPU."""

import sys

import pytest
import torch

from stylerf.kernels import gpu


@pytest.fixture
def nvidia(monkeypatch, tmp_path):
    """A machine with a GPU, Triton, gcc and Python's headers, as the checks see it; the folder of the headers."""
    monkeypatch.setattr(gpu.importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(gpu, "interpreted", lambda: False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda: (9, 0))
    monkeypatch.setattr(gpu.shutil, "which", lambda name: "/usr/bin/gcc" if name == "gcc" else None)
    monkeypatch.setattr(gpu.sysconfig, "get_paths", lambda: {"include": str(tmp_path)})
    monkeypatch.delenv("CC", raising=False)
    (tmp_path / "Python.h").touch()
    return tmp_path


def test_all_there(nvidia):
    assert gpu.unavailable() is None


def test_without_a_c_compiler_no_kernel_can_be_launched(nvidia, monkeypatch):
    monkeypatch.setattr(gpu.shutil, "which", lambda name: None)
    assert "install gcc" in gpu.unavailable()
    monkeypatch.setenv("CC", sys.executable)
    assert gpu.unavailable() is None


def test_nor_without_headers(nvidia):
    (nvidia / "Python.h").unlink()
    assert "python3-dev" in gpu.unavailable()


def test_older_gpus_are_refused(nvidia, monkeypatch):
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda: (7, 5))
    assert "8.0 (Ampere) or newer" in gpu.unavailable()
