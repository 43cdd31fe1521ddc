"""Processes several items at once in threads: for codecs and numpy, which let other threads run."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(work: Callable[[Item], Result], items: Iterable[Item], at_once: int) -> Iterator[Result]:
    """Yield `work(item)` of each item in their order, with at most `at_once` of them in progress or waiting to be read.

    Exceptions of `work` are raised here, for the first item in order that failed. Leaving early waits for items in
    progress. With `at_once` 1 nothing runs in another thread.
    """
    if at_once <= 1:
        yield from map(work, items)
        return
    pool: ThreadPoolExecutor = ThreadPoolExecutor(at_once, "stylerf")
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) == at_once:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown()  # each item has its thread: none waits in a queue
