"""Items made ahead in a thread come in their order, with their errors, and no thread is left behind."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from sim_mjx.synthesis.ahead import Ahead

LIMIT = 30.0  # s


def until(what: object) -> None:
    """Wait until a function says so."""
    end = time.monotonic() + LIMIT
    while not what():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.001)


def counted(count: int, made: list[int]) -> Iterator[int]:
    """Numbers, which are also noted when they are made."""
    for number in range(count):
        made.append(number)
        yield number


def test_items_come_in_order_and_are_made_no_further_ahead_than_asked() -> None:
    made: list[int] = []

    with Ahead(counted(20, made), first=5, more=lambda asked, coming: 2 - coming) as coming:
        until(lambda: len(made) == 5)
        for number in range(20):
            assert next(coming) == number
            assert len(made) <= max(5, number + 3)
        until(coming.ready)
        assert list(coming) == []
        assert list(coming) == []


def test_it_is_ready_when_the_next_item_is_there() -> None:
    go = threading.Event()

    def items() -> Iterator[int]:
        yield 1
        assert go.wait(LIMIT)
        yield 2

    with Ahead(items(), first=1, more=lambda asked, coming: 1 - coming) as coming:
        assert next(coming) == 1
        assert not coming.ready()
        go.set()
        until(coming.ready)
        assert next(coming) == 2


def test_what_nobody_asks_for_ahead_is_made_when_it_is_wanted() -> None:
    made: list[int] = []

    with Ahead(counted(7, made), first=3, more=lambda asked, coming: 4 - asked) as coming:
        assert [next(coming) for _ in range(4)] == [0, 1, 2, 3]
        time.sleep(0.05)
        assert made == [0, 1, 2, 3]
        until(coming.ready)
        assert [*coming] == [4, 5, 6]


def test_an_error_comes_in_the_place_of_its_item_and_leaving_ends_the_thread() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("no second one")

    before = threading.active_count()
    with Ahead(items(), first=4, more=lambda asked, coming: 1 - coming) as coming:
        assert next(coming) == 1
        with pytest.raises(ValueError, match="no second one"):
            next(coming)
    assert threading.active_count() == before
