"""Properties of labelled data that predict the class without being its cause, as sentences to print beside a score."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from rcbht_jax._util.digest import content_hash
from rcbht_jax.learning import metrics
from rcbht_jax.learning.tasks import LabelledIntervals
from rcbht_jax.types import Recordings


def confounds(items: LabelledIntervals, recordings: Recordings | None = None) -> tuple[str, ...]:
    """Sentences about confounds that this data has; none if no check finds one.

    Checked are sessions that hold a single class, classes that duration alone predicts, intervals of one sample, and
    copies of recordings. That nothing was found does not mean that nothing is there.

    Args:
        items: intervals with their classes, durations and sessions.
        recordings: the data set of the intervals; copies are counted where it is given.
    """
    sentences = [_sessions(items), _durations(items), *_single_samples(items)]
    if recordings is not None:
        sentences.append(copies(recordings, np.unique(np.concatenate([i.recording for i in items.intervals]))))
    return tuple(filter(None, sentences))


def _sessions(items: LabelledIntervals) -> str:
    sessions = np.unique(items.session)
    held = {str(s): np.unique(items.y[items.session == s]) for s in sessions}
    single = {session: items.classes[classes[0]] for session, classes in held.items() if len(classes) == 1}
    if len(held) < 2 or not single:
        return ""
    listed = ", ".join(f"{session} ({name})" for session, name in single.items())
    if len(single) == len(held):
        return f"No session holds more than one class: {listed}; what separates sessions also separates classes."
    share = np.isin(items.session, list(single)).mean()
    return f"Sessions that hold a single class have {share:.0%} of the intervals: {listed}; hold sessions out."


def _durations(items: LabelledIntervals) -> str:
    chance = 1 / len(items.classes)
    score = max(duration_score(arm, items.y) for arm in items.seconds.T)
    if score <= (1 + chance) / 2:
        return ""
    return (
        f"The classes differ in length: duration alone predicts them with a balanced accuracy of {score:.0%} "
        f"(chance {chance:.0%})."
    )


def duration_score(seconds: Float[np.ndarray, " item"], y: Int[np.ndarray, " item"]) -> float:
    """Balanced accuracy, on the same items, of predicting the class whose median duration is nearest.

    >>> duration_score(np.array([1.0, 1.1, 3.0, 2.9]), np.array([0, 0, 1, 1]))
    1.0
    """
    medians = np.array([np.median(seconds[y == c]) for c in range(int(y.max()) + 1)])
    return metrics.balanced_accuracy(y, np.abs(seconds[:, None] - medians).argmin(1))


def _single_samples(items: LabelledIntervals) -> list[str]:
    single = np.any([i.end - i.start == 1 for i in items.intervals], axis=0)
    return [
        f"{single[items.y == c].sum()} of {(items.y == c).sum()} intervals of {name} are one sample long."
        for c, name in enumerate(items.classes)
        if single[items.y == c].any()
    ]


def copies(recordings: Recordings, rows: Int[np.ndarray, " row"]) -> str:
    """How many of the recordings ``rows`` have the wrench of another one before, as a sentence; "" if none has."""
    distinct = {content_hash([recordings.wrench[row, : recordings.length[row]]]) for row in rows}
    count = len(rows) - len(distinct)
    return f"Exact copies of another recording: {count}; keep copies on one side of every split." if count else ""
