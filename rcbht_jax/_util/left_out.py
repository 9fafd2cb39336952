"""What a task leaves out, in words."""

from __future__ import annotations

from collections.abc import Mapping

from rcbht_jax._util.printable import plural

INTERVALS = "intervals, "  # how a reason begins that counts intervals of trials which are used, not trials


def reasons_of(dropped: Mapping[str, int]) -> list[tuple[str, str]]:
    """How much is left out, and why.

    >>> reasons_of({"outcome unknown": 2, "intervals, class in one trial only: peg": 1})
    [('2 trials', 'outcome unknown'), ('1 interval', 'class in one trial only: peg')]
    """
    return [
        (plural(count, "interval" if reason.startswith(INTERVALS) else "trial"), reason.removeprefix(INTERVALS))
        for reason, count in dropped.items()
    ]


def left_out(dropped: Mapping[str, int]) -> str:
    """The same as a sentence that follows others; "" = nothing is left out.

    >>> left_out({"outcome unknown": 2}), left_out({})
    (' Left out: 2 trials (outcome unknown).', '')
    """
    return f" Left out: {', '.join(f'{what} ({why})' for what, why in reasons_of(dropped))}." if dropped else ""
