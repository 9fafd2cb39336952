"""The beginning of a stream from any source: its axes, its sampling rate, and its values at rest.

An encoder needs the number of axes, the sampling period and gradient thresholds before its first sample. A stream
takes the first two from a few readings, the third from some seconds of them. The readings are passed on afterwards, so
nothing of the stream is lost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice

import numpy as np
from jaxtyping import Float

from rcbht_jax.errors import InputError
from rcbht_jax.introspection.resampling import LARGEST, Resampler
from rcbht_jax.io.importing.conform import checked_period, clock, fresh
from rcbht_jax.io.messages import Malformed, Message, Sample
from rcbht_jax.types import Recordings, axis_names

READINGS = 50  # from which the sampling period is taken
TIMELESS = 200.0  # Hz, of readings without time stamps until their rate is known
FARTHEST = 1e30  # s: stamps beyond it do not count, so that differences of stamps are finite
MOST = 1_000_000  # most messages that are held: a source may send no readings, or stamps that do not advance


@dataclass(frozen=True)
class Opening:
    """The first readings of a stream.

    Attributes:
        wrench: ``[time, axis]``, in the units of the axes; readings that are not finite, or absurd, are left out.
        time: their stamps, s; NaN = none.
        messages: the whole stream, these readings included.
    """

    wrench: Float[np.ndarray, "time axis"]
    time: Float[np.ndarray, " time"]
    messages: Iterator[Message] = field(repr=False)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes: Fx Fy Fz Mx My Mz if there are six."""
        return axis_names(self.wrench.shape[1])

    def rate(self) -> float:
        """Samples per second by the time stamps, as a round number; of the sensor, if readings repeat its values.

        Raises:
            InputError: fewer than two readings have a time stamp of their own, or the rate is impossible for a sensor.
        """
        stamps = self.time[fresh(self.wrench)]
        stamps = stamps[np.abs(stamps) <= FARTHEST]
        moments = np.unique(stamps)
        if len(moments) == 1 and len(stamps) > 1:
            raise InputError(
                f"All readings have the time stamp {stamps[0]:g} s: the clock of the source stands still. Leave out "
                "the stamps, and state the rate with --sampling-rate."
            )
        if len(moments) < 2:
            raise InputError("The readings have no time stamps; state their rate with --sampling-rate.")
        return 1 / checked_period(clock(moments).period)

    def recordings(self, rate: float, axes: Sequence[str], units: Sequence[str] | None = None) -> Recordings:
        """The readings as one recording, at the moments at which an encoder of this rate gets samples."""
        grid = Resampler(1 / rate, axes=self.wrench.shape[1])
        stamps = [None if np.isnan(stamp) else stamp for stamp in self.time.tolist()]
        readings = (Sample(tuple(values), stamp) for values, stamp in zip(self.wrench.tolist(), stamps, strict=True))
        read = [grid.feed(reading).samples for reading in readings]
        return Recordings.from_arrays([np.concatenate(read)], rate, axes=axes, units=units)


def read_opening(messages: Iterator[Message], seconds: float = 0.0, rate: float | None = None) -> Opening:
    """Read the beginning of a stream: at least ``READINGS`` readings and ``seconds`` seconds.

    Args:
        messages: the stream.
        seconds: least duration, by the time stamps of the readings.
        rate: of the samples, Hz, if it is known; counts the seconds where no time stamps advance.

    Raises:
        InputError: the stream, or ``MOST`` messages of it, has no reading.

    Example:
        >>> opening = read_opening(iter([Sample((0.0, 1.0), 0.01 * k) for k in range(100)]))
        >>> opening.wrench.shape, opening.rate(), opening.axes, len(list(opening.messages))
        ((50, 2), 100.0, ('axis0', 'axis1'), 100)
    """
    read: list[Message] = []
    samples: list[Sample] = []
    for message in islice(messages, MOST):
        read.append(message)
        if not (isinstance(message, Sample) and (np.abs(message.wrench) <= LARGEST).all()):
            continue
        samples.append(message)
        if len(samples) >= READINGS and duration(samples, rate) >= seconds:
            break
    if not samples:
        what = f"The first {MOST} messages of the stream have" if len(read) == MOST else "The stream ended and has"
        wrong = next((f"; the first problem: {one.text}" for one in read if isinstance(one, Malformed)), "")
        raise InputError(f"{what} no reading of finite numbers{wrong}.")
    width = Counter(len(sample.wrench) for sample in samples).most_common(1)[0][0]
    kept = [sample for sample in samples if len(sample.wrench) == width]
    time = np.array([np.nan if sample.time is None else sample.time for sample in kept])
    return Opening(np.array([sample.wrench for sample in kept], np.float64), time, chain(read, messages))


def duration(samples: Sequence[Sample], rate: float | None) -> float:
    """Seconds between the first and the last reading, by their number where their stamps do not advance."""
    first, last = samples[0].time, samples[-1].time
    if first is None or last is None or not np.isfinite(last - first) or last <= first:
        return len(samples) / (rate or TIMELESS)
    return last - first
