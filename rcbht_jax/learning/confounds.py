"""Properties of labelled data that predict the class without being its cause, as sentences to print beside a score."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, UInt8

from rcbht_jax._util.arms import BOTH, rows_of_arm
from rcbht_jax._util.printable import plural, reasons_of
from rcbht_jax._util.selection import group_numbers
from rcbht_jax.errors import InputError
from rcbht_jax.learning import metrics
from rcbht_jax.learning.class_groups import groups_of_classes, learnable
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from rcbht_jax.learning.wrench_facts import WrenchFacts
from rcbht_jax.types import Recordings

_PAIRS = 5  # of classes that a sentence names
_RARE = 0.05  # probability of what chance does not explain


def examined(
    recordings: Recordings, spec: TaskSpec, facts: WrenchFacts | None = None
) -> tuple[dict[str, int], list[str], list[str]]:
    """What a data set has for a task: intervals of each class; sentences about confounds; others, on what is left out.

    Args:
        recordings: the data set; its samples are not needed.
        spec: the task.
        facts: of all wrenches, see :func:`confounds`.

    Returns:
        of a task that is not possible, no classes, and why.

    Example:
        >>> examined(Recordings.example(), TaskSpec("outcome"))
        ({'failure': 4, 'success': 4}, [], [])
    """
    try:
        items, _ = learnable(labelled_intervals(recordings, spec))
    except InputError as error:
        return {}, [], [str(error)]
    left = [f"{what} left out: {reason}." for what, reason in reasons_of(items.dropped)]
    trials = groups_of_classes(items.y, items.trial, range(len(items.classes)))
    if trials.min() < 2:
        too_few = (
            "to train and to test, two classes must occur in two trials or more; at most one of its "
            f"{len(trials)} classes does."
        )
        return {}, [], [too_few, *left]
    counts = np.bincount(items.y, minlength=len(items.classes)).tolist()
    remarks = [] if spec.arms == BOTH else rows_of_arm(recordings.arm, spec.arms)[1]
    return dict(zip(items.classes, counts, strict=True)), list(confounds(items, facts)), [*left, *remarks]


def confounds(items: LabelledIntervals, facts: WrenchFacts | None = None) -> tuple[str, ...]:
    """Sentences about confounds that this data has; none if no check finds one.

    Checked are sessions that hold a single class, classes that the session alone distinguishes, classes that duration
    alone or, of whole recordings, the first second alone predicts, intervals of one sample, and copies of recordings.
    An empty result does not exclude others.

    Args:
        items: intervals with their classes, durations and sessions.
        facts: of the wrenches of the data set; copies are counted, and first seconds compared, where they are given.
    """
    sentences = [*_sessions(items), _durations(items), *_single_samples(items)]
    if facts is not None:
        sentences.append(_first_second(items, facts))
        rows = np.unique(np.concatenate([i.recording for i in items.intervals]))
        sentences.append(copies(facts.digests[rows]))
    return tuple(filter(None, sentences))


def _sessions(items: LabelledIntervals) -> list[str]:
    sessions = np.unique(items.session)
    held = {str(s): np.unique(items.y[items.session == s]) for s in sessions}
    single = {session: items.classes[classes[0]] for session, classes in held.items() if len(classes) == 1}
    listed = ", ".join(f"{session} ({name})" for session, name in single.items())
    if len(single) == len(held) > 1:
        return [f"No session holds more than one class: {listed}; what separates sessions also separates classes."]
    sentences = []
    if single and len(held) > 1:
        share = np.isin(items.session, list(single)).mean()
        sentences.append(
            f"Sessions that hold a single class have {share:.0%} of the intervals: {listed}; hold sessions out."
        )
    scores, count = session_scores(items)
    if len(apart := np.argwhere(np.triu(scores, 1) > 0.75)) and _by_chance(count) < _RARE:
        pairs = [f"{items.classes[a]} from {items.classes[b]} {scores[a, b]:.0%}" for a, b in apart[:_PAIRS].tolist()]
        more = f" and {plural(len(apart) - _PAIRS, 'other pair')}" if len(apart) > _PAIRS else ""
        sentences.append(
            f"The session alone distinguishes classes (balanced accuracy, chance 50%): {', '.join(pairs)}{more}; what "
            "separates sessions also separates these."
        )
    return sentences


def session_scores(
    items: LabelledIntervals,
) -> tuple[Float[np.ndarray, "class class"], Float[np.ndarray, "session class"]]:
    """Balanced accuracy for every two classes of predicting the one with the larger share of its trials in the session.

    Each trial is left out in turn, and equal shares are half right. The second array counts the trials.
    """
    session, trial = group_numbers(items.session), group_numbers(items.trial)
    member = np.zeros((trial.max() + 1, len(items.classes)), bool)  # [trial, class]
    member[trial, items.y] = True
    place = np.zeros(len(member), np.int64)
    place[trial] = session
    count = np.zeros((session.max() + 1, len(items.classes)))
    np.add.at(count, place, member)
    won = np.zeros((len(items.classes),) * 2)
    for own in range(len(items.classes)):
        rows = member[:, own]
        share = (count[place[rows]] - member[rows]) / np.maximum(count.sum(0) - member[rows], 1)
        won[own] = ((np.sign(share[:, [own]] - share) + 1) / 2).mean(0)
    return (won + won.T) / 2, count


def _by_chance(count: Float[np.ndarray, "session class"]) -> float:
    """Probability of sessions that differ at least as much, if classes did not depend on them (Pearson)."""
    from scipy.special import chdtrc  # slow to import, as in metrics

    expected = count.sum(1, keepdims=True) * count.sum(0) / count.sum()
    freedom = (count.shape[0] - 1) * (count.shape[1] - 1)
    return float(chdtrc(freedom, ((count - expected) ** 2 / expected).sum()))


def _predicting(items: LabelledIntervals, score: float) -> str:
    """A balanced accuracy beside that of chance, in words; "" if it is nearer to chance than to certainty."""
    chance = 1 / len(items.classes)
    return f"balanced accuracy of {score:.0%} (chance {chance:.0%})" if score > (1 + chance) / 2 else ""


def _durations(items: LabelledIntervals) -> str:
    found = _predicting(items, max(duration_score(arm, items.y) for arm in items.seconds.T))
    return found and f"The classes differ in length: the nearest median duration alone predicts them with a {found}."


def _first_second(items: LabelledIntervals, facts: WrenchFacts) -> str:
    spans = items.intervals[0]
    samples = max(1, round(1 / spans.dt))
    if spans.start.any() or len(items.y) < 2 * len(items.classes) or (spans.end <= 2 * samples).any():
        return ""  # of an interval inside a recording, or of a short one, the beginning is the thing itself
    found = _predicting(items, first_mean_score(facts.opening[spans.recording], items.y))
    return found and (
        f"The nearest mean of the first second predicts the classes with a {found}; if nothing happens that early, "
        "bias, tool or pose differ."
    )


def first_mean_score(mean: Float[np.ndarray, "item axis"], y: Int[np.ndarray, " item"]) -> float:
    """Balanced accuracy of the nearest class centre, each item left out in turn; axes have equal weight.

    >>> first_mean_score(np.array([[0.0], [0.1], [5.0], [5.1]]), np.array([0, 0, 1, 1]))
    1.0
    """
    x = (mean - mean.mean(0)) / np.maximum(mean.std(0), 1e-12)
    member = y[:, None] == np.arange(y.max() + 1)
    total, count = member.T.astype(float) @ x, member.sum(0)
    rest = np.maximum(count - member, 1)[..., None]
    centre = (total - np.where(member[..., None], x[:, None], 0)) / rest
    distance = ((x[:, None] - centre) ** 2).sum(-1)
    alone = member & (count == 1)  # nothing is left of such a class
    return metrics.balanced_accuracy(y, np.where(alone, np.inf, distance).argmin(1))


def duration_score(seconds: Float[np.ndarray, " item"], y: Int[np.ndarray, " item"]) -> float:
    """Balanced accuracy of predicting the class whose median duration is nearest, each item left out in turn.

    >>> duration_score(np.array([1.0, 1.1, 3.0, 2.9]), np.array([0, 0, 1, 1]))
    1.0
    """
    medians = np.array([np.median(seconds[y == c]) for c in range(int(y.max()) + 1)])
    distance = np.abs(seconds[:, None] - medians)
    for c in range(len(medians)):
        own = y == c
        distance[own, c] = np.abs(seconds[own] - _median_of_others(seconds[own]))
    return metrics.balanced_accuracy(y, distance.argmin(1))


def _median_of_others(values: Float[np.ndarray, " item"]) -> Float[np.ndarray, " item"]:
    """Median of all values but each one; infinite for a single value."""
    count = len(values) - 1
    if not count:
        return np.full(1, np.inf)
    place = np.argsort(np.argsort(values))
    ordered, middle = np.sort(values), ((count - 1) // 2, count // 2)
    return np.mean([ordered[one + (one >= place)] for one in middle], 0)


def _single_samples(items: LabelledIntervals) -> list[str]:
    single = np.any([i.end - i.start == 1 for i in items.intervals], axis=0)
    counts = (np.bincount(y, minlength=len(items.classes)).tolist() for y in (items.y[single], items.y))
    return [
        f"{short} of {plural(every, 'interval')} of {name} {'is' if short == 1 else 'are'} one sample long."
        for name, short, every in zip(items.classes, *counts, strict=True)
        if short
    ]


def copies(digests: UInt8[np.ndarray, "recording byte"]) -> str:
    """How many of the recordings have the samples of another one before, as a sentence; "" if none has.

    >>> copies(np.array([[7, 1], [7, 2], [7, 1]], np.uint8))
    'Exact copies of another recording: 1; keep copies on one side of every split.'
    """
    count = len(digests) - len(np.unique(digests, axis=0))
    return f"Exact copies of another recording: {count}; keep copies on one side of every split." if count else ""
