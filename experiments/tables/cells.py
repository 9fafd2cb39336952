"""Parts of tables: the register, lines of Markdown, means with their intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from experiments._lib.results_io import committed
from experiments._lib.scores import ends_of, mean_of

NONE = "–"
Lines = Iterable[Sequence[str]]  # of a table, the first one its head


@dataclass(frozen=True)
class Table:
    """A table of the documentation, and the committed results that its numbers come from."""

    draw: Callable[..., Lines]  # takes the results in the order of ``reads``
    reads: tuple[str, ...]
    links: bool = False  # draw also takes ``way``, the path from its page to the results

    def __call__(self, way: str) -> str:
        results = [committed(name) for name in self.reads]
        return markdown(*(self.draw(*results, way=way) if self.links else self.draw(*results)))


TABLES: dict[str, Table] = {}


def table(name: str, *reads: str, links: bool = False) -> Callable[[Callable[..., Lines]], Callable[..., Lines]]:
    """Register a function that draws a table, by name."""

    def register(draw: Callable[..., Lines]) -> Callable[..., Lines]:
        TABLES[name] = Table(draw, reads, links)
        return draw

    return register


def markdown(head: Sequence[str], *rows: Sequence[str]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def ends(low: float, high: float, digits: int = 3) -> str:
    """A 95 % interval behind its mean; nothing where they coincide: the same by construction.

    >>> ends(0.5, 0.75), ends(0.5, 0.75, 2), ends(1.0, 1.0)
    (' (0.500 to 0.750)', ' (0.50 to 0.75)', '')
    """
    return f" ({low:.{digits}f} to {high:.{digits}f})" if low < high else ""


def score(values: dict[str, Any] | None, interval: bool = True) -> str:
    """A mean with its 95 % interval, or a dash."""
    if values is None:
        return NONE
    limits = ends_of(values) if interval else None
    return f"{mean_of(values):.3f}{ends(*limits) if limits else ''}"


def formatted(row: dict[str, Any], forms: dict[str, str]) -> list[str]:
    """Values of a row, each in its format; a dash for those that it lacks."""
    return [format(row[key], form) if key in row else NONE for key, form in forms.items()]
