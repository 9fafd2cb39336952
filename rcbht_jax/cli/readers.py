"""What reads a stream beside its words: snaps by the option --snap, a segmenter and a monitor from their files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from rcbht_jax.cli.command import option
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.introspection.reader import Reader
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


class Reads(NamedTuple):
    """The signal that a model, a segmenter or a monitor reads."""

    axes: tuple[str, ...]
    units: tuple[str, ...]
    rate: float  # Hz
    arm: str = ""  # whose wrench was learned, as it was named


def readers_of(
    segmenter: Path | None, monitor: Path | None, certainty: float, false_alarms: float
) -> tuple[list[Reader[Any]], list[Reads]]:
    """The readers of the files that are given, and what each of them reads.

    Args:
        segmenter: of "rcbht segment --write-model".
        monitor: of "rcbht monitor fit".
        certainty: probability above which a label of the segmenter counts as certain.
        false_alarms: share of nominal recordings in which the monitor may raise an alarm.

    Raises:
        InputError: a file is missing, damaged or of another kind, or a number is out of range.
    """
    readers: list[Reader[Any]] = []
    reads: list[Reads] = []
    if segmenter is not None:
        from rcbht_jax.introspection import segmenter_file
        from rcbht_jax.introspection.segmenter_stream import SegmenterStream

        labels = segmenter_file.load(segmenter)
        reads.append(Reads(labels.axes, labels.units, 1 / labels.encoder.dt, labels.arm))
        readers.append(SegmenterStream(labels, certainty))
    if monitor is not None:
        from rcbht_jax.introspection import nominal_file
        from rcbht_jax.introspection.nominal_watch import NominalWatch

        nominal = nominal_file.load(monitor)
        reads.append(Reads(nominal.axes, nominal.units, nominal.monitor.rate, nominal.arm))
        readers.append(NominalWatch(nominal, false_alarms))
    return readers, reads
