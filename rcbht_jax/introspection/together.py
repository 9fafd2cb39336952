"""Several readers of one stream with the interface of one: a model, words of another rule, snaps, a monitor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Int
from numpy.typing import ArrayLike

from rcbht_jax._util.signals import check_axes, read_chunk
from rcbht_jax._util.values import Copyable
from rcbht_jax.encoding.rules import AnyConfig
from rcbht_jax.errors import InputError
from rcbht_jax.events import Event, Word
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import Head
from rcbht_jax.introspection.reader import Reader
from rcbht_jax.introspection.segmenter_stream import SegmenterHead, SegmenterStream
from rcbht_jax.introspection.words import WordIntrospector


class Together(Copyable):
    """An introspector, and other readers of the same stream.

    Args:
        main: reports sub-tasks, and beliefs if it has a model.
        words: whose words are reported in place of those of ``main``.
        readers: of :class:`rcbht_jax.introspection.reader.Reader`, such as
            :class:`rcbht_jax.introspection.snaps.SnapDetector`,
            :class:`rcbht_jax.introspection.nominal_watch.NominalWatch` and
            :class:`rcbht_jax.introspection.segmenter_stream.SegmenterStream`; each gets its axes by name.

    Attributes:
        axes: names of the axes.
        units: of each axis.
        config: options of the encoder of the words.
        believed: options of the encoder whose words the beliefs read.
        heads: the classifiers, also that of a segmenter.
        certainty: probability above which a belief counts as certain.

    Raises:
        InputError: their axes or their sampling periods differ, a reader has learned an axis in another unit, or two
            classifiers have the same name.

    Example:
        >>> import rcbht_jax as rj
        >>> force = np.interp(np.arange(600) / 200, [0, 0.5, 2.0, 2.03, 3], [0, 0, 9, 2, 2])[:, None]
        >>> words = WordIntrospector(rj.EncoderConfig(), rj.preset("hiro", ["Fz"]), ["Fz"])
        >>> events = Together(words, readers=[rj.SnapDetector(200.0, ["Fz"], least=3.0)]).push(force)
        >>> [event.published for event in events if type(event).__name__ == "Snap"]
        [None, 2.04]
    """

    _fixed = ("heads",)

    def __init__(
        self,
        main: Introspector | WordIntrospector | Together,
        words: WordIntrospector | None = None,
        readers: Sequence[Reader[Any]] = (),
    ) -> None:
        self._main = main
        self._words: WordIntrospector | Introspector | Together = words or main
        if words is not None and (words.axes != main.axes or not np.isclose(words.config.dt, main.config.dt)):
            raise InputError(
                f"The stream has {', '.join(words.axes)} at {1 / words.config.dt:g} Hz; the model reads "
                f"{', '.join(main.axes)} at {1 / main.config.dt:g} Hz."
            )
        self.axes: tuple[str, ...] = main.axes
        self.units: tuple[str, ...] = main.units
        self.certainty: float = main.certainty
        self.config: AnyConfig = self._words.config
        self.believed: AnyConfig = main.believed
        segmenters = (reader.head for reader in readers if isinstance(reader, SegmenterStream))
        self.heads: tuple[Head | SegmenterHead, ...] = (*main.heads, *segmenters)
        names = [head.name for head in self.heads]
        if twice := [name for name in names if names.count(name) > 1]:
            raise InputError(f"Two classifiers of the stream are named {twice[0]}; use one of them.")
        self._readers = [(reader, reader.columns(main.axes, main.config.dt)) for reader in readers]
        for reader, columns in self._readers:
            read = [main.axes[column] for column in columns]
            check_axes(read, [main.units[column] for column in columns], read, reader.units, "The stream")
        self._waiting: list[Reader[Any]] = []

    @property
    def labels(self) -> Int[np.ndarray, "3 3 axis"]:
        """Latest published label of each layer and axis."""
        return self._words.labels

    @property
    def received(self) -> int:
        """Samples received so far."""
        return self._main.received

    def warm_up(self) -> None:
        """Compile everything now; the stream is unchanged."""
        self._main.warm_up()
        if self._words is not self._main:
            self._words.warm_up()
        for reader, _ in self._readers:
            reader.warm_up()

    def provisional(self) -> list[Word]:
        """Words that are not published yet, with labels that may still change."""
        return self._words.provisional()

    def begin(self, label: str = "") -> list[Event]:
        """Start a sub-task with the next sample, of this name."""
        return self._main.begin(label)

    def finish(self) -> list[Event]:
        """The words still held at the end of a stream, where words are reported."""
        return self._words.finish()

    def reset(self) -> list[Event]:
        """Start a new trial; alarms that stood are cleared."""
        events = list(self._main.reset())
        if self._words is not self._main:
            events += self._words.reset()
        for reader, _ in self._readers:
            events += reader.reset() or ()
        self._waiting = []
        return events

    def wait(self) -> None:
        """Leave readers of whole trials silent until the next :meth:`reset`: what follows is no beginning."""
        if isinstance(self._main, Together):
            self._main.wait()
        self._waiting = [reader for reader, _ in self._readers if reader.whole_trials]

    def push(self, samples: ArrayLike, time: float | None = None) -> list[Event]:
        """Feed samples ``[time, axis]``; returns all events that they cause, in order; see ``Introspector.push``."""
        samples = read_chunk(samples, self.config.dt, self.axes)
        events = list(self._main.push(samples, time))
        if self._words is not self._main:
            events += self._words.push(samples, time)
        for reader, columns in self._readers:
            if reader not in self._waiting:
                events += reader.push(np.asarray(samples)[:, columns], time)
        return sorted(events, key=lambda event: event.sample)
