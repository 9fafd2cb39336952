"""Samples in as they come, beliefs and events out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.compiling import host_device, jit
from rcbht_jax._util.signals import read_chunk
from rcbht_jax._util.values import Copyable, expect, finite, number
from rcbht_jax.encoding.encoder import PackedLabels
from rcbht_jax.encoding.rules import AnyConfig
from rcbht_jax.encoding.stream import WindowBuffer, held
from rcbht_jax.errors import InputError
from rcbht_jax.events import (
    AnomalyCleared,
    AnomalyRaised,
    Belief,
    Event,
    FailureType,
    SubtaskStarted,
    Word,
    stamp_before,
    stamp_of,
)
from rcbht_jax.introspection.alarms import Alarm, Confidence, PhaseFilter
from rcbht_jax.introspection.chain import FeatureView, StreamState, begin_stream, step
from rcbht_jax.introspection.model import Head, HeadArrays, IntrospectionModel, head_arrays
from rcbht_jax.introspection.words import words_of_tracks, words_of_window
from rcbht_jax.learning.metrics import CERTAINTY_LEVELS
from rcbht_jax.learning.probability import probability_jax
from rcbht_jax.learning.progress import mixed_jax
from rcbht_jax.types import Array

FAILURE_TYPE = "failure-type"  # the classifier whose belief becomes a FailureType event; also with an underscore
# The classifier that detects from the whole trial which sub-task goes on, and its name where a task is called "phase".
PHASE, PHASE_IN_TRIAL = "phase", "phase in trial"


@dataclass(frozen=True)
class HeadShape:
    """The static properties of a classifier, with which the chain is compiled."""

    view: int  # which of the chain's views it sees
    kernel: str
    gamma: float
    classes: int


@dataclass(frozen=True)
class Chain:
    """The static part of window -> labels -> features -> probabilities; hashable, one compilation each."""

    config: AnyConfig
    scopes: tuple[str, ...]  # [view]
    views: tuple[FeatureView, ...]  # [view]
    heads: tuple[HeadShape, ...]

    @staticmethod
    def of(model: IntrospectionModel) -> Chain:
        """The chain of a model; classifiers with the same scope and view share features."""
        pairs = tuple(dict.fromkeys((head.scope, head.view) for head in model.heads))
        shapes = tuple(
            HeadShape(
                pairs.index((head.scope, head.view)),
                head.machine.svm.spec.kernel,
                head.machine.svm.gamma,
                len(head.classes),
            )
            for head in model.heads
        )
        scopes, views = (tuple(x) for x in zip(*pairs, strict=True))
        return Chain(model.encoder, scopes, views, shapes)


def infer(
    chain: Chain,
    limits: Float[Array, "axis limit"],
    heads: tuple[HeadArrays, ...],
    state: StreamState,
    window: Float[Array, "window axis"],
    count: Int[Array, ""],
    begins: Int[Array, " view"],
) -> tuple[StreamState, tuple[Float[Array, " _class"], ...], PackedLabels]:
    """The whole chain as one pure function; compiled once, it is one call per answer.

    Args:
        chain: static.
        heads: one per classifier.
        limits, state, window, count, begins: as of :func:`rcbht_jax.introspection.chain.step`.

    Returns:
        the new state, the class probabilities of each classifier, and the labels published by a complete window.
    """
    now = state.encoder.time[0] + count
    state, features, published = step(chain.config, chain.views, limits, state, window, count, begins)
    probabilities = []
    for shape, head in zip(chain.heads, heads, strict=True):
        p = probability_jax(head.machine, shape.kernel, shape.gamma, shape.classes, features[shape.view])
        if head.progress is not None:
            seconds = (now - begins[shape.view]).astype(jnp.float32) * jnp.float32(chain.config.dt)
            p = mixed_jax(head.progress, p, seconds)
        probabilities.append(p)
    return state, tuple(probabilities), published


_infer = jit(host=True, static_argnums=0)(infer)
_begin = jit(static_argnums=(0, 1, 2))(begin_stream)  # one small program in place of one per field


class Introspector(Copyable):
    """Beliefs about one stream of wrenches, with a state of fixed size, whatever the length of the stream.

    Args:
        model: see :mod:`rcbht_jax.introspection.model`.
        rate: beliefs per second; "auto" = nearest to ten that fits the sampling period; None = one per window. The
            clock is the number of samples received.
        k: certainty level: a belief is certain when its probability exceeds ``k``, from 0.5 + ``margin`` to less
            than 1 (paper: 0.70 to 0.95).
        margin: a certain belief stays certain until its probability falls below ``k - margin``.
        hold: seconds for which an alarm must stay above its level (the classifier's own, else ``k``) before it is
            raised, and below 0.5 before it is cleared; None = those for which the classifier's level was computed.
        detect: find the start of each sub-task with the model's classifier "phase" instead of :meth:`begin`; see
            :class:`rcbht_jax.introspection.alarms.PhaseFilter`. Features of the sub-task then start at its detection.
        words: also report each published label, as a :class:`rcbht_jax.events.Word`.

    Beliefs depend on the samples and on :meth:`begin`; dividing the samples into other chunks does not change one bit.

    Attributes:
        axes: names of the axes.
        units: of each axis.
        config: options of the encoder.
        believed: options of the encoder whose words the beliefs read: the same.
        heads: the classifiers.
        certainty: the certainty level ``k``.

    Example:
        >>> import rcbht_jax as rj
        >>> recordings = rj.Recordings.example()  # four failures, four successes
        >>> from rcbht_jax.introspection.training import HeadSpec, train_model
        >>> model = train_model(recordings, (HeadSpec(rj.TaskSpec("outcome"), families=("histogram",)),))
        >>> introspector = Introspector(model, rate=2)
        >>> events = introspector.begin() + introspector.push(recordings.wrench[-1])  # [time, 6]
        >>> [type(event).__name__ for event in events], events[-1].label
        (['SubtaskStarted', 'Belief', 'Belief', 'Belief'], 'success')

    Raises:
        InputError: no model, a rate faster than the samples, levels out of range, or no classifier to detect with.
    """

    _fixed = ("model", "heads", "_chain", "_limits", "_heads", "_state")

    def __init__(
        self,
        model: IntrospectionModel,
        rate: float | Literal["auto"] | None = "auto",
        k: float = CERTAINTY_LEVELS[0],
        margin: float = 0.05,
        hold: float | None = None,
        detect: bool = False,
        words: bool = False,
    ) -> None:
        expect("The model", model, IntrospectionModel)
        self.model, self.heads, self.axes, self.units = model, model.heads, model.axes, model.units
        self.config = self.believed = model.encoder
        self.certainty, self._words = k, words
        self._chain = Chain.of(model)
        self._every = _samples_between(rate, model.encoder)
        self._limits = jax.device_put(model.stacked_limits.astype(np.float32), host_device())
        self._heads = tuple(jax.device_put(head_arrays(head), host_device()) for head in model.heads)
        self._confidence = [Confidence(k, margin) for _ in model.heads]
        self._alarms = {
            h.name: Alarm(h.alarm_level or k, h.alarm_hold if hold is None else hold) for h in model.heads if h.alarm
        }
        detector = _detector(model) if detect else None
        self._detector = detector.name if detector else ""
        self._phases = PhaseFilter(detector.classes) if detector else None
        kinds = (head.name for head in model.heads if head.name.replace("_", "-") == FAILURE_TYPE)
        self._kind = next(kinds, "")
        self._failure: tuple[str, str] | None = None  # label and level of the latest event
        self.latest: dict[str, Belief] = {}
        # Latest published label of each layer and axis: [layer, (code, first sample, end), axis]; code 0 = none yet.
        self.labels: NDArray[np.int32] = np.zeros((3, 3, len(self.axes)), np.int32)
        self._restart()

    def _restart(self) -> None:
        state = _begin(self.config, self._chain.views, self.labels.shape[2])
        self._state: StreamState = jax.device_put(state, host_device())
        self._buffer = WindowBuffer(self.config.window, self.labels.shape[2], np.float32)
        self._begins: NDArray[np.int32] = np.zeros(len(self._chain.scopes), np.int32)
        self._time: float | None = None
        self.labels = np.zeros_like(self.labels)

    @property
    def received(self) -> int:
        """Samples received so far."""
        return self._buffer.taken

    def warm_up(self) -> None:
        """Compile the chain now (seconds), instead of in the first :meth:`push`; the stream is unchanged."""
        jax.block_until_ready(self._call())
        if self._words:
            self.provisional()
            self.finish()

    def provisional(self) -> list[Word]:
        """Words that are not published yet, with labels that may still change; the stream is unchanged."""
        return self._held(ends=False)

    def _held(self, ends: bool) -> list[Word]:
        tracks = held(self.config, self._limits, self._state.encoder, self._buffer, ends)
        return words_of_tracks(tracks, self.axes, self.received, self._now(), self.config.dt)

    def finish(self) -> list[Event]:
        """Words still held at the end of a stream, if words are reported; :meth:`reset` begins the next stream."""
        return [*self._held(ends=True)] if self._words else []

    def begin(self, label: str = "", detected: bool = False) -> list[Event]:
        """Start a sub-task of this name with the next sample; ``detected`` = it was not announced by a controller."""
        for view, scope in enumerate(self._chain.scopes):
            if scope == "subtask":
                self._begins[view] = self.received
        for head, confidence in zip(self.model.heads, self._confidence, strict=True):
            if head.scope == "subtask":
                confidence.reset()
        return [SubtaskStarted(self.received, self._now(), self.received, detected, label)]

    def reset(self) -> list[Event]:
        """Start a new trial: forget everything received, all levels and all alarms; those that stood are cleared."""
        raised = [head for head in self.model.heads if head.alarm and self._alarms[head.name].raised]
        events: list[Event] = [
            AnomalyCleared(self.received, self._now(), head.name, self._of_alarm(head)) for head in raised
        ]
        self._restart()
        for confidence in self._confidence:
            confidence.reset()
        for alarm in self._alarms.values():
            alarm.reset()
        if self._phases is not None:
            self._phases.reset()
        self._failure = None
        self.latest = {}
        return events

    def push(self, samples: ArrayLike, time: float | None = None) -> list[Event]:
        """Feed any number of samples ``[time, axis]``; returns the events that they cause, in order.

        Args:
            samples: N and Nm.
            time: stamp of the last of them, s; None = samples received x period.

        Raises:
            InputError: wrong shape, a frame of other axes or of another rate, a value that is not finite, a time that
                is no number, or more samples than are counted (``MOST_SAMPLES`` of
                :mod:`rcbht_jax.encoding.stream`); then nothing is consumed.
        """
        time = None if time is None else finite("The time", time)
        chunk = self._buffer.checked(read_chunk(samples, self.config.dt, self.axes))
        events: list[Event] = []
        end = self.received + len(chunk)
        while len(chunk):
            due = len(chunk) if self._every is None else self._every - self.received % self._every
            chunk = self._buffer.fill(chunk, due)  # no more than the window has room for
            self._time = None if time is None else stamp_before(time, end - self.received, self.config.dt)
            events += self._advance()
        return events

    def _now(self) -> float:
        return stamp_of(self.received, self.received, self._time, self.config.dt)

    def _call(self) -> tuple[StreamState, tuple[Array, ...], PackedLabels]:
        # The buffer is copied: the call may still read it when the next samples come.
        window, count, begins = self._buffer.samples.copy(), np.int32(self._buffer.count), self._begins.copy()
        return _infer(self._chain, self._limits, self._heads, self._state, window, count, begins)

    def _advance(self) -> list[Event]:
        complete = not self._buffer.room
        asked = complete if self._every is None else self.received % self._every == 0
        if not (complete or asked):
            return []
        state, probabilities, published = self._call()
        events = self._answer([np.asarray(p) for p in probabilities]) if asked else []
        if complete:
            self._state, self._buffer.count = state, 0
            new = np.asarray(published.ints).reshape(3, 3, -1)
            self.labels = np.where(new[:, :1] > 0, new, self.labels)
            if self._words:
                events += words_of_window(new, self.axes, self.received, self._now(), self.config.dt)
        return events

    def _answer(self, probabilities: list[NDArray[np.float32]]) -> list[Event]:
        events: list[Event] = []
        sample, time = self.received, self._now()
        for head, confidence, p in zip(self.model.heads, self._confidence, probabilities, strict=True):
            if not np.isfinite(p).all():
                raise InputError(
                    f"the belief of head {head.name} is not finite at sample {sample}; the model is damaged."
                )
            best = int(p.argmax())
            label, probability = head.classes[best], float(p[best])
            level, since = confidence.update(label, probability, time)
            belief = Belief(sample, time, head.name, label, probability, level, since, head.classes, tuple(p.tolist()))
            self.latest[head.name] = belief
            events.append(belief)
            if head.alarm:
                events += self._alarm(head, self._of_alarm(head), sample, time)
        return events + self._failure_type(sample, time) + self._detected()

    def _detected(self) -> list[Event]:
        """The start of a sub-task, if one is detected now."""
        if self._phases is None:
            return []
        belief = self.latest[self._detector]
        began = self._phases.update(belief.probabilities, belief.sample * self.config.dt)  # stamps may be dates
        return self.begin(detected=True) if began else []

    def _of_alarm(self, head: Head) -> float:
        """Latest probability of the class that raises the alarm."""
        return self.latest[head.name].probabilities[head.classes.index(head.alarm)]

    def _alarm(self, head: Head, probability: float, sample: int, time: float) -> list[Event]:
        change = self._alarms[head.name].update(probability, sample * self.config.dt)  # stamps may be dates
        if change is None:
            return []
        return [(AnomalyRaised if change else AnomalyCleared)(sample, time, head.name, probability)]

    def _failure_type(self, sample: int, time: float) -> list[Event]:
        belief = self.latest.get(self._kind)
        if belief is None or not any(alarm.raised for alarm in self._alarms.values()):
            self._failure = None
            return []
        if (belief.label, belief.level) == self._failure:
            return []
        self._failure = belief.label, belief.level
        return [FailureType(sample, time, belief.label, belief.probability, belief.level)]


def _detector(model: IntrospectionModel) -> Head:
    for name in (PHASE_IN_TRIAL, PHASE):
        for head in model.heads:
            if head.name == name and head.scope == "trial" and head.progress is None:  # else of a column
                return head
    raise InputError(
        f'the model has no classifier "{PHASE}" to detect sub-tasks with; train one with: rcbht train-online --detect.'
    )


def _samples_between(rate: float | Literal["auto"] | None, config: AnyConfig) -> int | None:
    """Samples from one belief to the next; None = one per window."""
    if rate is None:
        return None
    if rate == "auto":
        return max(1, round(0.1 / config.dt))
    if not 0 < (rate := number("The rate of beliefs", rate)) < float("inf"):
        raise InputError(f"{rate} beliefs per second were asked for; expected a positive number, or none.")
    every = round(1 / (rate * config.dt))
    if every < 1 or abs(every * rate * config.dt - 1) > 0.01:
        raise InputError(
            f"{rate:g} beliefs per second do not fit samples every {config.dt:g} s; choose {1 / config.dt:g} Hz "
            "divided by a whole number."
        )
    return every
