"""The data of an export: the recordings of a store with one set of label tracks, read block by block."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int8, Int16, UInt8
from numpy.typing import NDArray

from rcbht_jax._util.digest import data_hash, wrench_digests
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.rules import AnyLimits, config_of, limits_for, made_by
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.io import label_store
from rcbht_jax.io.label_parts import taken
from rcbht_jax.io.label_store import choose_name, list_tracks, read_tracks_attrs
from rcbht_jax.io.simulation import simulation_batches
from rcbht_jax.io.store import (
    SMALL_BYTES,
    longest_of,
    progress_of,
    read_attrs,
    read_batches,
    read_digests,
    read_rows,
    read_sample,
    read_table,
)
from rcbht_jax.io.store_reader import replaced
from rcbht_jax.io.store_schema import HASH
from rcbht_jax.labels import LAYERS
from rcbht_jax.learning.wrench_facts import WrenchFacts
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings


@dataclass(frozen=True)
class Block:
    """Some recordings in memory, with their labels."""

    recordings: Recordings
    tracks: LabelTracks | None  # [recording, axis, slot]; None = no labels
    first: int = 0  # number of the first recording in the data set, where they are consecutive


@dataclass(frozen=True)
class DataSet:
    """Recordings, their labels, and the provenance of both; of a store, blocks are read when they are asked for."""

    recordings: Recordings  # all; those of a store without their samples
    blocks: Callable[[], Iterator[Block]]  # all, in their order
    rows: Callable[[NDArray[np.int64]], Block]  # some, by ascending number
    digests: UInt8[np.ndarray, "recording byte"]  # of the samples of each recording
    samples: int  # of the longest recording, to which all are padded in the digest of the data
    tracks_name: str = ""  # "" = no labels
    tracks_attrs: dict[str, Any] = field(default_factory=dict)  # how the labels were made
    attrs: dict[str, Any] = field(default_factory=dict)  # of the store: provenance
    simulation: Callable[[], Iterator[dict[str, NDArray[Any]]]] = lambda: iter(())  # [recording, ...], in their order
    facts: Callable[[], WrenchFacts | None] = lambda: None  # of all wrenches, which this reads; None = too many

    @staticmethod
    def of(recordings: Recordings, tracks: LabelTracks | None = None, **more: Any) -> DataSet:
        """Recordings and labels that are in memory; ``more`` are fields.

        >>> [len(block.recordings) for block in DataSet.of(Recordings.example()).blocks()]
        [8]
        """

        def rows(numbers: NDArray[np.int64]) -> Block:
            return Block(recordings.take(numbers), None if tracks is None else taken(tracks, numbers))

        digests = wrench_digests(recordings.wrench, recordings.length)
        samples = recordings.wrench.shape[1]
        more = {"facts": lambda: WrenchFacts.of(recordings), **more}
        return DataSet(recordings, lambda: iter([Block(recordings, tracks)]), rows, digests, samples, **more)

    def data_hash(self) -> str:
        """The digest of the training data that models hold; reads all wrenches."""
        return data_hash(self.recordings, (block.recordings.wrench for block in self.blocks()), self.samples)


def load(
    store: Path,
    tracks: str = "",
    window: int | None = None,
    rule: str = "paper",
    tolerance: Sequence[float] = (),
    thresholds: AnyLimits | None = None,
) -> DataSet:
    """Open a store for export.

    Args:
        store: folder made by ``rcbht import`` or ``rcbht simulate``.
        tracks: name of the label tracks; "" = the only ones in the store, or none if it has none.
        window: encode now with the streaming encoder, this many samples per window, instead of reading stored labels.
        rule: of the labels that are made now, "paper" or "fit".
        tolerance: of the fit rule, one number or one for each axis; empty = from the recordings, of a large store from
            some spread evenly over it.
        thresholds: of the labels that are made now, ``[axis, 4]``; None = HIRO's.

    Raises:
        InputError: no such store or tracks, several tracks and none chosen, both ``tracks`` and ``window``, a rule or
            tolerance without ``window``, or a tolerance for the other rule.
    """
    if window is None and (rule != "paper" or tolerance):
        raise InputError("--rule and --tolerance need --window, which makes new labels; add it, or leave them out.")
    if window is not None and tracks:
        raise InputError("Labels are either read from the store or made anew; give --tracks or --window, not both.")
    labels, attrs = _Labels(), read_attrs(store)  # first: all that is read later must be of the same store
    if window is not None:
        labels = _made_now(store, window, rule, tolerance, thresholds)
    elif tracks or list_tracks(store):
        name = choose_name(store, tracks)
        labels = _Labels(name, read_tracks_attrs(store, name))

    def rows(numbers: NDArray[np.int64]) -> Block:
        some = read_rows(store, numbers)
        if labels.encode is not None:
            return Block(some, labels.encode(some))
        return Block(some, label_store.read_rows(store, labels.name, numbers) if labels.name else None)

    table, longest = read_table(store), longest_of(store)
    small = progress_of(store)[3] <= SMALL_BYTES  # as for "rcbht info"
    return DataSet(
        table, lambda: _blocks(store, labels, attrs), rows, read_digests(store), longest,
        labels.name, labels.attrs, attrs,
        lambda: simulation_batches(store),
        lambda: WrenchFacts.of(table, _batches(store, attrs), longest) if small else None,
    )  # fmt: skip


@dataclass(frozen=True)
class _Labels:
    """Label tracks of a store, or how they are made."""

    name: str = ""  # "" = none
    attrs: dict[str, Any] = field(default_factory=dict)
    encode: Callable[[Recordings], LabelTracks] | None = None  # None = they are in the store


def _made_now(store: Path, window: int, rule: str, tolerance: Sequence[float], thresholds: AnyLimits | None) -> _Labels:
    learns = rule == "fit" and not tolerance
    training = read_sample(store)[0] if learns else read_table(store)
    config = config_of(rule, window, training.dt)
    gradients = preset("hiro", training.axes, training.units) if thresholds is None else thresholds
    limits = limits_for(config, gradients, tolerance or None, training.wrench, training.length)

    def encode(recordings: Recordings) -> LabelTracks:
        return encode_batch(config, limits, recordings.wrench, recordings.length)

    attrs = {"semantics": "online", "window": window, **made_by(config, limits)}
    return _Labels(f"online-W{window}" + ("-fit" if rule == "fit" else ""), attrs, encode)


def _batches(store: Path, attrs: dict[str, Any]) -> Iterator[Recordings]:
    """All recordings of the store that had these attributes."""
    if read_attrs(store).get(HASH) != attrs.get(HASH):
        raise replaced(store)
    return read_batches(store)


def _blocks(store: Path, labels: _Labels, attrs: dict[str, Any]) -> Iterator[Block]:
    first, waiting = 0, deque[Recordings]()
    batches = _batches(store, attrs)

    def sizes() -> Iterator[int]:
        for batch in batches:
            waiting.append(batch)
            yield len(batch)

    tracks: Iterator[LabelTracks | None]
    if labels.encode is not None or not labels.name:
        tracks = (None if labels.encode is None else labels.encode(waiting[0]) for _ in sizes())
    else:
        tracks = label_store.read_batches(store, labels.name, sizes())
    for some in tracks:
        batch = waiting.popleft()
        yield Block(batch, some, first)
        first += len(batch)


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

    Of several intervals the one that begins last counts. One whose end is unknown lasts until the next begins.
    """
    length = int(recordings.length[row])
    track = recordings.annotations.choose()
    if not track:
        return np.full(length, -1, np.int16)
    marks = recordings.annotations.of_recording(row).of(track)
    ends = np.where(np.isnan(marks.end), np.append(marks.start[1:], np.inf), marks.end)
    return replace(marks, end=ends).of_samples(row, track, length, recordings.dt).astype(np.int16)
