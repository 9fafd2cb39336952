"""Which tasks a data set may answer, and which one is meant where none is named."""

from __future__ import annotations

import numpy as np

from rcbht_jax._util.cells import number_of
from rcbht_jax.errors import InputError
from rcbht_jax.types import Recordings

USUAL_TASK = "states"
NEARLY = 0.8  # share of the trials with a number of their own, above which numbers are measured values, not names


def task_names(recordings: Recordings) -> tuple[str, ...]:
    """Tasks that a data set may answer: tracks, without corrected variants of another one, and columns of text.

    A column of measured values that are stored as text, such as the time of an anomaly, is none.

    >>> import numpy as np
    >>> rows = [(0, "phase", "push", 0.0, 1.0), (0, "phase-harmonised", "push", 0.1, 1.0)]
    >>> task_names(Recordings.from_arrays(np.zeros((1, 400, 6)), annotations=rows))
    ('phase', 'outcome')
    """
    columns = (name for name in column_names(recordings) if name == "outcome" or not _is_measured(recordings, name))
    return (*_tracks(recordings), *columns)


def column_names(recordings: Recordings) -> tuple[str, ...]:
    """Columns that can be a task: outcome and the data set's own texts.

    >>> column_names(Recordings.example())
    ('outcome',)
    """
    texts = (name for name, values in recordings.columns.items() if values.dtype.kind == "U")
    return ("outcome", *texts)


def _is_measured(recordings: Recordings, name: str) -> bool:
    """Whether a column of text has nothing but numbers, nearly as many different ones as trials."""
    rows = zip(recordings.source.tolist(), recordings.trial.tolist(), recordings.column(name).tolist(), strict=True)
    values = [value for _, _, value in set(rows) if value]
    return len(set(values)) > NEARLY * len(values) and not np.isnan(list(map(number_of, values))).any()


def chosen_task(task: str, recordings: Recordings) -> str:
    """The named task; where none is named the only track, else states, or the outcome if it is all there is.

    A track of one label has no classes to distinguish, so it counts only where all tracks are such.

    >>> import numpy as np
    >>> recordings = Recordings.from_arrays(np.zeros((1, 400, 6)))
    >>> chosen_task("", recordings), chosen_task("type", recordings)
    ('outcome', 'type')

    Args:
        task: track or column, which need not be there; "" = none is named.
        recordings: the data set.

    Raises:
        InputError: none is named, and several may be meant.
    """
    tracks, names = _tracks(recordings), task_names(recordings)
    if task:
        return task
    several = [track for track in tracks if len(recordings.annotations.labels[track]) > 1] or tracks
    if len(several) == 1:
        return several[0]
    if USUAL_TASK in names or len(names) == 1:
        return USUAL_TASK if USUAL_TASK in names else names[0]
    raise InputError(f"No task is named, and several may be meant; choose one of {', '.join(names)} with --task.")


def _tracks(recordings: Recordings) -> tuple[str, ...]:
    """The tracks without corrected variants of another one."""
    tracks = recordings.annotations.tracks
    variants = {track for track in tracks for other in tracks if track.startswith(f"{other}-")}
    return tuple(track for track in tracks if track not in variants)
