"""Tables in Markdown of the committed results, by name; importing the modules registers them."""

from experiments.tables import beliefs, calibration, engines, external, methods, online, overview, transfer, words  # noqa: F401
from experiments.tables.cells import TABLES

__all__ = ["TABLES"]
