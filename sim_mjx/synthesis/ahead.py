"""The next items of an iterator, made in a separate thread before they are needed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Generic, TypeVar

Item = TypeVar("Item")
_ON_DEMAND = 2


class _End:
    """Marks the end of the items."""


class Ahead(Generic[Item]):
    """An iterator whose items a thread makes in advance; leaving its context waits for the thread to end.

    An exception that the items raise is raised in place of the next item.

    Args:
        items: iterated in the thread only.
        first: number of items that the thread makes at the beginning.
        more: number of further items to make; called when an item is taken, with the number requested so far and
            the number of those not yet taken. If none is left when one is taken, two are made.

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
        """Whether the next item, or the end, is available without waiting."""
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
