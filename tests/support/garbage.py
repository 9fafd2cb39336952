"""What the collector of garbage has to look at: only what the present file of tests has made.

Traced and compiled programs are millions of objects that live to the end. Looked at again in every full collection,
they cost a long run half of its time.
"""

from __future__ import annotations

import gc

ALLOCATIONS = 50_000  # between two collections, in place of 700


def collect_rarely() -> None:
    """For this process."""
    gc.set_threshold(ALLOCATIONS, 10, 10)


def set_aside() -> None:
    """Collect what is garbage now, and look no more at what is left."""
    gc.collect()
    gc.freeze()
