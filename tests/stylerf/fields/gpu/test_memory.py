"""Work cut finer where a GPU's memory does not suffice; forged, so that no GPU is needed."""

import numpy as np
import pytest
import torch

from stylerf.fields.gpu import memory
from stylerf.fields.gpu.memory import FEWEST, free_on, in_parts
from stylerf.style.style_loss import EVERYTHING
from stylerf.training.stylize.arf import CONTENT
from tests.stylerf.training.stylizing import arf


def test_parts_that_do_not_fit_are_halved_and_each_is_done_once():
    tried = []

    def work(begin: int, end: int) -> np.ndarray:
        tried.append(end - begin)
        if end - begin > 3000:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return np.arange(begin, end)

    found = np.concatenate(in_parts(10_000, 8192, work))
    assert np.array_equal(found, np.arange(10_000))
    assert tried == [8192, 4096, 2048, 2048, 2048, 2048, 1808]
    assert in_parts(0, 10, work) == []


def test_what_does_not_fit_in_the_smallest_part_is_reported():
    tried = []

    def work(begin: int, end: int) -> None:
        tried.append(end - begin)
        raise torch.OutOfMemoryError("CUDA out of memory")

    with pytest.raises(torch.OutOfMemoryError):
        in_parts(1 << 20, 4 * FEWEST, work)
    assert tried == [4 * FEWEST, 2 * FEWEST, FEWEST]


def test_a_gpu_says_what_is_free_on_it(monkeypatch):
    monkeypatch.setattr(memory.torch.cuda, "mem_get_info", lambda device: (6e9, 9e9))
    assert free_on("cuda", 1.0) == 6e9 and free_on("cpu", 1.0) == 1.0


def test_features_of_a_stylization_take_half_the_memory_that_is_free(monkeypatch):
    monkeypatch.setattr("stylerf.training.stylize.arf.free_on", lambda device, otherwise: 100.0)
    made = arf({"memory": 1e9}).method.loss
    assert made.memory == 50 and made.windows[0] != EVERYTHING
    assert made._content._left == pytest.approx(CONTENT * 50)
