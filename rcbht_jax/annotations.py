"""Labelled intervals of recordings on named tracks, such as sub-tasks, skills or contacts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.columns import decoded, is_missing
from rcbht_jax._util.values import ByValue
from rcbht_jax.errors import InputError


def nearest_samples(times: Float[np.ndarray, "..."], most: int, dt: float) -> Float[np.ndarray, "..."]:
    """The samples nearest to times, s; -1 or ``most`` + 1 for those outside: a file may hold any number. NaN stays NaN.

    Example:
        >>> nearest_samples(np.array([-1e300, 0.0, 0.26, np.nan, 1e308]), 20, 0.1).tolist()
        [-1.0, 0.0, 3.0, nan, 21.0]
    """
    return np.rint(times.clip(-dt, (most + 1) * dt) / dt)


def _checked_row(row: Any) -> tuple[int, str, str, float, float]:
    """A row of annotations in its types; an end that is missing is unknown.

    Raises:
        InputError: it is no such row, or it ends before it begins.
    """
    try:
        recording, track, label, start, end = row
        if is_missing(track) or is_missing(label) or int(recording) != float(recording):
            raise ValueError
        names = str(decoded(track)), str(decoded(label))
        checked = int(recording), *names, float(start), np.nan if is_missing(end) else float(end)
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"An annotation is {str(row)[:80]}; expected recording, track, label, start in s and end in s."
        ) from None
    if checked[-1] < checked[-2] < np.inf:
        raise InputError(f"An annotation is {str(row)[:80]}; it ends before it begins.")
    return checked


@dataclass(frozen=True, eq=False)
class Annotations(ByValue):
    """A table of labelled intervals, sorted by recording, track and start. Host arrays.

    Several tracks may cover the same time, for example sub-tasks as logged and as corrected. The labels of a track have
    an order, which is that of reports.

    Example:
        >>> rows = [(0, "phase", "approach", 0.0, 1.5), (0, "phase", "contact", 1.5, 2.0)]
        >>> annotations = Annotations.from_rows(rows)
        >>> annotations.labels, annotations.starts("phase", recordings=1).tolist()
        ({'phase': ('approach', 'contact')}, [[0.0, 1.5]])
    """

    recording: Int[np.ndarray, " interval"] = field(default_factory=partial(np.zeros, 0, np.int32))
    track: Int[np.ndarray, " interval"] = field(default_factory=partial(np.zeros, 0, np.int16))  # index into labels
    code: Int[np.ndarray, " interval"] = field(default_factory=partial(np.zeros, 0, np.int32))  # in labels[track]
    start: Float[np.ndarray, " interval"] = field(default_factory=partial(np.zeros, 0, np.float64))  # s
    end: Float[np.ndarray, " interval"] = field(default_factory=partial(np.zeros, 0, np.float64))  # s; NaN = unknown
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # labels of each track, in their order

    def __len__(self) -> int:
        return len(self.recording)

    @property
    def tracks(self) -> tuple[str, ...]:
        """Names of the tracks."""
        return tuple(self.labels)

    @staticmethod
    def from_rows(rows: Iterable[Any], labels: Mapping[str, Sequence[str]] | None = None) -> Annotations:
        """Annotations from rows (recording, track, label, start in s, end in s; NaN = unknown end).

        Args:
            rows: in any order.
            labels: labels of tracks in the order that reports shall have; of others in order of appearance.

        Raises:
            InputError: something else than such rows, one that ends before it begins, or a track's given labels lack
                one of a row.
        """
        table = sorted(map(_checked_row, rows), key=lambda row: row[3])
        order: dict[str, dict[str, int]] = {
            track: {label: code for code, label in enumerate(names)} for track, names in (labels or {}).items()
        }
        given = set(order)
        for recording, track, label, *_ in table:
            known = order.setdefault(track, {})
            if label not in known and track in given:
                raise InputError(
                    f"Recording {recording}: track {track} has no label {label!r}; there are {', '.join(known)}."
                )
            known.setdefault(label, len(known))
        tracks = list(order)
        return Annotations(
            np.array([row[0] for row in table], np.int32),
            np.array([tracks.index(row[1]) for row in table], np.int16),
            np.array([order[row[1]][row[2]] for row in table], np.int32),
            np.array([row[3] for row in table], np.float64),
            np.array([row[4] for row in table], np.float64),
            {track: tuple(known) for track, known in order.items()},
        )._sorted()

    @staticmethod
    def from_table(table: Mapping[str, NDArray[Any]], labels: Mapping[str, Sequence[str]]) -> Annotations:
        """Annotations from columns recording, track, label, start, end ``[interval]`` and the labels of each track.

        Raises:
            InputError: a row has a track or label that ``labels`` lacks.
        """
        codes = {(track, name): (n, code) for n, track in enumerate(labels) for code, name in enumerate(labels[track])}
        try:
            pairs = [codes[row] for row in zip(table["track"].tolist(), table["label"].tolist(), strict=True)]
        except KeyError as error:
            raise InputError(f"the annotation {error.args[0]} is not among the labels of its track.") from None
        track, code = np.array(pairs, np.int32).reshape(-1, 2).T
        order = {name: tuple(map(str, names)) for name, names in labels.items()}
        start, end = table["start"], table["end"]
        return Annotations(table["recording"], track.astype(np.int16), code, start, end, order)._sorted()

    @staticmethod
    def from_starts(track: str, labels: Sequence[str], starts: ArrayLike, end: ArrayLike) -> Annotations:
        """A track of phases that follow each other: each lasts until the next begins, the last until the record ends.

        Where a mark is missing between two others, the end of the phase before it is unknown.

        Args:
            track: its name.
            labels: names of the phases, in order.
            starts: ``[recording, label]`` s; NaN = missing.
            end: ``[recording]`` s, end of the recordings.

        Example:
            >>> marks = Annotations.from_starts("phase", ("free", "touch", "push"), [[0.0, np.nan, 2.0]], [3.0])
            >>> marks.end.tolist()
            [nan, 3.0]
        """
        begin = np.asarray(starts, np.float64).reshape(-1, len(labels))
        following = np.concatenate([begin[:, 1:], np.full((len(begin), 1), np.nan)], 1)
        last = np.isnan(begin[:, ::-1]).cumprod(1)[:, ::-1].astype(bool)  # [recording, label] missing to the end
        last = np.concatenate([last[:, 1:], np.ones((len(begin), 1), bool)], 1)
        until = np.where(last, np.asarray(end, np.float64)[:, None], following)
        recording, code = np.nonzero(np.isfinite(begin))
        return Annotations(
            recording.astype(np.int32), np.zeros(len(code), np.int16), code.astype(np.int32),
            begin[recording, code], until[recording, code], {track: tuple(labels)},
        )._sorted()  # fmt: skip

    def choose(self, track: str = "") -> str:
        """The named track; without a name the first one, or its variant FIRST-harmonised; "" = there is none.

        Raises:
            InputError: there is no track of that name.
        """
        if track and track not in self.labels:
            raise InputError(f"There is no track {track!r}; there are {', '.join(self.labels) or 'no annotations'}.")
        first = track or next(iter(self.labels), "")
        variant = corrected_variant(first)
        return variant if not track and variant in self.labels else first

    def of(self, track: str) -> Annotations:
        """The intervals of one track.

        Raises:
            InputError: there is no such track.
        """
        rows = self.track == self.tracks.index(self.choose(track))
        return replace(self._rows(rows), track=np.zeros(rows.sum(), np.int16), labels={track: self.labels[track]})

    def names(self) -> NDArray[np.str_]:
        """Label of every interval ``[interval]``."""
        flat = [label for labels in self.labels.values() for label in labels]
        first = np.cumsum([0, *(len(labels) for labels in self.labels.values())])
        return np.array(flat, np.str_)[first[self.track] + self.code] if flat else np.zeros(0, np.str_)

    def starts(self, track: str, recordings: int) -> Float[np.ndarray, "recording label"]:
        """First start of each label of a track in each recording, s; NaN = the recording has no such label.

        Raises:
            InputError: there is no such track.
        """
        chosen = self.of(track)
        first = np.full((recordings, len(self.labels[track])), np.nan)
        # Reversed, so that the first of several intervals is written last.
        first[chosen.recording[::-1], chosen.code[::-1]] = chosen.start[::-1]
        return first

    def check(self, recordings: int) -> None:
        """Raise an error if these are not annotations of so many recordings.

        Raises:
            InputError: an interval of another recording, a start that is not finite, or an infinite end.
        """
        if len(self) and not (self.recording.min() >= 0 and self.recording.max() < recordings):
            raise InputError(
                f"annotations are about recordings {self.recording.min()} to {self.recording.max()}; there are "
                f"{recordings}, from 0."
            )
        if len(wrong := np.flatnonzero(~np.isfinite(self.start) | np.isinf(self.end))):
            raise InputError(
                f"annotation {wrong[0]}, from 0, lasts from {self.start[wrong[0]]} s to {self.end[wrong[0]]} s; "
                "expected a finite start, and an end that is not infinite."
            )

    def of_recording(self, recording: int) -> Annotations:
        """The intervals of one recording."""
        first, last = np.searchsorted(self.recording, [recording, recording + 1]).tolist()
        return self._rows(slice(first, last))

    def begins(self, recording: int, length: int, dt: float, track: str = "") -> dict[int, str]:
        """The samples of one recording at which intervals of a track begin, in order, each with the label that begins.

        Args:
            recording: its number.
            length: samples of the recording; intervals that begin outside it are left out.
            dt: s between samples.
            track: default see :meth:`choose`; a recording without tracks has no intervals.

        Example:
            >>> marks = Annotations.from_starts("phase", ["rest", "push", "pull"], [[0.0, 0.5, 1e300]], [2.0])
            >>> marks.begins(0, 20, 0.1)
            {0: 'rest', 5: 'push'}
        """
        name = self.choose(track)
        if not name:
            return {}
        marks = self.of_recording(recording).of(name)
        found = nearest_samples(marks.start, length, dt).tolist()
        labels = zip(found, marks.names().tolist(), strict=True)
        return {int(sample): label for sample, label in labels if 0 <= sample < length}

    def of_samples(self, recording: int, track: str, length: int, dt: float) -> Int[np.ndarray, " sample"]:
        """Code of the label of each sample of one recording; -1 where a track annotates nothing.

        An interval holds the samples from the one nearest to its start to the one before that nearest to its end, so
        one shorter than a sample may hold none; a sample of several intervals belongs to the one that begins last.

        Args:
            recording: its number.
            track: its name.
            length: samples of the recording.
            dt: s between samples.

        Example:
            >>> marks = Annotations.from_starts("phase", ["push", "rest"], [[0.1, 0.3]], [0.4])
            >>> marks.of_samples(0, "phase", 5, 0.1).tolist()
            [-1, 0, 0, 1, -1]
        """
        marks = self.of_recording(recording).of(track)
        codes = np.full(length, -1)
        edges = nearest_samples(np.stack([marks.start, marks.end], 1), length, dt)
        edges = np.nan_to_num(edges).clip(0, length)  # without a known end nothing
        for code, (first, last) in zip(marks.code.tolist(), edges.astype(int).tolist(), strict=True):
            codes[first:last] = code
        return codes

    def take(self, rows: NDArray[np.integer]) -> Annotations:
        """The annotations of some recordings ``[new recording]``, which may repeat, numbered anew."""
        first, last = np.searchsorted(self.recording, np.stack([rows, rows + 1]))
        counts = last - first
        chosen = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
        return replace(self._rows(chosen), recording=np.repeat(np.arange(len(rows), dtype=np.int32), counts))

    @staticmethod
    def join(parts: Sequence[Annotations], counts: Sequence[int] | None = None) -> Annotations:
        """Annotations of several data sets under each other, or several tracks of one data set.

        Args:
            parts: the tables.
            counts: recordings of each data set; None = all parts are about the same recordings.
        """
        labels: dict[str, dict[str, None]] = {}
        for part in parts:
            for track, names in part.labels.items():
                labels.setdefault(track, {}).update(dict.fromkeys(names))
        merged = {track: tuple(names) for track, names in labels.items()}
        first = np.zeros(len(parts), int) if counts is None else np.cumsum([0, *counts[:-1]])
        tracks, codes = [], []
        for part in parts:
            new = [[merged[track].index(name) for name in names] for track, names in part.labels.items()]
            width = max(map(len, new), default=0)
            table = np.array([row + [0] * (width - len(row)) for row in new], np.int32).reshape(len(new), width)
            tracks.append(np.array([list(merged).index(track) for track in part.labels], np.int16)[part.track])
            codes.append(table[part.track, part.code])
        return Annotations(
            np.concatenate([part.recording + np.int32(at) for part, at in zip(parts, first, strict=True)]),
            np.concatenate(tracks), np.concatenate(codes),
            np.concatenate([part.start for part in parts]), np.concatenate([part.end for part in parts]), merged,
        )._sorted()  # fmt: skip

    def _sorted(self) -> Annotations:
        return self._rows(np.lexsort((self.start, self.track, self.recording)))

    def _rows(self, rows: NDArray[Any] | slice) -> Annotations:
        columns = ("recording", "track", "code", "start", "end")
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})


def corrected_variant(track: str) -> str:
    """The name of the track that has a track's boundaries corrected, where there is one.

    >>> corrected_variant("states")
    'states-harmonised'
    """
    return f"{track}-harmonised"
