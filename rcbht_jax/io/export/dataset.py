"""What is exported: the recordings of a store with one set of label tracks, read once."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import choose_tracks, list_tracks
from rcbht_jax.io.store import SIMULATION, open_store, read_attrs, read_recordings, read_simulation
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings


@dataclass(frozen=True)
class DataSet:
    """Recordings, their labels, and where both come from."""

    recordings: Recordings
    tracks: LabelTracks | None  # None = no labels
    tracks_name: str  # "" = no labels
    tracks_attrs: dict[str, Any]  # how the labels were made
    attrs: dict[str, Any]  # of the store: provenance
    simulation: dict[str, NDArray[Any]]  # [recording, ...]; empty = not simulated


def load(store: Path, tracks: str = "", window: int | None = None) -> DataSet:
    """Read a store for export.

    Args:
        store: folder made by ``rcbht import`` or ``rcbht simulate``.
        tracks: which label tracks; "" = the only ones there are, or none.
        window: label now with the streaming encoder, windows of so many samples, HIRO's thresholds; then ``tracks``
            must be "".

    Raises:
        InputError: no such store or tracks, several and none chosen, or both ``tracks`` and ``window``.
    """
    if window is not None and tracks:
        raise InputError("Labels are either taken from the store or made now; give --tracks or --window, not both.")
    recordings = read_recordings(store)
    name, found, how = "", None, dict[str, Any]()
    if window is not None:
        name, (found, how) = f"online-W{window}", _encode(recordings, window)
    elif tracks or list_tracks(store):
        name, found, how = choose_tracks(store, tracks)
    simulation = read_simulation(store) if SIMULATION in open_store(store) else {}
    return DataSet(recordings, found, name, how, read_attrs(store), simulation)


def _encode(recordings: Recordings, window: int) -> tuple[LabelTracks, dict[str, Any]]:
    config, limits = EncoderConfig(window, recordings.dt), preset("hiro")
    tracks = encode_batch(config, limits, recordings.wrench, recordings.length)
    how = {"semantics": "online", "window": window, "config": asdict(config), "thresholds": limits.limits.tolist()}
    return tracks, how


def words(track: LabelTrack, row: int, axis: int) -> dict[str, NDArray[Any]]:
    """The labels of one recording and axis in order of publication, without empty slots: field -> ``[word]``."""
    used = np.asarray(track.label)[row, axis] > 0
    return {field: np.asarray(values)[row, axis][used] for field, values in vars(track).items()}


def codes_at_samples(tracks: LabelTracks, row: int, samples: int) -> NDArray[np.int8]:
    """What a label was at each sample: int8 ``[sample, layer, axis]``, 0 = none.

    Online labels appear when they are published (what a robot could know after that sample); labels of an offline
    encoder, which have no such moment, over the span that they describe.
    """
    codes = np.zeros((samples, len(LAYERS), 6), np.int8)
    for number, layer in enumerate(LAYERS):
        for axis in range(6):
            word = words(getattr(tracks, layer), row, axis)
            codes[:, number, axis] = _at_samples(word, samples)
    return codes


def _at_samples(word: dict[str, NDArray[Any]], samples: int) -> NDArray[np.int8]:
    if not len(word["label"]):
        return np.zeros(samples, np.int8)
    online = bool((word["emit"] >= 0).all())
    received = np.arange(1, samples + 1)
    # Sample i is the (i+1)-th: a label with emit = i+1 is known with it, a span from t0 = i covers it.
    latest = np.searchsorted(word["emit"] if online else word["t0"] + 1, received, side="right") - 1
    known = latest >= 0
    if not online:
        known &= received <= word["t1"][latest]
    return np.where(known, word["label"][latest], 0).astype(np.int8)


def states_at_samples(recordings: Recordings, row: int) -> NDArray[np.int8]:
    """State of the assembly at each sample, harmonised boundaries: int8 ``[sample]``, -1 = before the first known."""
    samples = np.arange(recordings.length[row])
    state = np.full(len(samples), -1, np.int8)
    for number, onset in enumerate(recordings.onset_harmonised[row]):
        if np.isfinite(onset):
            state[samples >= np.rint(onset / recordings.dt)] = number
    return state
