"""What reads a stream beside its words: a segmenter and a monitor, from their files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from rcbht_jax.introspection.together import Reader


class Reads(NamedTuple):
    """The signal that a model, a segmenter or a monitor reads."""

    axes: tuple[str, ...]
    units: tuple[str, ...]
    rate: float  # Hz
    arm: str = ""  # whose wrench was learned, as it was named


def readers_of(
    segmenter: Path | None, monitor: Path | None, certainty: float, false_alarms: float
) -> tuple[list[Reader], list[Reads]]:
    """The readers of the files that are given, and what each of them reads.

    Args:
        segmenter: of "rcbht segment --write-model".
        monitor: of "rcbht monitor fit".
        certainty: probability above which a label of the segmenter counts as certain.
        false_alarms: share of nominal recordings in which the monitor may raise an alarm.

    Raises:
        InputError: a file is missing, damaged or of another kind, or a number is out of range.
    """
    readers: list[Reader] = []
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
