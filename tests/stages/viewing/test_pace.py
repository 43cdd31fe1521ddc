"""The pace of rendering: the number of threads that is faster, found again when that changes."""

import pytest

from stages.viewing import pace
from stages.viewing.pace import TRY_EVERY, Pace


class Machine:
    """A clock that a batch of rays advances by what it takes with so many threads."""

    def __init__(self, monkeypatch, **seconds: float) -> None:
        self.now, self.seconds = 0.0, seconds
        monkeypatch.setattr(pace.time, "perf_counter", lambda: self.now)
        monkeypatch.setattr(pace, "set_threads", lambda threads: threads)

    def paint(self, measured) -> int:
        with measured as threads:
            self.now += self.seconds["one" if threads == 1 else "all"]
        return threads


def test_exact_pictures_take_the_faster_number_of_threads(monkeypatch):
    machine, measured = Machine(monkeypatch, one=0.1, all=0.5), Pace(4)
    used = [machine.paint(measured.exactly(4096)) for _ in range(4 * TRY_EVERY)]
    assert used[TRY_EVERY:].count(4) == 3 and measured.best == 1
    assert measured.rate == pytest.approx(40_960, rel=1e-3)
    machine.seconds = {"one": 0.1, "all": 0.02}  # the machine is free again
    for _ in range(4 * TRY_EVERY):
        machine.paint(measured.exactly(4096))
    assert measured.best == 4 and measured.rate == pytest.approx(204_800, rel=1e-2)


def test_pictures_in_motion_have_a_rate_of_their_own_and_try_nothing(monkeypatch):
    machine, measured = Machine(monkeypatch, one=0.1, all=0.5), Pace(2)
    for _ in range(TRY_EVERY):
        machine.paint(measured.exactly(4096))
    rate = measured.rate
    assert {machine.paint(measured.in_motion(1000)) for _ in range(3 * TRY_EVERY)} == {1}
    assert measured.moving == pytest.approx(10_000, rel=1e-3) and measured.rate == rate


def test_a_single_thread_has_no_other(monkeypatch):
    machine, measured = Machine(monkeypatch, one=0.1), Pace(1)
    assert {machine.paint(measured.exactly(4096)) for _ in range(2 * TRY_EVERY)} == {1}
