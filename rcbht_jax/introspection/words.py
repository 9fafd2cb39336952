"""Words of a stream as events, without a model: they describe any robot's wrench before anything is learned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.signals import distinct, read_chunk
from rcbht_jax._util.values import Copyable, finite
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, checked_limits
from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.errors import InputError
from rcbht_jax.events import Event, ProvisionalWord, SubtaskStarted, Word, stamp_before, stamp_of
from rcbht_jax.introspection.model import Head
from rcbht_jax.labels import AXES, LAYERS, UNIT_OF, name
from rcbht_jax.types import LabelTracks


def words_of_tracks(tracks: LabelTracks, axes: Sequence[str], sample: int, time: float, dt: float) -> list[Word]:
    """Words of the labels ``[axis, slot]`` that were known after ``sample`` samples.

    Args:
        tracks: of one piece of a stream; empty slots are left out.
        axes: their names.
        sample: samples received.
        time: stamp of the latest of them, s.
        dt: s between samples.
    """
    words = []
    for layer in LAYERS:
        track = getattr(tracks, layer)
        spans = np.stack([np.asarray(track.label, np.int32), np.asarray(track.t0), np.asarray(track.t1)], axis=-1)
        for axis, slot in zip(*np.nonzero(spans[..., 0]), strict=True):
            words.append(_word(layer, axes[axis], spans[axis, slot].tolist(), sample, time, dt))
    return words


def words_of_window(
    labels: Int[np.ndarray, "3 3 axis"], axes: Sequence[str], sample: int, time: float, dt: float
) -> list[Word]:
    """Words that one window published, ``[layer, (code, first sample, end), axis]``; code 0 = none."""
    return [
        _word(LAYERS[layer], axes[axis], labels[layer, :, axis].tolist(), sample, time, dt)
        for layer, axis in zip(*np.nonzero(labels[:, 0]), strict=True)
    ]


def _word(layer: str, axis: str, span: list[int], sample: int, time: float, dt: float) -> Word:
    code, begin, end = span
    start, stop = (stamp_before(time, sample - 1 - k, dt) for k in (begin, end))
    return Word(sample, time, layer, axis, name(layer, code), code, begin, end, start, stop)


class Revisions(Copyable):
    """Turns the provisional words after each window into events: new ones, and those whose label has changed.

    Example:
        >>> import dataclasses
        >>> word = Word(10, 0.05, "llb", "Fz", "FX", 5, 0, 10, 0.0, 0.05)
        >>> seen = Revisions()
        >>> [len(seen.after_window([word])) for _ in range(3)]  # reported at its second window, then nothing new
        [0, 1, 0]
        >>> [(e.label, e.revision) for e in seen.after_window([dataclasses.replace(word, label="CT", code=2)])]
        [('CT', 1)]
    """

    def __init__(self) -> None:
        # code, windows and revision of words that are not published yet, by layer, axis and first sample
        self._known: dict[tuple[str, str, int], tuple[int, int, int]] = {}

    def after_window(self, held: Sequence[Word]) -> list[ProvisionalWord]:
        """Events of the words that are provisional after one more window.

        Args:
            held: of :meth:`WordIntrospector.provisional` or :meth:`Introspector.provisional`.
        """
        events = []
        first: dict[tuple[str, str], int] = {}  # sample of what is held of each layer and axis
        for word in held:
            key = word.layer, word.axis, word.begin
            first[key[:2]] = min(first.get(key[:2], word.begin), word.begin)
            code, windows, revision = self._known.get(key, (word.code, 0, 0))
            changed = windows > 1 and code != word.code
            revision += changed
            if changed or windows == 1:
                what = (word.layer, word.axis, word.label, word.code, word.begin, word.start)
                events.append(ProvisionalWord(word.sample, word.time, *what, revision))
            self._known[key] = word.code, windows + 1, revision
        # what begins earlier is published; a later word may only be part of the one before it, and come apart again
        self._known = {key: known for key, known in self._known.items() if key[2] >= first.get(key[:2], 0)}
        return events


class WordIntrospector(Copyable):
    """Words of one stream of wrenches with any axes; the counterpart of ``Introspector`` where there is no model.

    Args:
        config: of the encoder; its type chooses the rule.
        thresholds: limits ``[axis, 4]``; of the fit rule FitLimits.
        axes: names; default those of a wrench.
        units: of each axis; default N and Nm for the axes of a wrench, else none.

    Attributes:
        believed: options of the encoder whose words beliefs would read: the same.

    Raises:
        InputError: thresholds that are not in order, or for other axes, or axes that are not different names.

    Example:
        >>> import rcbht_jax as rj
        >>> stream = WordIntrospector(rj.EncoderConfig(dt=0.01), rj.preset("hiro", ["grip"]), ["grip"], ["N"])
        >>> events = stream.push(np.repeat([0.0, 5.0], [102, 98])[:, None]) + stream.finish()
        >>> [(word.label, word.begin, word.end) for word in events if word.layer == "llb"]
        [('CT', 0, 105), ('FX', 105, 200)]
    """

    heads: tuple[Head, ...] = ()
    certainty = 0.0

    def __init__(
        self,
        config: AnyConfig,
        thresholds: AnyLimits,
        axes: Sequence[str] = AXES,
        units: Sequence[str] | None = None,
    ) -> None:
        self.config = self.believed = config
        self.axes = distinct(axes)
        self.units = tuple(UNIT_OF.get(axis, "") for axis in self.axes) if units is None else tuple(units)
        shape = (*checked_limits(config, thresholds).shape[:-1], 4)
        if shape != (len(self.axes), 4) or len(self.units) != len(self.axes):
            raise InputError(
                f"Thresholds have shape {shape} and there are {len(self.units)} units; expected "
                f"[{len(self.axes)}, 4] and {len(self.axes)}."
            )
        self._limits = thresholds
        self._encoder = Encoder(config, thresholds)
        # Latest published label of each layer and axis: [layer, (code, first sample, end), axis]; code 0 = none yet.
        self.labels: NDArray[np.int32] = np.zeros((3, 3, len(self.axes)), np.int32)
        self._time: float | None = None

    @property
    def received(self) -> int:
        """Samples received so far."""
        return self._encoder.received

    def warm_up(self) -> None:
        """Compile the encoder now, which takes a second or two, not in the first :meth:`push`."""
        Encoder(self.config, self._limits).push(np.zeros((self.config.window, len(self.axes))))
        self.provisional()
        self.finish()

    def begin(self, label: str = "") -> list[Event]:
        """Start a sub-task with the next sample, of this name; words do not depend on it."""
        return [SubtaskStarted(self.received, self._now(), self.received, False, label)]

    def reset(self) -> list[Event]:
        """Start a new trial: forget everything received; no alarm stands that would be cleared."""
        self._encoder.restart()
        self.labels, self._time = np.zeros_like(self.labels), None
        return []

    def push(self, samples: ArrayLike, time: float | None = None) -> list[Event]:
        """Feed samples ``[time, axis]`` in the units of the axes; returns the words that they publish, in order.

        ``time`` and errors are those of ``Introspector.push``.
        """
        time = None if time is None else finite("The time", time)
        samples = read_chunk(samples, self.config.dt, self.axes)
        complete = self.received // self.config.window
        published = self._encoder.push(samples)
        self._time = time
        events: list[Event] = []
        for number, tracks in enumerate(published, complete + 1):
            sample = number * self.config.window
            when = stamp_of(sample, self.received, time, self.config.dt)
            layers = [getattr(tracks, layer) for layer in LAYERS]
            new = np.array([[np.asarray(x)[:, 0] for x in (one.label, one.t0, one.t1)] for one in layers], np.int32)
            self.labels = np.where(new[:, :1] > 0, new, self.labels)
            events += words_of_window(new, self.axes, sample, when, self.config.dt)
        return events

    def provisional(self) -> list[Word]:
        """Words that are not published yet, with labels that may still change; nothing changes."""
        return words_of_tracks(self._encoder.peek(), self.axes, self.received, self._now(), self.config.dt)

    def finish(self) -> list[Event]:
        """The words still held at the end of a stream; :meth:`reset` begins the next one."""
        return [*words_of_tracks(self._encoder.ending(), self.axes, self.received, self._now(), self.config.dt)]

    def _now(self) -> float:
        return stamp_of(self.received, self.received, self._time, self.config.dt)
