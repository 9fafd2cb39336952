"""What reads some axes of a stream beside an introspector."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from rcbht_jax._util.signals import read_chunk
from rcbht_jax._util.values import Copyable, finite
from rcbht_jax.errors import InputError
from rcbht_jax.events import Event

E = TypeVar("E", bound=Event)


class Reader(Copyable, ABC, Generic[E]):
    """Base of readers of a stream; chunks of any size give the same events.

    An own one sets ``axes`` and ``dt``, and defines ``reset`` and ``_push``, which checks values and consumes nothing
    where it raises an error.

    Attributes:
        axes: names of those that it reads.
        units: of each axis, where it has learned from recordings; none = any.
        dt: s between samples.
        whole_trials: whether nothing can be said of a trial whose beginning was missed.

    Example:
        >>> class Pressed(Reader[Event]):
        ...     axes, dt = ("Fz",), 0.005
        ...
        ...     def reset(self): ...
        ...
        ...     def _push(self, samples, time):
        ...         return [Event(sample=1, time=0.005)] if np.max(samples) > 10 else []
        >>> Pressed().push([[1.0], [3.0]]), len(Pressed().push([[12.0]]))
        ([], 1)
    """

    axes: tuple[str, ...]
    units: tuple[str, ...] = ()
    dt: float
    whole_trials: ClassVar[bool] = False
    _called: ClassVar[str] = "The reader"  # in errors

    def columns(self, axes: Sequence[str], dt: float) -> list[int]:
        """Column numbers of its axes in a signal with these axes and ``dt`` s between samples.

        Raises:
            InputError: the signal lacks an axis or has another rate.

        Example:
            >>> import rcbht_jax as rj
            >>> rj.SnapDetector(200.0, ["Fz"], least=3.0).columns(("Fx", "Fy", "Fz"), 0.005)
            [2]
        """
        if not set(self.axes) <= set(axes):
            raise InputError(f"{self._called} needs the axes {', '.join(self.axes)}; the stream has {', '.join(axes)}.")
        if not np.isclose(dt, self.dt):
            raise InputError(f"{self._called} needs samples at {1 / self.dt:g} Hz; the stream has {1 / dt:g} Hz.")
        return [tuple(axes).index(axis) for axis in self.axes]

    def push(self, samples: ArrayLike, time: float | None = None) -> list[E]:
        """Feed any number of samples ``[time, axis]``; returns the events that come with them, in order.

        Args:
            samples: in the units of the axes, N and Nm of a wrench, tared as the recordings that were learned.
            time: stamp of the last of them, s; None = samples received x period.

        Raises:
            InputError: wrong shape, a frame of other axes or of another rate, a value that is not finite or too large,
                a time that is no number, or, where words are read, more samples than are counted (``MOST_SAMPLES`` of
                :mod:`rcbht_jax.encoding.stream`); then nothing is consumed.
        """
        time = None if time is None else finite("The time", time)
        return self._push(read_chunk(samples, self.dt, self.axes), time)

    @abstractmethod
    def _push(self, samples: Any, time: float | None) -> list[E]:
        """The events of samples whose stamp and axes are checked, but not yet their values."""

    def warm_up(self) -> None:
        """Compile everything now, instead of in the first :meth:`push`."""

    @abstractmethod
    def reset(self) -> Sequence[Event] | None:
        """Start a new trial; returns the events that end the one before, if there are any."""
