"""Annotations and facts from files beside the recordings: intervals, lists of ends, a table of recordings."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path, PurePosixPath

import numpy as np

from rcbht_jax._util.untrusted import MAX_JSON_BYTES, read_bytes, read_json
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.mapping import Mapping, Track
from rcbht_jax.io.importing.record import text
from rcbht_jax.io.importing.table import Interval, Table
from rcbht_jax.io.importing.text import read_csv

MAX_ROWS = 1_000_000
_NAMES = ("recording", "file", "trial", "name")


def is_intervals(columns: Iterable[str]) -> bool:
    """Whether a table with these columns is one of annotations: label and start.

    >>> is_intervals(["label", "start", "end"])
    True
    """
    return {"label", "start"} <= {name.lower() for name in columns}


def intervals_of(table: Table, track: Track, name: str = "") -> list[Interval]:
    """The intervals of a table label, start and perhaps end, track; of one recording where it names them.

    >>> table = Table("a.csv", {"label": np.array(["push"]), "start": np.array([1.0])})
    >>> intervals_of(table, Track("phase", file="a.csv"))
    [('phase', 'push', 1.0, nan)]

    Raises:
        InputError: a time is text.
    """
    columns = {key.lower(): values for key, values in table.columns.items()}
    count = len(columns["label"])
    for key in ("start", "end"):
        if key in columns and columns[key].dtype.kind == "U":
            raise InputError(f"{table.name}: column {key} is text; expected seconds.")
    ends = columns.get("end", np.full(count, np.nan))
    tracks = columns.get("track", np.full(count, track.track))
    key = next((key for key in _NAMES if key in columns), "")
    found = []
    for row in range(count):
        if key and name and not same_recording(text(columns[key][row]), name):
            continue
        label = text(columns["label"][row])
        label = track.words.get(label, label)
        if label and label not in track.ignore:
            found.append((text(tracks[row]), label, float(columns["start"][row]), float(ends[row])))
    return found


def same_recording(given: str, name: str) -> bool:
    """Whether a table's word means a recording: its name, its file, or its file without folder or suffix.

    >>> same_recording("run1", "monday/run1.csv"), same_recording("run1", "run10.csv")
    (True, False)
    """
    path, _, part = name.partition("#")
    file = PurePosixPath(path)
    forms = {path, file.name, file.stem, str(file.with_suffix(""))} if file.name else set()
    return given in ({f"{form}#{part}" for form in forms} | {part} if part else forms)


def beside(source: Path, file: Path, pattern: str) -> Path:
    """The file that a pattern names for a recording: "{stem}" is its file without suffix, in the same folder.

    Args:
        source: a file or a folder.
        file: of the recording, relative to the folder.
        pattern: of the file beside it.

    Raises:
        InputError: the file lies outside the source.
    """
    folder = source if source.is_dir() else source.parent
    path = folder / file.parent / pattern.replace("{stem}", file.stem) if "{stem}" in pattern else folder / pattern
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{pattern} is outside the source; expected a file in it.")
    return path


def track_intervals(source: Path, file: Path, name: str, track: Track) -> list[Interval]:
    """The intervals of a track that a file beside a recording holds.

    Args:
        source: a file or a folder.
        file: of the recording, relative to the folder.
        name: of the recording.
        track: of its intervals.

    Raises:
        InputError: the file is missing or not a table of intervals.
    """
    if track.file:
        path = beside(source, file, track.file)
        [table] = read_csv(path, path.name)
        if not is_intervals(table.columns):
            raise InputError(f"{path} has columns {', '.join(table.columns)}; expected label, start and end.")
        return intervals_of(table, track, name)
    ends, ids = (_lines(beside(source, file, pattern)) for pattern in (track.ends, track.ids))
    if len(ends) != len(ids):
        raise InputError(f"{beside(source, file, track.ends)} has {len(ends)} ends for {len(ids)} labels.")
    try:
        times = [0.0, *map(float, ends)]
        labels = [text(float(one)) if not one.isalpha() else one for one in ids]
    except ValueError:
        raise InputError(f"{beside(source, file, track.ends)} holds a line that is not a number.") from None
    words = [track.words.get(label, label) for label in labels]
    rows = zip(words, times[:-1], times[1:], strict=True)
    return [(track.track, label, start, end) for label, start, end in rows if label not in track.ignore]


def _lines(path: Path) -> list[str]:
    content = read_bytes(path, MAX_JSON_BYTES)
    try:
        return content.decode().split()
    except ValueError:
        raise InputError(f"{path} is not text.") from None


def rows_of(source: Path, mapping: Mapping) -> dict[str, dict[str, str]]:
    """The table of recordings: file -> column -> text.

    Raises:
        InputError: the table is missing, not CSV or a JSON list of objects, or lacks the column of files.
    """
    if not mapping.table:
        return {}
    path = beside(source, Path(), mapping.table)
    if path.suffix.lower() == ".json":
        content = read_json(path)
        if not isinstance(content, list) or not all(isinstance(row, dict) for row in content):
            raise InputError(f"{path} is not a list of objects, one per recording.")
        rows = [{str(key): _word(value) for key, value in row.items()} for row in content]
    else:
        [table] = read_csv(path, path.name)
        columns = {key: [text(value) for value in values] for key, values in table.columns.items()}
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    if rows and mapping.key not in rows[0]:
        raise InputError(f"{path} has no column {mapping.key!r}; it has {', '.join(rows[0])}.")
    return {row[mapping.key]: row for row in rows if mapping.key in row}


def _word(value: object) -> str:
    if value is None:
        return ""
    return text(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def row_for(rows: dict[str, dict[str, str]], name: str) -> dict[str, str] | None:
    """The row of a recording's file; None = there is none."""
    file = name.partition("#")[0]
    return rows.get(file) or next((row for key, row in rows.items() if same_recording(key, file)), None)
