"""The table of results of a report, read from JSON files of rows; docs/howto/share.md describes the format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcbht_jax._util.untrusted import checked_fields, load_json
from rcbht_jax.errors import InputError

SCHEMA = "rcbht-results-rows-1"


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
        InputError: no such folder, no row in files with that schema, or one that does not follow it.
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
            notes |= {str(flag): str(sentence) for flag, sentence in record["notes"].items()}
            rows += [_row(entry, notes) for entry in record["rows"]]
            sources += [Source(**checked_fields(Source, source)) for source in record["sources"]]
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            reason = f"{type(error).__name__}: {error}"
            raise InputError(f"{path} does not follow the schema {SCHEMA} ({reason}).") from error
    if not rows:
        raise InputError(f'{folder} holds no result rows; expected a JSON file with "schema": "{SCHEMA}".')
    return Results(tuple(rows), notes, tuple(sources))


def _record(path: Path) -> dict[str, Any]:
    """The object in a file; of one with another schema, whose numbers do not matter, an empty one."""
    try:
        record = load_json(path, finite=False)
        if not isinstance(record, dict) or record.get("schema") != SCHEMA:
            return {}
        return load_json(path)
    except ValueError as error:
        raise InputError(f"{path} is not JSON ({error}).") from error


def _row(entry: dict[str, Any], notes: dict[str, str]) -> Row:
    if unknown := set(entry["flags"]) - set(notes):
        raise KeyError(f"no note for the flag {', '.join(sorted(unknown))}")
    peer = None if entry["peer"] is None else Peer(**checked_fields(Peer, entry["peer"]))
    return Row(**checked_fields(Row, entry | {"peer": peer}))


def cells(row: Row) -> tuple[str, str, str, str, str, str]:
    """A row as printed: what, paper, ours, interval, best peer, duration alone."""
    interval = "" if row.interval is None else _written(row.interval)
    alone = "" if row.duration is None else f"{row.duration:.3f}"
    peer = "" if row.peer is None else f"{row.peer.mean:.3f} ({_written(row.peer.interval)}) {row.peer.name}"
    return row.what, row.paper, f"{row.ours:.3f}", interval, peer, alone


def _written(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.3f} to {interval[1]:.3f}"
