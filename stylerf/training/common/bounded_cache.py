"""What is made for a view and kept for the next time, as long as there is room: the rest is made anew."""

from collections.abc import Callable, Sequence
from typing import Any


class BoundedCache(Sequence):
    """Made when first asked for. The first to come are kept, up to `most` bytes in all, and never given up for others.

    Views are asked for in an order drawn anew for each round: whichever are kept, as many of them come up.
    make: of a view, always the same. size: bytes of what it made. count: of views.
    """

    def __init__(self, make: Callable[[int], Any], size: Callable[[Any], int], count: int, most: float) -> None:
        self._make, self._size, self._count, self._left = make, size, count, most
        self.kept: dict[int, Any] = {}

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, view: int) -> Any:
        if view in self.kept:
            return self.kept[view]
        if not 0 <= view < self._count:
            raise IndexError(view)
        made = self._make(view)
        if self._size(made) <= self._left:
            self._left -= self._size(made)
            self.kept[view] = made
        return made
