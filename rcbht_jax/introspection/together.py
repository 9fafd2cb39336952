"""Several readers of one stream with the interface of one: a model, words of another rule, snaps, a monitor."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int
from numpy.typing import ArrayLike

from rcbht_jax.encoding.rules import AnyConfig
from rcbht_jax.errors import InputError
from rcbht_jax.events import Event, Word
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import Head
from rcbht_jax.introspection.nominal_watch import NominalWatch
from rcbht_jax.introspection.snaps import SnapDetector
from rcbht_jax.introspection.words import WordIntrospector


class Together:
    """An introspector with words that its model does not read, a detector of snaps, a nominal monitor, or several.

    Args:
        main: reports sub-tasks, and beliefs if it has a model.
        words: whose words are reported in place of those of ``main``.
        snaps: detector on some of the axes; those of ``main`` by name.
        monitor: on some of the axes, likewise.

    Raises:
        InputError: their axes or their sampling periods differ.

    Example:
        >>> import rcbht_jax as rj
        >>> force = np.interp(np.arange(600) / 200, [0, 0.5, 2.0, 2.03, 3], [0, 0, 9, 2, 2])[:, None]
        >>> words = WordIntrospector(rj.EncoderConfig(), rj.preset("hiro", ["Fz"]), ["Fz"])
        >>> events = Together(words, snaps=SnapDetector(200.0, ["Fz"], least=3.0)).push(force)
        >>> [event.published for event in events if type(event).__name__ == "Snap"]
        [None, 2.04]
    """

    def __init__(
        self,
        main: Introspector | WordIntrospector | Together,
        words: WordIntrospector | None = None,
        snaps: SnapDetector | None = None,
        monitor: NominalWatch | None = None,
    ) -> None:
        self._main = main
        self._words: WordIntrospector | Introspector | Together = words or main
        if words is not None and (words.axes != main.axes or not np.isclose(words.config.dt, main.config.dt)):
            raise InputError(
                f"The stream has {', '.join(words.axes)} at {1 / words.config.dt:g} Hz; the model reads "
                f"{', '.join(main.axes)} at {1 / main.config.dt:g} Hz."
            )
        readers = [reader for reader in (snaps, monitor) if reader is not None]
        self._readers = [(reader, reader.columns(main.axes, main.config.dt)) for reader in readers]

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self._main.axes

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each axis."""
        return self._main.units

    @property
    def heads(self) -> tuple[Head, ...]:
        """The classifiers."""
        return self._main.heads

    @property
    def certainty(self) -> float:
        """Probability above which a belief counts as certain."""
        return self._main.certainty

    @property
    def config(self) -> AnyConfig:
        """Options of the encoder of the words."""
        return self._words.config

    @property
    def believed(self) -> AnyConfig:
        """Options of the encoder whose words the beliefs read."""
        return self._main.believed

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

    def reset(self) -> None:
        """Start a new trial."""
        self._main.reset()
        if self._words is not self._main:
            self._words.reset()
        for reader, _ in self._readers:
            reader.reset()

    def push(self, samples: ArrayLike, time: float | None = None) -> list[Event]:
        """Feed samples ``[time, axis]``; returns all events that they cause, in order; see ``Introspector.push``."""
        events = list(self._main.push(samples, time))
        if self._words is not self._main:
            events += self._words.push(samples, time)
        for reader, columns in self._readers:
            events += reader.push(np.asarray(samples)[:, columns], time)
        return sorted(events, key=lambda event: event.sample)
