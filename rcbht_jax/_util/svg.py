"""A small picture of labelled bars over time as SVG text, for notebooks: no drawing library is needed."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

_LEFT, _WIDTH, _ROW, _GAP = 110, 720, 12, 3  # pixels


class Bar(NamedTuple):
    """A coloured span and what a pointer shows over it."""

    start: float
    end: float
    color: str
    text: str


def bands(rows: Sequence[tuple[str, Sequence[Bar]]], unit: str) -> str:
    """Rows of bars ``[(title, bars)]``, which are in order of time, on a common time axis.

    Of bars narrower than a pixel, one in each pixel is drawn, so that the size of the text is bounded.

    Example:
        >>> bands([("Fz llb", [Bar(0.0, 1.0, "#252525", "contact")])], "s")[:4]
        '<svg'
    """
    last = max((bar.end for _, bars in rows for bar in bars), default=0.0) or 1.0
    height = len(rows) * (_ROW + _GAP) + 20
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_LEFT + _WIDTH + 10}" height="{height}" '
        'font-family="sans-serif" font-size="10">'
    ]
    for number, (title, bars) in enumerate(rows):
        y = number * (_ROW + _GAP)
        parts.append(f'<text x="{_LEFT - 6}" y="{y + _ROW - 2}" text-anchor="end" fill="gray">{escape(title)}</text>')
        taken = -1  # pixel in which the last bar begins
        for bar in bars:
            x, width = _LEFT + _WIDTH * bar.start / last, max(_WIDTH * (bar.end - bar.start) / last, 0.5)
            if width < 1 and int(x) == taken:
                continue
            taken = int(x)
            parts.append(
                f'<rect x="{x:.1f}" y="{y}" width="{width:.1f}" height="{_ROW}" fill="{escape(bar.color)}">'
                f"<title>{escape(bar.text)}, {bar.start:g} to {bar.end:g} {escape(unit)}</title></rect>"
            )
    parts += [
        f'<text x="{_LEFT}" y="{height - 4}" fill="gray">0</text>',
        f'<text x="{_LEFT + _WIDTH}" y="{height - 4}" text-anchor="end" fill="gray">{last:g} {escape(unit)}</text>',
        "</svg>",
    ]
    return "".join(parts)
