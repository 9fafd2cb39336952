"""Which devices of this machine a command uses, and work that is shared among them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import TypeVar

from rcbht_jax.errors import InputError

Result = TypeVar("Result")


def checked(devices: str) -> str:
    """The value of an option such as ``--devices all``.

    Raises:
        InputError: neither "all" nor a number.
    """
    if devices != "all" and not (devices.isdecimal() and int(devices)):
        raise InputError(f'--devices is {devices!r}; expected "all", or a number of GPUs.')
    return devices


def wanted(devices: str, present: int) -> int:
    """Number of devices that such an option selects.

    Raises:
        InputError: neither "all" nor a number, or more than there are.

    Example:
        >>> wanted("all", 4), wanted("2", 4)
        (4, 2)
    """
    count = present if checked(devices) == "all" else int(devices)
    if count > max(1, present):
        raise InputError(f"--devices is {count}; expected at most {present}, the number of GPUs here.")
    return count


def in_turn(tasks: Sequence[Callable[[], Result]], devices: int) -> Iterator[Result]:
    """Results of tasks in their order, of which each device has every n-th.

    A program with loops whose end the device decides keeps the thread that started it: each device has one of its own.

    Example:
        >>> list(in_turn([lambda: "a", lambda: "b", lambda: "c"], devices=2))
        ['a', 'b', 'c']
    """
    if devices < 2:
        yield from (task() for task in tasks)
        return
    with ExitStack() as stack:
        threads = [stack.enter_context(ThreadPoolExecutor(1)) for _ in range(devices)]
        for thread in threads:
            stack.callback(thread.shutdown, wait=False, cancel_futures=True)
        begun = [threads[number % devices].submit(task) for number, task in enumerate(tasks)]
        yield from (one.result() for one in begun)
