"""A per-view cache with a size limit in bytes."""

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

Item = TypeVar("Item")
Item_co = TypeVar("Item_co", covariant=True)


class PerView(Protocol[Item_co]):
    """One item per view, by index: a list or a BoundedCache."""

    def __len__(self) -> int: ...

    def __getitem__(self, view: int, /) -> Item_co: ...


class BoundedCache(Generic[Item]):
    """Keeps the first items computed, up to `max_bytes` in total; all others are recomputed on every use.

    Every epoch visits the views in a new random order, so it does not matter which ones are kept, and nothing is
    evicted.

    Args:
        make: Computes a view's item, deterministically.
        size: Size of an item in bytes.
    """

    def __init__(self, make: Callable[[int], Item], size: Callable[[Item], int], count: int, max_bytes: float) -> None:
        self._make, self._size, self._count, self._left = make, size, count, max_bytes
        self.kept: dict[int, Item] = {}

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, view: int, /) -> Item:
        if view in self.kept:
            return self.kept[view]
        if not 0 <= view < self._count:
            raise IndexError(view)
        made = self._make(view)
        if self._size(made) <= self._left:
            self._left -= self._size(made)
            self.kept[view] = made
        return made
