"""benchmarks/profile.py and regression.py: a step is accounted for to the end, and what is worse is reported."""

import copy
import json

import numpy as np
import pytest

from benchmarks import profile, regression
from stages.pipeline.demo_scene import write_demo
from stages.run.progress import Silent
from tests.stages.importing import imported


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Of a still life of twelve small photos, one capacity, one thread."""
    folder = tmp_path_factory.mktemp("profile")
    write_demo(folder / "photos", 24, 10, 2, 0, 1, Silent())
    imported(folder / "photos", folder / "life")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"CAPACITIES": ("24x8x8",), "LEARNING": 20, "STEPS": 3, "REPEATS": 1}.items():
            patch.setattr(profile, name, value)
        return profile.report_of(folder / "life", [1], folder)


def test_every_kernel_of_a_step_is_timed_and_the_bounds_are_below_them(report):
    (row,) = report["rows"]
    json.dumps(report)
    assert row["kernels_ms"].keys() >= {"march", "color", "color backward", "density backward", "adam", "all else"}
    assert sum(row["kernels_ms"].values()) == pytest.approx(row["step_ms"], abs=0.05)
    assert min(row["kernels_ms"].values()) >= 0 and row["psnr"] > 5
    assert 0 < row["colored"] <= row["samples"] and 0 < row["learning"] <= row["samples"]
    for kernel in ("march", "color backward", "density backward"):  # they do what the bound does, and more
        assert 0 < row["bounds_ms"][kernel] < 3 * row["kernels_ms"][kernel], kernel
    assert row["bandwidth_gb_s"] > 0


def test_kernels_are_their_own_again(report):
    from stylerf.kernels.cpu import vm

    assert vm.march_density.py_func.__name__ == "march_density"


def test_adam_moves_what_has_gradients():
    """Of 32 gradients in two buffers, one run of eight of four is not zero: all is read, a quarter also written."""
    gradients = np.zeros((2, 40), np.float32)
    gradients[1, 9] = 1.0
    assert profile.moved_by_adam(gradients, 0, 32) == 32 * 2 * 4 + 8 * (2 * 4 + 6 * 4)
    assert profile.moved_by_adam(gradients, 16, 32) == 16 * 2 * 4


def test_rows_are_read_and_added_to_where_points_lie():
    size, ranks = np.array([3, 4, 5]), (np.int8(0),) * 2
    rows = 3 * 4 + 4 * 5 + 5 * 3 + 3 + 4 + 5
    table = np.ones(rows * 2, np.float32)
    x = np.random.default_rng(0).random((7, 3)).astype(np.float32)
    sums, to = np.zeros((2, 2), np.float32), np.zeros((2, rows * 2), np.float32)
    profile.read_rows(table, size, ranks, x, 2, sums)
    assert sums.sum(0).tolist() == [7 * 18, 7 * 18]
    profile.add_rows(table, size, ranks, x, 2, np.array([1, 3], np.float32), to)
    assert to.sum(0).reshape(-1, 2).sum(0).tolist() == [7 * 18, 3 * 7 * 18]


def test_the_triad_adds_twice_the_other_array():
    a, b = np.ones(64, np.float32), np.arange(64, dtype=np.float32)
    profile.triad(a, b, (np.int8(0),) * 16, 2)
    assert np.array_equal(a, 1 + 2 * b)


def row_of(**changes) -> dict:
    kernels, bounds = {"march": 40.0, "adam": 1.0}, {"march": 20.0, "adam": 0.5}
    row = {"capacity": "64x8x8", "threads": 1, "step_ms": 100.0, "psnr": 20.0}
    return row | {"kernels_ms": kernels, "bounds_ms": bounds} | changes


def test_a_slower_machine_is_no_regression_and_a_slower_kernel_is():
    before = [row_of()]
    slower = [row_of(step_ms=200.0, kernels_ms={"march": 80.0, "adam": 9.0}, bounds_ms={"march": 40.0, "adam": 1.0})]
    assert regression.worse(before, slower) == []  # adam was too short to be compared
    kernel = copy.deepcopy(before)
    kernel[0]["kernels_ms"]["march"] = 70.0
    assert regression.worse(before, kernel) == ["64x8x8, 1 threads: march to its bound: 3.50, it was 2.00"]
    threads = [row_of(), row_of(threads=2, step_ms=55.0)]
    lost = [row_of(), row_of(threads=2, step_ms=90.0)]
    assert regression.worse(threads, lost) == ["64x8x8, 2 threads: a step to that of one thread: 0.90, it was 0.55"]


@pytest.mark.parametrize("psnr", [19.8, float("nan")])
def test_a_worse_fit_is_reported(psnr):
    (reported,) = regression.worse([row_of()], [row_of(psnr=psnr)])
    assert "dB, it was 20.00" in reported
    assert regression.worse([row_of()], [row_of(psnr=19.9)]) == []
