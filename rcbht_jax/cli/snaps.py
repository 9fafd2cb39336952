"""The option --snap of the commands that report snaps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from rcbht_jax.cli.command import option
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.introspection.snaps import SnapDetector

SnapSize = Annotated[
    tuple[str, ...],
    option(
        "Report snaps, forces that are released within 40 ms: AXIS=LEAST, the smallest fall in N or Nm; "
        "AXIS=LEAST,MOST, the largest as well; or AXIS=LEAST,MOST,LOW,HIGH, the load before the fall as well.",
        "none",
        metavar="[AXIS=LEAST ...]",
    ),
]


def detector_of(sizes: tuple[str, ...], rate: float) -> SnapDetector | None:
    """The detector that the option selects, for samples at a rate in Hz; None = none.

    Example:
        >>> detector_of(("Fz=3", "Mx=0.2,1"), 200.0).sizes.most.tolist()
        [inf, 1.0]
    """
    import numpy as np

    from rcbht_jax.introspection.snaps import SnapDetector

    if not sizes:
        return None
    table: dict[str, list[float]] = {}
    for text in sizes:
        axis, equals, numbers = text.rpartition("=")
        try:
            values = [float(number) for number in numbers.split(",")]
        except ValueError:
            values = []
        if not equals or not axis or len(values) not in (1, 2, 4):
            raise InputError(f"--snap {text}: expected AXIS=LEAST, AXIS=LEAST,MOST or AXIS=LEAST,MOST,LOW,HIGH.")
        if axis in table:
            raise InputError(f"--snap names {axis} twice.")
        table[axis] = values + [float("inf"), 0.0, float("inf")][len(values) - 1 :]
    least, most, low, high = np.array(list(table.values())).T
    return SnapDetector(rate, tuple(table), least, most, (low, high))
