"""What is exported: the recordings of a store with one set of label tracks, read once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int8, Int16
from numpy.typing import NDArray

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.rules import config_of, limits_for, made_by
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import choose_tracks, list_tracks
from rcbht_jax.io.store import SIMULATION, open_store, read_attrs, read_recordings, read_simulation
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings


@dataclass(frozen=True)
class DataSet:
    """Recordings, their labels, and the provenance of both."""

    recordings: Recordings
    tracks: LabelTracks | None  # [recording, axis, slot]; None = no labels
    tracks_name: str  # "" = no labels
    tracks_attrs: dict[str, Any]  # how the labels were made
    attrs: dict[str, Any]  # of the store: provenance
    simulation: dict[str, NDArray[Any]]  # [recording, ...]; empty = not simulated


def load(
    store: Path, tracks: str = "", window: int | None = None, rule: str = "paper", tolerance: Sequence[float] = ()
) -> DataSet:
    """Read a store for export.

    Args:
        store: folder made by ``rcbht import`` or ``rcbht simulate``.
        tracks: name of the label tracks; "" = the only ones in the store, or none if it has none.
        window: encode now with the streaming encoder, this many samples per window and HIRO's thresholds, instead
            of reading stored labels.
        rule: of the labels that are made now, "paper" or "fit".
        tolerance: of the fit rule, one number or one for each axis; empty = from the recordings.

    Raises:
        InputError: no such store or tracks, several tracks and none chosen, both ``tracks`` and ``window``, a rule or
            tolerance without ``window``, or a tolerance for the other rule.
    """
    if window is None and (rule != "paper" or tolerance):
        raise InputError("--rule and --tolerance are for labels that are made now; add --window, or leave them out.")
    if window is not None and tracks:
        raise InputError("Labels are either read from the store or made now; give --tracks or --window, not both.")
    recordings = read_recordings(store)
    name, labels, attrs = "", None, dict[str, Any]()
    if window is not None:
        name = f"online-W{window}" + ("-fit" if rule == "fit" else "")
        labels, attrs = _encode(recordings, window, rule, tolerance)
    elif tracks or list_tracks(store):
        name, labels, attrs = choose_tracks(store, tracks)
    simulation = read_simulation(store) if SIMULATION in open_store(store) else {}
    return DataSet(recordings, labels, name, attrs, read_attrs(store), simulation)


def _encode(
    recordings: Recordings, window: int, rule: str, tolerance: Sequence[float]
) -> tuple[LabelTracks, dict[str, Any]]:
    config = config_of(rule, window, recordings.dt)
    thresholds = preset("hiro", recordings.axes)
    limits = limits_for(config, thresholds, tolerance or None, recordings.wrench, recordings.length)
    tracks = encode_batch(config, limits, recordings.wrench, recordings.length)
    return tracks, {"semantics": "online", "window": window, **made_by(config, limits)}


def words(track: LabelTrack, row: int, axis: int) -> dict[str, NDArray[Any]]:
    """The labels of one recording and axis in order of publication, without empty slots: field -> ``[word]``."""
    used = np.asarray(track.label)[row, axis] > 0
    return {field: np.asarray(values)[row, axis][used] for field, values in vars(track).items()}


def codes_at_samples(tracks: LabelTracks, row: int, samples: int) -> Int8[np.ndarray, "sample layer axis"]:
    """The label in force at each sample of a recording, 0 = none.

    Online labels hold from their publication on (what a robot could know after that sample); labels of an offline
    encoder, which have no moment of publication, over the span that they describe.
    """
    axes = np.shape(tracks.llb.label)[1]
    codes = np.zeros((samples, len(LAYERS), axes), np.int8)
    for number, layer in enumerate(LAYERS):
        for axis in range(axes):
            codes[:, number, axis] = _at_samples(words(getattr(tracks, layer), row, axis), samples)
    return codes


def _at_samples(word: dict[str, NDArray[Any]], samples: int) -> Int8[np.ndarray, " sample"]:
    if not len(word["label"]):
        return np.zeros(samples, np.int8)
    online = bool((word["emit"] >= 0).all())
    received = np.arange(1, samples + 1)
    # Sample i is the (i+1)-th: a label with emit = i+1 is known with it, a span from t0 = i covers it.
    latest = np.searchsorted(word["emit"] if online else word["t0"] + 1, received, side="right") - 1
    valid = latest >= 0
    if not online:
        valid &= received <= word["t1"][latest]
    return np.where(valid, word["label"][latest], 0).astype(np.int8)


def states_at_samples(recordings: Recordings, row: int) -> Int16[np.ndarray, " sample"]:
    """Code of the annotated label at each sample (:meth:`rcbht_jax.annotations.Annotations.choose`); -1 = none.

    An interval whose end is unknown lasts until the next one begins.
    """
    samples = np.arange(recordings.length[row])
    state = np.full(len(samples), -1, np.int16)
    track = recordings.annotations.choose()
    if not track:
        return state
    marks = recordings.annotations.of_recording(row).of(track)
    for code, start, end in zip(marks.code, marks.start, marks.end, strict=True):
        state[samples >= np.rint(start / recordings.dt)] = code
        if np.isfinite(end):
            state[samples >= np.rint(end / recordings.dt)] = -1
    return state
