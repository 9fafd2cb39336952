"""Trials as small blobs that a browser decodes: integers and rounded floats, delta-coded, deflated, base64.

Layout of a blob, little-endian, in this order: of each layer ``t0 t1 emit`` int32 ``[word]`` (``t0`` and ``t1`` as
differences), ``vmax vmin avg grad`` float32 ``[word]``; of each head of the model ``sample`` int32 ``[step]`` as
differences; ``wrench`` int16 ``[axis, time]`` as differences modulo 2^16; of each layer ``code`` uint8 ``[word]``; of
each head ``probability`` uint8 ``[step, class]`` in 1/255. Words are in order of axis, then time.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.events import Belief
from rcbht_jax.introspection.description import describe_recording
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.io.export.dataset import words
from rcbht_jax.io.playback import track_of_starts
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTracks, Recordings

LEVELS = 16_000  # steps between the smallest and the largest value of an axis: finer than the resolution of sensors
_FLOATS = ("vmax", "vmin", "avg", "grad")


@dataclass(frozen=True)
class Beliefs:
    """Class probabilities of one head of a model over a trial."""

    head: str
    classes: tuple[str, ...]
    sample: NDArray[np.int32]  # [step] samples received
    probability: NDArray[np.float32]  # [step, class]


def infer_beliefs(introspector: Introspector, recordings: Recordings, row: int) -> list[Beliefs]:
    """Stream one recording through a model.

    The model is given the starts of the annotated intervals of its task, as a controller would announce its sub-tasks.
    """
    introspector.reset()
    samples = int(recordings.length[row])
    track = track_of_starts(recordings.annotations, learnt=introspector.model.subtasks)
    inner = [start for start in recordings.annotations.begins(row, samples, recordings.dt, track) if start]
    events: dict[str, list[Belief]] = {head.name: [] for head in introspector.model.heads}
    for start, stop in zip([0, *inner], [*inner, samples], strict=True):
        if start:
            introspector.begin()
        for event in introspector.push(recordings.wrench[row, start:stop]):
            if isinstance(event, Belief):
                events[event.head].append(event)
    return [
        Beliefs(
            head.name,
            head.classes,
            np.array([event.sample for event in events[head.name]], np.int32),
            np.array([event.probabilities for event in events[head.name]], np.float32).reshape(-1, len(head.classes)),
        )
        for head in introspector.model.heads
    ]


def pack(
    recordings: Recordings, tracks: LabelTracks | None, row: int, beliefs: list[Beliefs]
) -> tuple[dict[str, Any], str]:
    """One recording for the page.

    Returns:
        its metadata (JSON values), with which the page decodes the blob, and the blob (base64).
    """
    from rcbht_jax.plots.trial import outcome_of, state_marks  # matplotlib, which a live page does without

    samples, axes = int(recordings.length[row]), len(recordings.axes)
    codes, lowest, step = quantised(recordings.wrench[row, :samples].T)
    wide: list[NDArray[Any]] = []
    narrow: list[NDArray[Any]] = []
    counts = []
    for layer in LAYERS:
        lanes = [] if tracks is None else [words(getattr(tracks, layer), row, axis) for axis in range(axes)]
        counts.append([len(lane["label"]) for lane in lanes] or [0] * axes)
        if not lanes:
            continue
        joined = {field: np.concatenate([lane[field] for lane in lanes]) for field in lanes[0]}
        wide += [_differences(joined["t0"]), _differences(joined["t1"]), joined["emit"].astype("<i4")]
        wide += [rounded(joined[field]) for field in _FLOATS]
        narrow.append(joined["label"].astype(np.uint8))
    wide += [_differences(belief.sample) for belief in beliefs]
    narrow += [np.rint(belief.probability * 255).astype(np.uint8).ravel() for belief in beliefs]
    wrench = np.diff(codes.astype(np.uint16), axis=1, prepend=np.uint16(0)).astype("<u2")
    raw = b"".join(part.tobytes() for part in [*wide, wrench, *narrow])
    about = {
        **{field: str(getattr(recordings, field)[row]) for field in ("trial", "arm", "source", "session", "outcome")},
        "facts": outcome_of(recordings, row),
        "samples": samples,
        "low": lowest.tolist(),
        "step": step.tolist(),
        "words": counts,
        "marks": [[mark.seconds, mark.text, mark.dashed] for mark in state_marks(recordings, row)],
        "description": describe_recording(recordings, row),
        "beliefs": [{"head": b.head, "classes": b.classes, "steps": len(b.sample)} for b in beliefs],
    }
    return about, base64.b64encode(zlib.compress(raw)).decode("ascii")


def quantised(signal: NDArray[np.floating]) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Whole steps ``[axis, time]`` with ``signal = low + step x steps`` within half a step; low and step ``[axis]``."""
    exact = signal.astype(np.float64)
    low = exact.min(1)
    wide = exact.max(1) - low
    step = np.where(wide > 0.0, wide, 1e-9) / LEVELS
    return np.rint((exact - low[:, None]) / step[:, None]).astype(np.int64), low, step


def rounded(values: NDArray[np.floating]) -> NDArray[np.float32]:
    """Floats with 12 bits of mantissa, right to about four digits, which deflate well."""
    bits = (values.astype("<f4").view(np.uint32) + np.uint32(0x400)) & np.uint32(0xFFFFF800)
    return bits.view(np.float32)


def _differences(values: NDArray[Any]) -> NDArray[np.int32]:
    return np.diff(values.astype(np.int64), prepend=0).astype("<i4")
