"""Tables in Markdown of the committed results, by name; importing the modules registers them."""

from experiments.tables import (  # noqa: F401
    calibration,
    engines,
    external,
    failure,
    headline,
    methods,
    online,
    overview,
    transfer,
    words,
)
from experiments.tables.cells import TABLES

__all__ = ["TABLES"]
