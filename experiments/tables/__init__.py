"""Tables in Markdown of the committed results, by name; each takes the way from its page to the results."""

from __future__ import annotations

from collections.abc import Callable

from experiments.tables import beliefs, calibration, engines, methods, online, overview, transfer

TABLES: dict[str, Callable[[str], str]] = {
    **overview.TABLES,
    **methods.TABLES,
    **calibration.TABLES,
    **online.TABLES,
    **beliefs.TABLES,
    **engines.TABLES,
    **transfer.TABLES,
}
