"""The table of results of a report, read from JSON files of rows; docs/howto/share.md describes the format."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from rcbht_jax._util.untrusted import checked_fields, load_json
from rcbht_jax.errors import InputError

SCHEMA = "rcbht-results-rows-1"
PARTS = {"notes": dict, "rows": list, "sources": list}  # of a file
T = TypeVar("T")


@dataclass(frozen=True)
class Peer:
    """The best of the other methods on the same folds; the best of several is slightly optimistic."""

    name: str
    mean: float
    interval: tuple[float, float]  # 95 %


@dataclass(frozen=True)
class Row:
    """One score, with everything that must be shown with it."""

    group: str
    what: str
    paper: str  # as printed; "" = the paper has none
    ours: float
    interval: tuple[float, float] | None  # 95 %
    peer: Peer | None  # None = not measured
    duration: float | None  # score of a classifier that sees only the duration, on the same folds
    flags: tuple[str, ...]  # keys of Results.notes
    source: str  # file that holds the numbers


@dataclass(frozen=True)
class Source:
    """A file with results, and how it was made."""

    file: str
    command: str
    date: str
    machine: str


@dataclass(frozen=True)
class Results:
    """Rows, footnotes by flag, and the files behind the numbers."""

    rows: tuple[Row, ...]
    notes: dict[str, str]
    sources: tuple[Source, ...]


def read_results(folder: Path) -> Results:
    """Read every ``*.json`` of a folder whose ``"schema"`` is :data:`SCHEMA`; other files are ignored.

    Raises:
        InputError: no such folder, no row in files with that schema, one that does not follow it, or two files with
            different notes for one flag.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give one that holds a JSON file of result rows.")
    rows: list[Row] = []
    notes: dict[str, str] = {}
    sources: list[Source] = []
    records = {path: _record(path) for path in sorted(folder.glob("*.json"))}
    records = {path: record for path, record in records.items() if record.get("schema") == SCHEMA}
    for path, record in records.items():
        try:
            for name, kind in PARTS.items():
                if not isinstance(record.get(name), kind):
                    raise InputError(f"it has no {'object' if kind is dict else 'list'} {name!r}")
            mine = {str(flag): str(sentence) for flag, sentence in record["notes"].items()}
            if other := [flag for flag, sentence in mine.items() if notes.get(flag, sentence) != sentence]:
                raise InputError(f"another file has another note for the flag {other[0]!r}")
            notes |= mine
            rows += [_row(entry, f"row {number}", mine) for number, entry in enumerate(record["rows"], 1)]
            sources += [_made(Source, one, f"source {number}") for number, one in enumerate(record["sources"], 1)]
        except InputError as error:
            raise InputError(f"{path} does not follow the schema {SCHEMA}: {error}.") from error
    if not rows:
        raise InputError(f'{folder} holds no result rows; expected a JSON file with "schema": "{SCHEMA}".')
    return Results(tuple(rows), notes, tuple(sources))


def _record(path: Path) -> dict[str, Any]:
    """The object in a file; of another value, an empty one. Numbers are checked where they are used."""
    try:
        record = load_json(path, finite=False)
    except ValueError as error:
        raise InputError(f"{path} is not JSON ({error}).") from error
    return record if isinstance(record, dict) else {}


def _row(entry: Any, where: str, notes: dict[str, str]) -> Row:
    peer = entry.get("peer") if isinstance(entry, dict) else None
    if peer is not None:
        entry = entry | {"peer": _made(Peer, peer, f"the peer of {where}")}
    row = _made(Row, entry, where)
    if unknown := set(row.flags) - set(notes):
        raise InputError(f"{where} has the flag {min(unknown)!r}, for which there is no note")
    return row


def _made(kind: type[T], entry: Any, where: str) -> T:
    """An object of a file as a dataclass.

    Raises:
        InputError: it is no object, lacks a field, or has one that is unknown or of another type.
    """
    if not isinstance(entry, dict):
        raise InputError(f"{where} is no object")
    if missing := [one.name for one in fields(kind) if one.name not in entry]:  # type: ignore[arg-type]
        raise InputError(f"{where} has no {missing[0]!r}")
    try:
        return kind(**checked_fields(kind, entry))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def cells(row: Row) -> tuple[str, str, str, str, str, str]:
    """A row as printed: what, paper, ours, interval, best peer, duration alone."""
    interval = "" if row.interval is None else _written(row.interval)
    alone = "" if row.duration is None else f"{row.duration:.3f}"
    peer = "" if row.peer is None else f"{row.peer.mean:.3f} ({_written(row.peer.interval)}) {row.peer.name}"
    return row.what, row.paper, f"{row.ours:.3f}", interval, peer, alone


def _written(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.3f} to {interval[1]:.3f}"
