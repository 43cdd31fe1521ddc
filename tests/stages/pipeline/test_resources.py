"""Which device is chosen, and how threads and memory are limited."""

import os
import subprocess
import sys

import pytest

from schemas.errors import UsageError
from schemas.safe_reading import MIN_ALLOWANCE, allowance
from stages.pipeline import resources
from stages.pipeline.resources import claim, resolved_device
from stages.run import memory
from stages.run.memory import free
from tests.conftest import REPOSITORY


@pytest.fixture(autouse=True)
def few_devices(monkeypatch):
    monkeypatch.setattr(resources, "_may_have_gpu", lambda: False)


def test_cuda_that_is_not_there_is_a_usage_error():
    import torch

    if torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    assert resolved_device("auto") == "cpu"
    with pytest.raises(UsageError, match="--device cpu"):
        resolved_device("cuda")


def test_more_processes_than_gpus_use_the_cpu_or_are_refused(monkeypatch):
    import torch

    monkeypatch.setattr(resources, "_may_have_gpu", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    for count in ("2", "3"):
        said = []
        for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE"):
            monkeypatch.setenv(name, count)
        monkeypatch.setenv("RANK", "0")
        assert resolved_device("auto", said.append) == ("cuda" if count == "2" else "cpu")
        assert [line.startswith("computing on the CPU: 3 processes") for line in said] == [True] * (count == "3")
    assert torch.backends.cudnn.allow_tf32 is False
    with pytest.raises(UsageError, match=r"3 processes on this machine.* are 2; start 2"):
        resolved_device("cuda")
    monkeypatch.delenv("RANK")  # no launcher
    assert resolved_device("cuda") == "cuda"


def test_auto_does_not_import_torch_without_a_gpu_device(monkeypatch):
    monkeypatch.undo()
    monkeypatch.setattr(os.path, "exists", lambda path: False)
    monkeypatch.setitem(sys.modules, "torch", None)  # an import would raise
    assert resolved_device("auto") == "cpu"


def test_threads_reach_libraries_imported_later():
    code = (
        "from stages.pipeline.resources import claim; claim(1, 0)\n"
        "import os, numba; print(os.environ['OMP_NUM_THREADS'], numba.get_num_threads())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert done.stdout == "1 1\n"


def test_fewer_threads_once_numba_runs_do_not_break_its_compiler():
    code = (
        "import numba; numba.set_num_threads(2)\n"
        "from stages.pipeline.resources import claim; claim(1, 0)\n"
        "print(numba.njit(lambda x: x + 1)(1), numba.get_num_threads())"
    )
    ours = {"NUMBA_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY, env=os.environ | ours
    )
    assert done.stdout == "2 1\n"


def test_one_image_may_take_what_the_run_may():
    claim(None, 50 * 10**9)
    assert 40e9 < allowance() <= 50e9
    claim(None, 256 * 10**6)
    assert allowance() == MIN_ALLOWANCE  # the program alone takes more, and a photo must be read all the same
    claim(None, 0)
    assert MIN_ALLOWANCE <= allowance() < free()


@pytest.mark.parametrize(
    ("quota", "processes", "expected"), [(2.5, 1, 2), (float("inf"), 1, 16), (0.5, 1, 1), (8, 2, 4)]
)
def test_threads_follow_quota_and_launched_processes(monkeypatch, quota, processes, expected):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(16), raising=False)
    monkeypatch.setattr(memory, "cores", lambda: quota)
    monkeypatch.setenv("LOCAL_WORLD_SIZE", str(processes))
    assert resources.usable_threads() == expected
