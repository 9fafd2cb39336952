"""How sure is sure: levels of a belief with hysteresis, and alarms that need to last."""

from __future__ import annotations

from collections.abc import Sequence

from rcbht_jax.errors import InputError
from rcbht_jax.introspect.events import Level
from rcbht_jax.metrics import INADMISSIBLE


class Confidence:
    """Level of a belief: certain above ``k``, and until it falls below ``k - margin`` or says something else."""

    def __init__(self, k: float, margin: float) -> None:
        if not INADMISSIBLE <= k < 1 or not 0 <= margin <= k - INADMISSIBLE:
            raise InputError(f"a belief cannot be certain above {k:g} with a margin of {margin:g}; k is 0.5 to 1.")
        self._k, self._margin = k, margin
        self.reset()

    def reset(self) -> None:
        """Forget that anything was certain."""
        self._label, self._since = "", 0.0

    def update(self, label: str, probability: float, time: float) -> tuple[Level, float]:
        """The level of the likeliest class and the seconds for which it has been certain."""
        if label != self._label or probability < self._k - self._margin:
            self._label = ""
        if not self._label and probability > self._k:
            self._label, self._since = label, time
        if self._label:
            return "certain", time - self._since
        return ("uncertain" if probability >= INADMISSIBLE else "inadmissible"), 0.0


class Alarm:
    """Raised when a probability stays above ``k`` for ``hold`` seconds; cleared when it stays as long below 0.5, or
    below ``k`` where that is less."""

    def __init__(self, k: float, hold: float) -> None:
        if not 0 <= hold < float("inf"):
            raise InputError(f"an alarm cannot be held for {hold} s; expected zero or more.")
        self._k, self._hold = k, hold
        self.reset()

    def reset(self) -> None:
        """Calm, as at the beginning."""
        self.raised = False
        self._since: float | None = None

    def update(self, probability: float, time: float) -> bool | None:
        """True if the alarm is raised now, False if it is cleared now, None if nothing changes."""
        against = probability < min(INADMISSIBLE, self._k) if self.raised else probability > self._k
        if not against:
            self._since = None
            return None
        if self._since is None:
            self._since = time
        if time - self._since < self._hold - 1e-9:
            return None
        self.raised, self._since = not self.raised, None
        return self.raised


class Phases:
    """Which sub-task goes on, from beliefs alone: the next one begins when a later class has been certain long enough.

    Sub-tasks follow each other in the order of the classes; one that passes unnoticed is skipped, none comes back.
    """

    def __init__(self, classes: Sequence[str], hold: float) -> None:
        if not 0 <= hold < float("inf"):
            raise InputError(f"the beginning of a sub-task cannot be held for {hold} s; expected zero or more.")
        self._classes, self._hold = tuple(classes), hold
        self.reset()

    def reset(self) -> None:
        """The first sub-task goes on."""
        self.current = 0

    def update(self, label: str, certain_for: float, certain: bool) -> bool:
        """Whether a new sub-task begins now, given the likeliest class and how long it has been certain."""
        number = self._classes.index(label)
        if number <= self.current or not certain or certain_for < self._hold - 1e-9:
            return False
        self.current = number
        return True
