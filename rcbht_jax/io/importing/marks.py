"""Annotations from files beside the recordings: intervals, lists of ends and starts."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import SECONDS, base_and_unit
from rcbht_jax._util.printable import plural, spelled
from rcbht_jax._util.untrusted import MAX_JSON_BYTES, read_bytes
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.clock import since_epoch
from rcbht_jax.io.importing.find import Item
from rcbht_jax.io.importing.guess import some
from rcbht_jax.io.importing.mapping import Mapping, Track
from rcbht_jax.io.importing.names import LABELS, wrenches
from rcbht_jax.io.importing.record import without_arm
from rcbht_jax.io.importing.table import Interval, Table
from rcbht_jax.io.importing.text import read_csv
from rcbht_jax.io.importing.timing import unit_by_size
from rcbht_jax.io.importing.unpacked import doubts, plain_name
from rcbht_jax.io.importing.words import of_numbers, plain_number, text

Marks = dict[int, list[Interval]]  # of one file, by recording; ANY = of any
ANY = -1
_NAMES = ("recording", "file", "file_name", "filename", "trial", "name")
_LABELS = ("label", "text", "description", *LABELS)
_STARTS = (
    "start", "start_time", "begin", "begin_time", "onset", "t_start", "time_start", "starttime", "tmin", "from",
    "anfang",
)  # fmt: skip
_ENDS = (
    "end", "end_time", "stop", "stop_time", "offset", "t_end", "time_end", "endtime", "tmax", "to", "finish",
    "finish_time", "ende",
)  # fmt: skip
_TIMES = ("time", "t", "timestamp", "stamp")  # of events
_OF_ELAN = {"ss.msec": " [s]", "hh:mm:ss.ms": " [s]", "msec": " [ms]"}  # units of times, as that program names them
_ELAN = re.compile(rf"\s+-\s+({'|'.join(map(re.escape, _OF_ELAN))})$")
SAMPLES = "samples"  # note of a table of annotations that counts them
_COUNTS = "(?:samples?|frames?|index|idx|rows?)"
_COUNTED = re.compile(rf"(?<![ _])[ _]*[\[(]?{_COUNTS}[\])]?$|^{_COUNTS}[ _]+")
_DURATIONS = ("duration", "dur", "length")
_FILES = (
    "_labels", ".labels", "-labels", "_annotations", ".annotations", "-annotations", "_label", ".label", "_events",
)  # fmt: skip


def is_intervals(columns: Collection[str]) -> bool:
    """Whether a table with these columns is one of annotations: label and start, like names and an end, or events only.

    >>> is_intervals(["label", "start"]), is_intervals(["Action", "Start time [s]", "duration [s]"])
    (True, True)
    >>> is_intervals(["file", "event", "time"]), is_intervals(["t", "event", "Fz"])
    (True, False)
    >>> is_intervals(["t", "event", "length", "Fz"]), is_intervals(["file", "trial_type", "start", "end"])
    (False, False)
    """
    fields = _fields(columns)
    if not {"label", "start"} <= set(fields):
        return False
    plain, spans = {name.lower() for name in columns}, _fields(columns, ())
    whole = "start" in spans and not {"end", "duration"}.isdisjoint(spans)
    events = "event" in plain and len(fields) == len(columns)
    return {"label", "start"} <= plain or events or (whole and not wrenches(columns))


def _fields(columns: Iterable[str], times: tuple[str, ...] = _TIMES) -> dict[str, tuple[str, float]]:
    """Label, start, end, duration, track and recording of annotations -> its column, and s per unit of a time.

    An event begins at one of the times.
    """
    pairs = ((name, *base_and_unit(_ELAN.sub(lambda unit: _OF_ELAN[unit[1]], name))) for name in columns)
    parsed = {base.replace(" ", "_"): (name, SECONDS.get(unit, 0.0)) for name, base, unit in pairs}
    kinds = {
        "label": (*_LABELS, "trial_type") if "onset" in parsed else _LABELS,
        "start": (*_STARTS, *times) if "event" in parsed else _STARTS, "end": _ENDS,
        "duration": _DURATIONS, "track": ("track", "tier"), "recording": _NAMES,
    }  # fmt: skip
    found = {kind: next((parsed[word] for word in words if word in parsed), None) for kind, words in kinds.items()}
    return {kind: place for kind, place in found.items() if place is not None}


def with_words(table: Table, path: Path) -> Table:
    """A table of annotations from a text file, whose names and labels are as they stand there: 007, not 7."""
    kinds = (place for kind, place in _fields(table.columns).items() if kind in ("label", "track", "recording"))
    names = [name for name, _ in kinds if table.columns[name].dtype.kind == "f"]
    if not names:
        return table
    [read] = read_csv(path, table.name, words=True)
    same = {name: read.columns[name] for name in names if len(read.columns.get(name, ())) == len(table.columns[name])}
    return replace(table, columns={**table.columns, **same})


def unused(table: Table) -> list[str]:
    """A remark on columns of a table of annotations that say something and are not understood; [] = all are.

    >>> columns = {"label": np.array(["a", "b"]), "start": np.array([0.0, 1.0]), "quality": np.array([1.0, 2.0])}
    >>> unused(Table("a.csv", columns))
    ["a.csv is a table of annotations; left out of it: 'quality'."]
    """
    used = {name for name, _ in _fields(table.columns).values()}
    names = [name for name, column in table.columns.items() if name not in used and len(np.unique(column)) > 1]
    return [f"{table.name} is a table of annotations; left out of it: {some(names)}."] if names else []


def named_after(name: str) -> str:
    """The recording that a file of annotations is called after, without suffix; "" = none.

    >>> named_after("day1/run1_labels.csv"), named_after("run1.csv")
    ('day1/run1', '')
    """
    stem = PurePosixPath(name).with_suffix("").as_posix()
    return next((stem.removesuffix(ending) for ending in _FILES if stem.endswith(ending)), "")


def headed(table: Table) -> Table:
    """The table with names for its columns if it is a list of a start, an end and a label, as Audacity writes it.

    >>> columns = {"c0": np.array([0.0]), "c1": np.array([1.5]), "c2": np.array(["push"])}
    >>> list(headed(Table("run1_labels.csv", columns)).columns)
    ['start', 'end', 'label']
    """
    columns = list(table.columns.values())
    if not named_after(table.name) or list(table.columns) != ["c0", "c1", "c2"]:
        return table
    if [column.dtype.kind for column in columns] != ["f", "f", "U"]:
        return table
    if 2 * (columns[0] <= columns[1]).sum() < len(columns[0]) or len(np.unique(columns[2])) == 1 < len(columns[2]):
        return table
    return replace(table, columns=dict(zip(("start", "end", "label"), columns, strict=True)))


def counted(table: Table) -> Table:
    """The table with plain names for its starts and ends if all count samples, and the note "samples" then.

    >>> columns = {name: np.array([0.0]) for name in ("label", "start_sample", "end [samples]")}
    >>> found = counted(Table("run1_labels.csv", columns))
    >>> list(found.columns), found.notes
    (['label', 'start', 'end'], ('samples',))

    Raises:
        InputError: they count frames, which may be those of a video.
    """
    words = {name: _COUNTED.sub("", name.lower()) for name in table.columns}
    times = (*_STARTS, *_ENDS, *_DURATIONS)
    plain = {name: word for name, word in words.items() if word != name.lower() and word in times}
    columns = {plain.get(name, name): column for name, column in table.columns.items()}
    if not plain or wrenches(columns) or len(columns) < len(table.columns) or not is_intervals(columns):
        return table
    fields = _fields(columns)
    used = {fields[kind][0] for kind in ("start", "end" if "end" in fields else "duration") if kind in fields}
    numbers = all(columns[name].dtype.kind == "f" for name in used)
    if is_intervals(table.columns) or not numbers or not used <= set(plain.values()):  # some are in seconds
        return table
    if frames := next((name for name in plain if "frame" in name.lower()), ""):
        how = "write seconds, or name it start_sample if these are rows of the recording"
        raise InputError(f"{table.name}: {frames} counts frames, perhaps of a video; {how}.")
    return replace(table, columns=columns, notes=(*table.notes, SAMPLES))


def at_samples(intervals: Sequence[Interval], time: NDArray[np.float64], period: float) -> list[Interval]:
    """Intervals whose starts and ends count samples from 0, in s, by the times ``[sample]`` of a recording.

    >>> at_samples([("phase", "push", 1.0, 3.0)], np.array([0.0, 0.5, 2.0]), 0.5)
    [('phase', 'push', 0.5, 2.5)]
    """
    counts = np.array([one[2:] for one in intervals], np.float64)
    inside, known = np.clip(counts, 0, len(time)), np.append(time, time[-1] + period)
    seconds = np.interp(inside, np.arange(len(known)), known) + (counts - inside) * period
    return [(track, label, *both) for (track, label, *_), both in zip(intervals, seconds.tolist(), strict=True)]


def intervals_of(table: Table, track: Track) -> list[tuple[str, Interval]]:
    """The intervals of a table label, start and perhaps end, track, each with the name of its recording; "" = none.

    >>> table = Table("a.csv", {"label": np.array(["push"]), "start_ms": np.array([1000.0])})
    >>> intervals_of(table, Track("phase", file="a.csv"))
    [('', ('phase', 'push', 1.0, nan))]

    Raises:
        InputError: a text that is no time.
    """
    fields = _fields(table.columns)
    columns = {kind: table.columns[name] for kind, (name, _) in fields.items()}
    count = len(columns["label"])
    track = track if columns["label"].dtype.kind == "U" else of_numbers(track)
    unit = 1.0  # s, of the start
    for key in (key for key in ("start", "end", "duration") if key in columns):
        name, seconds = fields[key]
        if columns[key].dtype.kind == "U":
            try:
                columns[key] = since_epoch(columns[key].tolist())
            except ValueError:
                raise InputError(f"{table.name}: column {name} is text; expected seconds or times.") from None
        else:
            # a duration is too small to show its unit
            seconds = seconds or (unit if key == "duration" else SECONDS[unit_by_size(columns[key])])
            columns[key] = columns[key] * seconds
            unit = seconds if key == "start" else unit
    ends = columns.get("end", columns["start"] + columns.get("duration", np.nan))
    tracks = columns.get("track", np.full(count, track.track))
    names = columns.get("recording", np.full(count, ""))
    found = []
    for row in range(count):
        label = text(columns["label"][row])
        label = track.words.get(label, label)
        if label and label not in track.ignore:
            interval = text(tracks[row]), label, float(columns["start"][row]), float(ends[row])
            found.append((text(names[row]), interval))
    return found


def ambiguous(word: str) -> str:
    """A warning about a word that means several recordings."""
    return f"{word!r} is the name of several recordings and is used for none; write it with its folder."


class Names:
    """Which recordings a word in a table means: by path if one has it, else by file, by file without suffix, by part.

    >>> names = Names([("run1.csv", ""), ("monday/run1.csv", ""), ("monday/run2.csv", "")])
    >>> names.meant("run1"), names.meant("run2.csv"), names.meant("run3")
    ({0}, {2}, set())
    >>> arms = Names([("run1.csv", "left"), ("run1.csv", "right")], ["left", "right"])
    >>> arms.meant("run1"), arms.of_one_trial(arms.meant("run1"))
    ({0, 1}, True)
    """

    def __init__(self, recordings: Iterable[tuple[str, str]], arms: Sequence[str] = ()) -> None:
        """Take the file and the part of each recording, "" = the whole file, and the arm of each; none = all of one."""
        self._ranks: tuple[dict[str, set[int]], ...] = ({}, {}, {})
        self._trials: list[tuple[str, str]] = []
        for place, (name, part) in enumerate(recordings):
            shared = without_arm(part, arms[place]) if arms else part
            self._trials.append((name, shared))
            file = PurePosixPath(name)
            for one in dict.fromkeys((part, shared)):
                tail = f"#{one}" if one else ""
                bare = {f"{file.name}{tail}", f"{file.stem}{tail}", one} - {""}
                words = ({name + tail}, {f"{file.with_suffix('')}{tail}"}, bare)
                for rank, those in zip(self._ranks, words, strict=True):
                    for word in those:
                        rank.setdefault(word, set()).add(place)

    def meant(self, word: str) -> set[int]:
        """Indices of the recordings that the word means; more than one if it is ambiguous, or names all arms."""
        forms = (spelled(word), plain_name(spelled(word)), plain_number(word))
        return set(next((rank[form] for form in forms for rank in self._ranks if form in rank), ()))

    def of_one_trial(self, places: Iterable[int]) -> bool:
        """Whether recordings are the arms of one trial: a word that means them is not ambiguous."""
        return len({self._trials[place] for place in places}) == 1


def beside(source: Path, file: Path, pattern: str) -> Path:
    """The file that a pattern names for a recording's file, which is relative to the folder of the source.

    Raises:
        InputError: the file lies outside the source.
    """
    folder = source if source.is_dir() else source.parent
    path = folder / _named(PurePosixPath(file.as_posix()), pattern)
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{pattern} is outside the source; expected a file in it.")
    return path


def _named(file: PurePosixPath, pattern: str) -> PurePosixPath:
    """The file that a pattern names for a recording's file, both relative to the source."""
    filled = pattern.replace("{stem}", file.stem).replace("{folder}", str(file.parent))
    return file.parent / filled if "{stem}" in pattern and "{folder}" not in pattern else PurePosixPath(filled)


