"""Work in threads: results in order, no more at once than asked for, the first error in order."""

import threading
import time

import pytest

from stages.run.parallel import in_order


@pytest.mark.parametrize("at_once", [1, 2, 5])
def test_results_come_in_order_and_no_more_are_at_work_than_asked_for(at_once):
    lock, now, most = threading.Lock(), [0], [0]

    def work(number: int) -> int:
        with lock:
            now[0] += 1
            most[0] = max(most[0], now[0])
        time.sleep(0.002 * (number % 3))  # later items finish before earlier ones
        with lock:
            now[0] -= 1
        return number * number

    assert list(in_order(work, range(20), at_once)) == [number * number for number in range(20)]
    assert most[0] <= at_once


def test_two_are_really_at_work_at_once():
    both = threading.Barrier(2, timeout=20)
    assert list(in_order(lambda _: both.wait() >= 0, range(2), 2)) == [True, True]


def test_the_first_error_in_order_is_raised_and_later_items_are_dropped():
    begun, second = [], threading.Event()

    def work(number: int) -> int:
        begun.append(number)
        if number == 1:
            second.wait(20)
            raise ValueError("one")
        if number == 2:
            second.set()
            raise ValueError("two")
        return number

    found = []
    with pytest.raises(ValueError, match="one"):
        found += in_order(work, range(100), 3)
    assert found == [0]
    assert max(begun) < 10
