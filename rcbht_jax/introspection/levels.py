"""How sure is sure: levels of a belief with hysteresis, and alarms that need to last."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rcbht_jax.errors import InputError
from rcbht_jax.events import Level
from rcbht_jax.learning.metrics import INADMISSIBLE

LEAST = 1e-4  # probability that a belief gives a sub-task at least: no single look may rule one out


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


class PhaseFilter:
    """Which sub-task goes on, from beliefs alone: the filter of a Markov chain that only goes forwards.

    Sub-tasks follow each other in the order of the classes; one that passes unnoticed is skipped, none comes back. The
    next one begins when it is likelier than not that the present one is over.

    Args:
        classes: in the order of the sub-tasks.
        stay: seconds that a sub-task lasts in the mean, before anything is seen. A guess of the right order will do.
        memory: seconds after which another belief is as good as an independent one; looks that are nearer count less.
    """

    def __init__(self, classes: Sequence[str], stay: float = 1.0, memory: float = 0.1) -> None:
        if not (0 < stay < float("inf") and 0 < memory < float("inf")):
            raise InputError(f"sub-tasks that last {stay} s with a memory of {memory} s: both have to be positive.")
        self._count, self._stay, self._memory = len(classes), stay, memory
        self.reset()

    def reset(self) -> None:
        """The first sub-task goes on."""
        self.current, self._time = 0, 0.0
        self.filtered = np.eye(self._count)[0]  # probability of each sub-task, given all that was seen

    def update(self, probabilities: Sequence[float], time: float) -> bool:
        """Whether a new sub-task begins now, given the belief ``[class]`` and the time since the trial began, s."""
        passed, self._time = time - self._time, time
        mean = passed / self._stay
        # Probability that so many sub-tasks pass meanwhile (Poisson).
        moves = np.exp(-mean) * np.cumprod([1.0, *(mean / k for k in range(1, self._count))])
        ahead = np.convolve(self.filtered, moves)[: self._count]
        ahead[-1] += 1.0 - ahead.sum()
        seen = ahead * np.maximum(probabilities, LEAST) ** min(passed / self._memory, 1.0)
        self.filtered = seen / seen.sum()
        number = int(np.searchsorted(self.filtered.cumsum(), 0.5))  # of which and of later ones more than half
        began = number > self.current
        self.current = max(number, self.current)
        return began
