"""A nominal monitor as a reader of a stream: its score as an event, and an alarm above its threshold."""

from __future__ import annotations

from typing import Any

from rcbht_jax.events import AnomalyCleared, AnomalyRaised, AnomalyScore, Event, stamp_of
from rcbht_jax.introspection.alarms import conformal_p
from rcbht_jax.introspection.nominal_file import MonitorFile
from rcbht_jax.introspection.reader import Reader

MONITOR = "monitor"  # name in the events of alarms


class NominalWatch(Reader[Event]):
    """The scores of a nominal monitor over a stream, and its alarms.

    The stream must begin where recordings of the skill do; :meth:`reset` begins the next one. After a gap that is too
    long to be bridged, a session leaves the watch silent until then, since the time in the skill is not known. The
    alarm is raised as soon as a score exceeds the threshold, and cleared when none has for ``memory`` seconds of the
    monitor.

    Args:
        file: a fitted monitor, and the axes that it reads.
        false_alarms: share of nominal recordings that may raise an alarm, if they last no longer than those that set
            the threshold; call :meth:`reset` when the skill ends.

    Raises:
        InputError: too few recordings set the threshold for this share.

    Example:
        >>> import numpy as np
        >>> from rcbht_jax.introspection.nominal import NominalMonitor
        >>> rng = np.random.default_rng(0)
        >>> monitor = NominalMonitor(rate=20).fit(0.1 * rng.normal(size=(40, 80, 1)))
        >>> watch = NominalWatch(MonitorFile(monitor, ("grip",), ()), false_alarms=0.05)
        >>> {type(event).__name__ for event in watch.push(0.1 * rng.normal(size=(40, 1)))}
        {'AnomalyScore'}
        >>> [event.time for event in watch.push(np.full((20, 1), 3.0)) if isinstance(event, AnomalyRaised)]
        [2.1]
    """

    whole_trials = True
    _fixed, _called = ("_monitor",), "The monitor"

    def __init__(self, file: MonitorFile, false_alarms: float = 0.05) -> None:
        monitor = self._monitor = file.monitor
        self.axes, self.units, self.dt = file.axes, file.units, 1 / monitor.rate
        self.threshold = monitor.threshold(false_alarms)
        self._hold = monitor.memory
        self._restart()

    def reset(self) -> list[Event]:
        """Start a new recording; an alarm that stood is cleared."""
        cleared = AnomalyCleared(self._received, self._time, MONITOR, self._probability)
        events: list[Event] = [cleared] if self._raised else []
        self._restart()
        return events

    def _restart(self) -> None:
        self._stream = self._monitor.stream()
        self._received, self._above, self._raised = 0, 0, False  # samples; after which the threshold was exceeded
        self._time = self._probability = 0.0  # of the latest sample and score

    def _push(self, samples: Any, time: float | None) -> list[Event]:
        """The scores and alarms."""
        scores = self._stream.push(samples)
        count = len(scores)
        end = self._received + count
        step = self._monitor.score_step
        first = -(self._received + 1) % step  # the first sample with a new score
        events: list[Event] = []
        for place in range(first, count, step):
            sample = self._received + place + 1
            events += self._judged(sample, stamp_of(sample, end, time, self.dt), float(scores[place]))
        self._received, self._time = end, stamp_of(end, end, time, self.dt)
        return events

    def _judged(self, sample: int, time: float, score: float) -> list[Event]:
        """The score after a sample, and the alarm that it raises or clears."""
        p = conformal_p(self._monitor.peaks_, score)
        events: list[Event] = [AnomalyScore(sample, time, score, self.threshold, p)]
        if score > self.threshold:
            self._above = sample
        raised = self._above > 0 and (sample - self._above) * self.dt < self._hold
        if raised != self._raised:
            events.append((AnomalyRaised if raised else AnomalyCleared)(sample, time, MONITOR, 1 - p))
        self._raised, self._probability = raised, 1 - p
        return events
