"""Two processes that train together against one with both their rays; parts, sums, and a process that is lost."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import distributed

from stylerf.errors import InvalidValue
from stylerf.training.common.process_group import SINGLE_PROCESS, DistributedProcesses
from tests.processes import ended, start
from tests.stylerf.training import two_processes


def outcomes(folder: Path, steps: int) -> dict[str, dict[str, np.ndarray]]:
    """What each of two processes came to."""
    processes = start(2, "tests.stylerf.training.two_processes", str(folder), str(steps), folder=folder)
    assert ended(processes, 400) == [0, 0], (folder / "err0").read_text()
    return {path.stem: dict(np.load(path)) for path in sorted(folder.glob("*.npz"))}


@pytest.fixture(scope="module")
def together(tmp_path_factory) -> dict[str, dict[str, np.ndarray]]:
    return outcomes(tmp_path_factory.mktemp("ranks"), 40)


def assert_same(found: list[dict[str, np.ndarray]], alone: dict[str, np.ndarray]) -> dict:
    """Bit for bit, the curve included; returns the state."""
    for place, other in enumerate(found):
        assert other.keys() == alone.keys()
        for name, values in alone.items():
            assert np.array_equal(other[name], values), (place, name)
    return json.loads(str(alone["state"]))


def test_two_processes_fit_as_one_with_the_rays_of_both(together):
    """The same bits, since both add as many buffers: one thread in each, two threads in one process."""
    state = assert_same([together["fit0"], together["fit1"]], two_processes.fitted(40, 2))
    assert state["step"] == 40 and len(state["curve"]) > 10


def test_two_processes_fine_tune_as_one_with_the_rays_of_both(together):
    state = assert_same([together["tune0"], together["tune1"]], two_processes.tuned(2))
    assert state["step"] == 20 and len(state["curve"]) == 2


@pytest.mark.slow
def test_two_processes_grow_and_go_back_as_one(tmp_path):
    found = outcomes(tmp_path, 280)
    state = assert_same([found["fit0"], found["fit1"]], two_processes.fitted(280, 2))
    assert [text.split()[1] for text in state["decisions"]] == ["dropped:"] and state["rays"] > 256


def test_a_budget_of_time_ends_for_all_at_the_same_step(together):
    first, second = together["time0"], together["time1"]
    assert json.loads(str(first["state"]))["step"] > 2
    assert all(np.array_equal(second[name], values) for name, values in first.items())


@pytest.mark.parametrize(
    ("own", "other", "message"),
    [
        ("cuda", "no GPU (invalid device ordinal)", "process 0: cuda; process 1: no GPU .invalid device ordinal"),
        ("cpu", "cuda", "process 0: cpu; process 1: cuda"),
        ("no GPU here", "no GPU here", "^no GPU here$"),
    ],
)
def test_processes_with_unlike_devices_are_refused_before_they_wait(own, other, message):
    ranks, store = DistributedProcesses.__new__(DistributedProcesses), distributed.HashStore()
    ranks._store, ranks.place, ranks.count = store, 0, 2
    store.set("stylerf device 1", other)
    store.set("stylerf read 1", "")
    with pytest.raises(InvalidValue, match=message):
        ranks._compare(own)
    store.set("stylerf device 1", "cpu")
    ranks._compare("cpu")


def test_a_gpu_that_cannot_be_used_is_reported_to_the_others(monkeypatch):
    def refused(number):
        raise RuntimeError(f"CUDA error: invalid device ordinal {number}\nmore of it")

    ranks = DistributedProcesses.__new__(DistributedProcesses)
    ranks._torch = torch
    monkeypatch.setattr(torch.cuda, "set_device", refused)
    monkeypatch.setenv("LOCAL_RANK", "5")
    assert ranks._taken("cuda") == "no GPU (CUDA error: invalid device ordinal 5)" and ranks._taken("cpu") == "cpu"


def test_one_process_has_it_all():
    values, buffers = np.arange(3.0), np.ones((2, 4))
    SINGLE_PROCESS.add(values)
    SINGLE_PROCESS.add_gradients(buffers)
    assert SINGLE_PROCESS.own(7) == slice(0, 7) and SINGLE_PROCESS.of_first(2.5) == 2.5
    assert SINGLE_PROCESS.checkpoint(None) is None
    assert values.tolist() == [0, 1, 2] and (buffers == 1).all()


class Store(dict):
    """What processes tell one another, and what this one has waited for."""

    def __init__(self, values: dict[str, str]) -> None:
        super().__init__({key: value.encode() for key, value in values.items()})
        self.awaited: list[str] = []

    def set(self, key: str, value: str) -> None:
        self[key] = value.encode()

    def set_timeout(self, timeout) -> None:
        pass

    def wait(self, keys: list[str], timeout) -> None:
        self.awaited += keys
        raise RuntimeError("one of them has died")


@pytest.mark.parametrize(("place", "others", "awaited"), [(0, "none", 2), (0, "cpu", 2), (1, "none", 0)])
def test_the_first_process_keeps_the_store_until_all_have_read_it(place, others, awaited):
    """Else the others find it lost, and end as if the first had crashed."""
    one = DistributedProcesses.__new__(DistributedProcesses)
    one.place, one.count = place, 2
    one._store = Store({f"stylerf device {1 - place}": others})
    with pytest.raises(InvalidValue):
        one._compare("none")
    assert f"stylerf read {place}" in one._store and len(one._store.awaited) == awaited
