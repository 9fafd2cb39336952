"""The next items of an iterator, made in a thread of their own before they are asked for."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Generic, TypeVar

Item = TypeVar("Item")
_ON_DEMAND = 2


class _End:
    """What stands behind the last item."""


class Ahead(Generic[Item]):
    """An iterator over items that a thread makes ahead; a context that ends when that thread has.

    An exception of the items is raised in their place.

    Args:
        items: iterated in the thread only.
        first: items that are asked for at once at the beginning.
        more: how many more items to ask for ahead; called when one is taken, with the number asked for so far and how
            many of them are not taken yet. Where none is coming, two are asked for when one is wanted.

    >>> with Ahead(iter("abc"), first=2, more=lambda asked, coming: 1 - coming) as letters:
    ...     list(letters)
    ['a', 'b', 'c']
    """

    def __init__(self, items: Iterable[Item], first: int, more: Callable[[int, int], int]) -> None:
        self._items, self._more = iter(items), more
        self._thread = ThreadPoolExecutor(1)
        self._coming, self._asked = deque[Future[Item | _End]](), 0
        self._ask(max(first, 1))

    def ready(self) -> bool:
        """Whether the next item, or the end, is there without waiting."""
        self._want()
        return self._coming[0].done()

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        self._want()
        item = self._coming.popleft().result()
        self._ask(self._more(self._asked, len(self._coming)))
        if isinstance(item, _End):
            raise StopIteration
        return item

    def __enter__(self) -> Ahead[Item]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.shutdown(cancel_futures=True)

    def _want(self) -> None:
        if not self._coming:
            self._ask(_ON_DEMAND)

    def _ask(self, count: int) -> None:
        for _ in range(count):
            self._coming.append(self._thread.submit(next, self._items, _End()))
        self._asked += max(count, 0)
