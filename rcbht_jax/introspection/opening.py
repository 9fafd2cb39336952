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
from typing import TypeGuard

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.introspection.resampling import CLOCK_JUMP, LARGEST, on_grid
from rcbht_jax.io.importing.conform import checked_period, clock, fresh
from rcbht_jax.io.messages import Malformed, Message, Reset, Sample
from rcbht_jax.types import Recordings, axis_names

READINGS = 50  # from which the sampling period is taken
TIMELESS = 200.0  # Hz, of readings without time stamps until their rate is known
FARTHEST = 1e30  # s: stamps beyond it do not count, so that differences of stamps are finite
PAUSE = 1.0  # s: a longer step of the stamps is a pause or a jump of the clock, and counts as this
MOST = 1_000_000  # most messages that are held: a source may send no readings, or stamps that do not advance


@dataclass(frozen=True)
class Opening:
    """The first readings of a stream.

    Attributes:
        wrench: ``[time, axis]``, in the units of the axes; readings that are not finite, or absurd, are left out.
        time: their stamps, s; NaN = none.
        messages: the whole stream, these readings included.
        stretch: number of the stretch of each reading; one begins with each trial, and where the clock jumps back.
    """

    wrench: Float[np.ndarray, "time axis"]
    time: Float[np.ndarray, " time"]
    messages: Iterator[Message] = field(repr=False)
    stretch: Int[np.ndarray, " time"]

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes: Fx Fy Fz Mx My Mz if there are six."""
        return axis_names(self.wrench.shape[1])

    def rate(self) -> float:
        """Samples per second by the time stamps, as a round number; of the sensor, if readings repeat its values.

        Raises:
            InputError: fewer than two readings have a time stamp of their own, or the rate is impossible for a sensor.
        """
        chosen = fresh(self.wrench)
        chosen = chosen[np.abs(self.time[chosen]) <= FARTHEST]
        stamps = self.time[chosen]
        steps = np.concatenate([np.diff(np.unique(part)) for part in _parts(stamps, self.stretch[chosen])])
        if len(stamps) > 1 and np.ptp(stamps) == 0:
            raise InputError(
                f"All readings have the time stamp {stamps[0]:g} s: the clock of the source stands still. Leave out "
                "the stamps, and state the rate with --sampling-rate."
            )
        if not len(steps):
            raise InputError("No two readings of a trial have time stamps; state their rate with --sampling-rate.")
        return 1 / checked_period(clock(np.cumsum([0.0, *steps])).period)

    def recordings(
        self, rate: float, axes: Sequence[str], units: Sequence[str] | None = None, bridge: float | None = None
    ) -> Recordings:
        """The readings as one recording, at the moments at which an encoder of this rate gets samples.

        Args:
            rate: samples per second.
            axes, units: of the readings.
            bridge: longest gap that is filled, s; None = as of :class:`~rcbht_jax.introspection.resampling.Resampler`.
        """
        pairs = zip(_parts(self.wrench, self.stretch), _parts(self.time, self.stretch), strict=True)
        read = [on_grid(values, time, rate, bridge) for values, time in pairs]
        return Recordings.from_arrays([np.concatenate(read)], rate, axes=axes, units=units)


def read_opening(messages: Iterator[Message], seconds: float = 0.0, rate: float | None = None) -> Opening:
    """Read the beginning of a stream: ``READINGS`` readings and ``seconds`` seconds; one reading if neither is needed.

    Args:
        messages: the stream.
        seconds: least duration; see :class:`Elapsed`.
        rate: of the samples, Hz, if it is known; the period is then not taken from the readings.

    Raises:
        InputError: the stream, or ``MOST`` messages of it, has no reading.
        KeyboardInterrupt: before the first reading; a later one ends the messages of the opening.

    Example:
        >>> opening = read_opening(iter([Sample((0.0, 1.0), 0.01 * k) for k in range(100)]))
        >>> opening.wrench.shape, opening.rate(), opening.axes, len(list(opening.messages))
        ((50, 2), 100.0, ('axis0', 'axis1'), 100)
    """
    read: list[Message] = []
    samples: list[tuple[int, Sample]] = []  # with their stretch
    elapsed, least = Elapsed(rate), 1 if rate and not seconds else READINGS
    try:
        for message in islice(messages, MOST):
            read.append(message)
            if not elapsed.feed(message):
                continue
            samples.append((elapsed.stretch, message))
            if elapsed.readings >= least and elapsed.seconds >= seconds:
                break
    except KeyboardInterrupt as end:  # raised again after the readings, which are kept so
        if not samples:
            raise
        messages = _ended_by(end)
    if not samples:
        what = f"The first {MOST} messages of the stream have" if len(read) == MOST else "The stream ended and has"
        wrong = next((f"; the first problem: {one.text}" for one in read if isinstance(one, Malformed)), "")
        raise InputError(f"{what} no reading of finite numbers{wrong}.")
    width = Counter(len(sample.wrench) for _, sample in samples).most_common(1)[0][0]
    kept = [(stretch, sample) for stretch, sample in samples if len(sample.wrench) == width]
    time = np.array([np.nan if sample.time is None else sample.time for _, sample in kept])
    wrench = np.array([sample.wrench for _, sample in kept], np.float64)
    return Opening(wrench, time, chain(read, messages), np.array([stretch for stretch, _ in kept]))


def _ended_by(end: KeyboardInterrupt) -> Iterator[Message]:
    """No message, but the interruption of a stream."""
    yield from ()
    raise end


class Elapsed:
    """How long a stream has lasted: the sum of the steps of its stamps, of a step at most ``PAUSE`` s.

    Readings without a stamp count one period each, and so do all of a clock that stands still.

    Args:
        rate: of the samples, Hz, if it is known.

    Example:
        >>> elapsed = Elapsed()
        >>> [elapsed.feed(message) for message in (Sample((0.0,), 0.0), Malformed("x"), Sample((0.0,), 0.5))]
        [True, False, True]
        >>> elapsed.readings, elapsed.seconds
        (2, 0.5)
    """

    def __init__(self, rate: float | None = None) -> None:
        self._period = 1 / (rate or TIMELESS)
        self._latest: float | None = None
        self._advanced, self._untimed = 0.0, 0
        self.readings = 0
        self.stretch = 0  # number of the present one

    @property
    def seconds(self) -> float:
        """Seconds so far."""
        counted = self._untimed if self._advanced else self.readings
        return self._advanced + counted * self._period

    def feed(self, message: Message) -> TypeGuard[Sample]:
        """Count a message; whether it is a reading of finite numbers."""
        if isinstance(message, Reset):
            self.stretch, self._latest = self.stretch + 1, None
        if not (isinstance(message, Sample) and (np.abs(message.wrench) <= LARGEST).all()):
            return False
        self.readings += 1
        self._untimed += message.time is None
        if message.time is None or not abs(message.time) <= FARTHEST:
            return True
        step = 0.0 if self._latest is None else message.time - self._latest
        self.stretch += step < -CLOCK_JUMP
        self._advanced += min(max(step, 0.0), PAUSE)
        if self._latest is None or step > 0 or step < -CLOCK_JUMP:  # others are late
            self._latest = message.time
        return True


def _parts(values: Float[np.ndarray, "time *axis"], stretch: Int[np.ndarray, " time"]) -> list[NDArray[np.float64]]:
    """The values of each stretch."""
    return np.split(values, np.flatnonzero(np.diff(stretch)) + 1)
