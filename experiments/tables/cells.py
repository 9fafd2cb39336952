"""What tables are made of: lines of Markdown, means with their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

NONE = "–"


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def score(found: dict[str, float] | None, interval: bool = True) -> str:
    """A mean with its 95 % interval, or a dash."""
    if found is None:
        return NONE
    limits = f" ({found['low']:.3f} to {found['high']:.3f})" if interval and "low" in found else ""
    return f"{found['mean']:.3f}{limits}"