def described_by(mapping: Mapping, items: Iterable[Item]) -> set[str]:
    """Names of the files that describe recordings by a mapping: its table, and those of its annotations.

    >>> described_by(Mapping(annotations=(Track("phase", ends="{stem}.ends", ids="{stem}.ids"),)),
    ...              [Item("day1/a.npz", Path("runs/day1/a.npz"), "npz")]) == {"day1/a.ends", "day1/a.ids"}
    True
    """
    patterns = {one for track in mapping.annotations for one in (track.file, track.ends, track.ids, track.starts)}
    paths = [PurePosixPath(item.name) for item in items if item.name]
    named = {str(_named(path, one)) for one in patterns - {""} for path in paths}
    return named | ({mapping.table} - {""})


def track_intervals(
    source: Path,
    file: Path,
    track: Track,
    names: Names,
    place: int,
    warnings: list[tuple[str, str]],
    read: dict[Path, Marks],
) -> list[Interval]:
    """The intervals of a track that a file beside a recording holds; ``place`` is that of the recording in ``names``.

    Words that mean several recordings go to ``warnings``, and what files hold to ``read``, for the next recording.

    Raises:
        InputError: the file is missing or not a table of intervals.
    """
    if track.file:
        path = beside(source, file, track.file)
        if path not in read:  # a file of all recordings is read once
            read[path] = _marks_in(path, track, names, warnings)
        return list(read[path].get(place, read[path].get(ANY, ())))
    if track.starts:
        return _successive(beside(source, file, track.starts), track)
    path = beside(source, file, track.ends)
    ends, ids = _lines(path), _lines(beside(source, file, track.ids))
    if len(ends) != len(ids):
        raise InputError(f"{path} has {plural(len(ends), 'end')} for {plural(len(ids), 'label')}.")
    try:
        times = [0.0, *map(float, ends)]
        labels = [text(float(one)) if not one.isalpha() else one for one in ids]
        track = of_numbers(track)
    except ValueError:
        raise InputError(f"{path} holds a line that is not a number.") from None
    words = [track.words.get(label, label) for label in labels]
    spans = zip(words, times[:-1], times[1:], strict=True)
    return [(track.track, label, start, end) for label, start, end in spans if label not in track.ignore]


