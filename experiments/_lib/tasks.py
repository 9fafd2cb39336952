"""The tasks of the snap assembly that experiments score: sub-tasks of whole trials, and listed types of failure."""

from __future__ import annotations

from typing import Any

from rcbht_jax.learning.tasks import TaskSpec
from rcbht_jax.robots.snap_assembly import FAILURE_TYPES


def states(boundaries: str = "harmonised", **filters: Any) -> TaskSpec:
    """Sub-tasks of trials that have all of them."""
    return TaskSpec("states", boundaries, complete=True, **filters)


def failure_types(**filters: Any) -> TaskSpec:
    """Failures by the signs of their deviation, of the types with nine trials or more."""
    return TaskSpec("failure-type", classes=FAILURE_TYPES, **filters)
