"""Snaps in a stream: the rule of :mod:`rcbht_jax.introspection.snap_rule` on words of the fit rule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.signals import distinct, numbers_of, period
from rcbht_jax._util.values import expect
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.events import Snap, stamp_of
from rcbht_jax.introspection.reader import Reader
from rcbht_jax.introspection.snap_rule import SnapConfig, Snaps, SnapSizes, fall_time, init, line_of, steps

LOOK = 0.01  # s of each window, if it has two samples in this time
TOLERANCES = 10.0  # of the words in the smallest fall


class SnapDetector(Reader[Snap]):
    """Snaps in a stream of forces, found with words of the fit rule; chunks of any size give the same events.

    Only stamps that are dates may differ, by a microsecond, where samples are not whole microseconds apart.

    Args:
        rate: samples per second.
        axes: their names.
        least: smallest fall that is a snap, N or Nm: a number, or one for each axis.
        most: largest fall.
        load: smallest and largest absolute value from which it falls; numbers, or one for each axis.
        window: samples for each step of the encoder, >= 2; a snap is seen at the end of a step. Default 10 ms.
        tolerance: of the fit rule; default a tenth of the smallest fall.
        config: what else counts as a snap; None = the defaults.

    Raises:
        InputError: axes that are not different names, sizes that are not positive, not in order or not one for each
            axis, a bad rate or window, or a rate at which a snap is shorter than a sample.

    Example:
        >>> force = np.interp(np.arange(600) / 200, [0, 0.5, 2.0, 2.03, 3], [0, 0, 9, 2, 2])  # let go after 2 s
        >>> seen, published = SnapDetector(200.0, ["Fz"], least=3.0).push(force[:, None])
        >>> seen.begin, seen.seen, round(seen.fall, 1), published.seen, published.published, round(published.fall, 1)
        (400, 2.02, 3.5, 2.02, 2.04, 5.8)
    """

    _called = "The detector"

    def __init__(
        self,
        rate: float,
        axes: Sequence[str],
        least: ArrayLike,
        most: ArrayLike = math.inf,
        load: tuple[ArrayLike, ArrayLike] = (0.0, math.inf),
        window: int | None = None,
        tolerance: ArrayLike | None = None,
        config: SnapConfig | None = None,
    ) -> None:
        self.dt = dt = period(rate)
        self.axes, self.config = distinct(axes), SnapConfig() if config is None else config
        expect("The config", self.config, SnapConfig)
        if not fall_time(self.config, dt):
            raise InputError(
                f"A snap falls within {1e3 * self.config.within:g} ms, which is less than a sample at {rate:g} Hz."
            )
        self.sizes = _sizes(len(self.axes), least, most, load)
        self._words = FitConfig(max(2, round(LOOK / dt)) if window is None else window, dt)
        given = self.sizes.least / TOLERANCES if tolerance is None else tolerance
        wide = numbers_of(given, "A list of tolerances").astype(np.float64)
        slopes = np.tile([4.0, 3.0, 2.0, 1.0], (len(self.axes), 1))  # only the lines are used, not the labels
        self._limits = FitLimits(slopes, wide)
        self._encoder = Encoder(self._words, self._limits)
        self.reset()

    def warm_up(self) -> None:
        """Compile the encoder now, instead of in the first :meth:`push`."""
        list(Encoder(self._words, self._limits).lines(np.zeros((self._words.window, len(self.axes)))))

    def reset(self) -> None:
        """Start a new stream."""
        self._encoder.restart()
        self._state = init(self.config, self.dt, self._words.window, (len(self.axes),))

    def _push(self, samples: Any, time: float | None) -> list[Snap]:
        """The snaps that are seen or published."""
        blocks = self._encoder.lines(samples)
        end = self._encoder.received + len(np.asarray(samples))
        events = []
        for block in blocks:
            words, running = (line_of(*lines) for lines in block)
            self._state, found = steps(
                self.config, self.dt, self._words.window, self.sizes, self._state, words, running
            )
            events += self._events(found, running.t1, end, time)
        return events

    def _events(self, new: Snaps, samples: NDArray[np.integer], end: int, time: float | None) -> list[Snap]:
        def at(count: int) -> float:
            """Stamp of the latest of so many samples."""
            return stamp_of(count, end, time, self.dt)

        found = []
        for which in zip(*np.nonzero(new.seen | new.published), strict=True):
            sample, begin, release, fall = int(samples[which]), new.start[which], new.release[which], new.fall[which]
            published = at(sample) if new.published[which] else None
            about = int(begin), at(int(begin) + 1), float(release), float(fall), at(int(new.when[which]))
            found.append(Snap(sample, at(sample), self.axes[which[1]], *about, published))
        return found


def _sizes(axes: int, smallest: Any, largest: Any, load: Any) -> SnapSizes:
    """Sizes ``[axis]``, checked: the smallest and largest fall, and both ends of the load."""
    try:
        values = (smallest, largest, *load)
        least, most, low, high = (np.broadcast_to(np.asarray(value, np.float64), (axes,)) for value in values)
    except (ValueError, TypeError):
        raise InputError(f"least, most and load must be numbers, or have one for each of {axes} axes.") from None
    if not ((least > 0) & (least <= most) & (low >= 0) & (low <= high) & (least < math.inf)).all():
        given = [str(value) for value in values]
        raise InputError(
            f"least is {given[0]}, most {given[1]} and load {given[2]} to {given[3]}; "
            "expected 0 < least <= most, and 0 <= low <= high for the load."
        )
    return SnapSizes(least, most, low, high)
