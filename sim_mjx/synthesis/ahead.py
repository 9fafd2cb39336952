"""The next items of an iterator, made in a thread of their own before they are asked for."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Generic, TypeVar

Item = TypeVar("Item")


class _End:
    """What stands behind the last item."""


class Ahead(Generic[Item]):
    """An iterator over items that a thread makes ahead; a context that ends when that thread has.

    An exception of the items is raised in their place.

    Args:
        items: iterated in the thread only.
        first: items that are asked for at once at the beginning.
        most: how many items are asked for ahead from then on, 1 or more; called when one is taken.

    >>> with Ahead(iter("abc"), first=2, most=lambda: 1) as letters:
    ...     list(letters)
    ['a', 'b', 'c']
    """

    def __init__(self, items: Iterable[Item], first: int, most: Callable[[], int]) -> None:
        self._items, self._most = iter(items), most
        self._thread = ThreadPoolExecutor(1)
        self._coming = deque[Future[Item | _End]]()
        for _ in range(max(first, 1)):
            self._ask()

    def ready(self) -> bool:
        """Whether the next item, or the end, is there without waiting."""
        return self._coming[0].done()

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        item = self._coming.popleft().result()
        for _ in range(len(self._coming), max(self._most(), 1)):
            self._ask()
        if isinstance(item, _End):
            raise StopIteration
        return item

    def __enter__(self) -> Ahead[Item]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.shutdown(cancel_futures=True)

    def _ask(self) -> None:
        self._coming.append(self._thread.submit(next, self._items, _End()))
