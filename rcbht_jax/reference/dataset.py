"""The offline taxonomy on a whole data set."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import jax
import numpy as np
from jaxtyping import Float32, Float64
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES
from rcbht_jax.reference.encode import encode, sample_times
from rcbht_jax.reference.tracks import to_tracks
from rcbht_jax.robots.snap_assembly import RECORDED
from rcbht_jax.types import LabelTracks, Recordings


def as_written(values: Float32[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    """The shortest decimal number of each single-precision value, in double precision.

    The files have at most seven digits, so this is the number in the file, on which labels can depend.
    """
    return values.astype("U").astype(np.float64)


def encode_dataset(
    recordings: Recordings,
    *,
    robot: str = "hiro",
    version: str = "master",
    clean: bool = False,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> LabelTracks:
    """Offline labels of every recording.

    >>> push = np.linspace(0, 20, 400)[:, None] * np.ones(6)
    >>> encode_dataset(Recordings.from_arrays([push], 200.0)).primitive.label.shape[:2]
    (1, 6)

    Args:
        recordings: data set; a recording without start times is treated as one state.
        robot: preset of the thresholds.
        version: of the original programs, a key of ``VERSIONS``.
        clean: correct the quirks listed in :mod:`rcbht_jax.reference`.
        progress: wraps the loop over recordings.

    Returns:
        host arrays ``[recording, axis, slot]``, unused slots at the end.

    Raises:
        InputError: there are no recordings, the axes are not those of a wrench in its usual order, or a recording is
            too short or holds values that are not finite.
    """
    if not len(recordings):
        raise InputError("There is no recording; expected at least one.")
    if recordings.axes != AXES:  # the original programs tell forces from moments by their place
        raise InputError(
            f"The axes are {' '.join(recordings.axes)}; the offline program expects {' '.join(AXES)}, in this order."
        )
    rows = []
    known = RECORDED in recordings.annotations.tracks
    onsets = recordings.starts(RECORDED) if known else np.full((len(recordings), 1), np.nan)
    for index in progress(range(len(recordings))):
        length = int(recordings.length[index])
        onset = onsets[index]
        starts = onset[: int(np.argmax(np.isnan(onset)))] if np.isnan(onset).any() else onset
        labels = encode(
            sample_times(length, recordings.dt),
            as_written(recordings.wrench[index, :length]),
            starts if len(starts) else np.zeros(1),
            robot=robot,
            version=version,
            clean=clean,
        )
        rows.append(to_tracks(labels, recordings.dt))
    return jax.tree.map(_stacked, *rows)


def _stacked(*leaves: NDArray[np.generic]) -> NDArray[np.generic]:
    """Arrays ``[axis, slot]`` as ``[recording, axis, slot]``, with zeros in the slots that a recording lacks."""
    slots = max(leaf.shape[1] for leaf in leaves)
    return np.stack([np.pad(leaf, ((0, 0), (0, slots - leaf.shape[1]))) for leaf in leaves])