def _marks_in(path: Path, track: Track, names: Names, warnings: list[tuple[str, str]]) -> Marks:
    """The intervals of a table by recording."""
    [table] = read_csv(path, path.name)
    warnings += doubts(path.name, table.notes)
    if not is_intervals(table.columns):
        raise InputError(f"{path} has columns {', '.join(table.columns)}; expected label, start and end.")
    rows = intervals_of(with_words(table, path), track)
    if not any(word for word, _ in rows):
        return {ANY: [interval for _, interval in rows]}
    found, twofold, _ = by_recording(rows, names)
    ambiguities = [(path.name, ambiguous(word)) for word in twofold]
    warnings += [row for row in ambiguities if row not in warnings]  # of another track, or another call
    return found


def by_recording(
    rows: Sequence[tuple[str, Interval]], names: Names, own: str = ""
) -> tuple[Marks, list[str], list[str]]:
    """The intervals of each recording, the words that mean several recordings, and those that mean none.

    Rows without the name of a recording are of ``own``; "" = of none.
    """
    meant = {word: names.meant(word or own) for word, _ in rows}
    found: Marks = {}
    for word, interval in rows:
        for place in meant[word] if names.of_one_trial(meant[word]) else ():
            found.setdefault(place, []).append(interval)
    twofold = [word or own for word, places in meant.items() if places and not names.of_one_trial(places)]
    return found, twofold, [word for word, places in meant.items() if not places]


def _successive(path: Path, track: Track) -> list[Interval]:
    """Intervals of the labels of a track from a file of their starts; fewer starts are of the first labels, the last of
    which lasts until the end of the recording."""
    starts = _lines(path)
    if not 1 <= len(starts) <= len(track.labels) + 1:
        raise InputError(f"{path} has {plural(len(starts), 'start')} for {plural(len(track.labels), 'label')}.")
    try:
        times = list(map(float, starts))
    except ValueError:
        raise InputError(f"{path} holds a word that is not a number.") from None
    spans = zip(track.labels, times, [*times[1:], np.inf], strict=False)
    return [(track.track, track.words.get(label, label), start, end) for label, start, end in spans]


def _lines(path: Path) -> list[str]:
    content = read_bytes(path, MAX_JSON_BYTES)
    try:
        return content.decode().split()
    except ValueError:
        raise InputError(f"{path} is not text.") from None
