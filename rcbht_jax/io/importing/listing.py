"""The table of recordings: a CSV, or a JSON list, beside the recordings with a row for each."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from collections.abc import Mapping as AnyMapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from rcbht_jax._util.printable import plural
from rcbht_jax._util.untrusted import check_inside, read_json
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.families import numbered
from rcbht_jax.io.importing.find import Item
from rcbht_jax.io.importing.guess import some
from rcbht_jax.io.importing.mapping import Mapping, Value
from rcbht_jax.io.importing.marks import Names, ambiguous, beside, is_intervals
from rcbht_jax.io.importing.names import GROUPS, column_name, group_base
from rcbht_jax.io.importing.record import Record, Row
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.text import read_csv
from rcbht_jax.io.importing.unpacked import doubts, opened
from rcbht_jax.io.importing.words import OUTCOMES, is_outcome, plain_number, text
from rcbht_jax.types import STANDARD_COLUMNS

HEAD = 4096  # bytes of a table in which a recording is named, if it lists them


def rows_of(
    source: Path, mapping: Mapping, files: list[str], warnings: list[tuple[str, str]], table: Table | None
) -> dict[str, Row]:
    """The table of recordings: file -> column -> text.

    Args:
        source: a file or a folder.
        mapping: names the table, its column of files and the columns to read.
        files: names of all files of recordings.
        warnings: gets warnings of a file that is named twice, or a word that means several files.
        table: what the file holds, if :func:`with_table` has found it.

    Raises:
        InputError: the table is missing, not CSV or a JSON list of objects, or lacks a column that the mapping names.
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
        if table is None:
            [table] = read_csv(path, path.name, words=True)
        warnings += doubts(mapping.table, table.notes)
        columns = {key: [text(value) for value in values] for key, values in table.columns.items()}
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    there = dict.fromkeys(key for row in rows for key in row)
    for column in (mapping.key, *(value.table for value in mapping.columns.values() if value.table)):
        if rows and column not in there:
            raise InputError(f"{path} has no column {column!r}; it has {', '.join(there)}.")
    names, found = Names((file, "") for file in files), dict[str, Row]()
    numbers = _by_number(mapping.key, [row.get(mapping.key, "") for row in rows], files)
    for row in rows:
        word = row.get(mapping.key, "")
        meant = names.meant(word) or numbers.get(plain_number(word), set())
        if len(meant) > 1:
            warnings.append((mapping.table, ambiguous(word)))
            continue
        file = files[min(meant)] if meant else plain_number(word)
        again = mapping.table, f"has several rows for {file}; the last one counts."
        if file and file in found and again not in warnings:
            warnings.append(again)
        found[file] = row
    return found


def with_table(
    source: Path, mapping: Mapping, items: Iterable[Item], remarks: list[str]
) -> tuple[Mapping, Table | None]:
    """The mapping with the one CSV of a folder that lists its recordings, a row for each, and that table, if any.

    The mapping names no table; ``remarks`` gets what was found.
    """
    files = [item.name for item in items if item.name]
    names = Names((file, "") for file in files)
    tables = ((item.name, _listing(source, item.path, files, names)) for item in items if item.kind == "csv")
    found = [(file, *listing) for file, listing in tables if listing]
    if len(found) != 1:
        return mapping, None
    [(file, key, table)] = found
    columns = dict(mapping.columns)
    for title, values in table.columns.items():
        name = column_name(title.lower() if title.lower() in STANDARD_COLUMNS else title)
        if title != key and name not in ("trial", "note"):
            columns.setdefault(name, Value(table=title))
        if is_outcome(title.lower(), np.unique(values).tolist()):
            columns["outcome"] = mapping.columns.get("outcome", Value(table=title, words=OUTCOMES))
    for name, value in mapping.columns.items():
        if value.column in table.columns:
            columns[name] = replace(value, column="", table=value.column)
    own = [title for title in table.columns if title != key and column_name(title.lower()) in ("trial", "note")]
    but = f", but for {some(own)}: trials have the names of their files, notes are those of the import" if own else ""
    remarks.append(f"{file} lists the recordings, named in its column {key!r}; its other columns describe them{but}.")
    return replace(mapping, table=file, key=key, columns=columns), table


def _listing(source: Path, path: Path, files: Sequence[str], names: Names) -> tuple[str, Table] | None:
    """The column of a table that names a recording in each row, nearly, and the table; None = there is none."""
    try:
        check_inside(path, source)
        with opened(path) as file:
            head = file.read(HEAD)
            lines = 0
            while lines <= 2 * len(files) and (block := file.read(2**20)):  # a log has more, and is not read whole here
                lines += block.count(b"\n")
        words = [word.strip(' "') for word in re.split(r"[,;\t\r\n]", head.decode("utf-8-sig", "replace"))]
        numbered_rows = any(group_base(word) in GROUPS for word in words) and lines <= 2 * len(files)
        if not (numbered_rows or any(map(names.meant, words))):  # a recording is soon known as one
            return None
        [table] = read_csv(path, path.name, words=True)
    except (OSError, InputError):  # reported where it is read as a recording
        return None
    if is_intervals(table.columns):
        return None
    best, most = "", 0
    for key, values in table.columns.items():
        words = [text(value) for value in values]
        distinct = set(words)
        # recordings have several rows in a table of events, and a few have in one that lists them
        if 2 * len(distinct) < len(words) + (len(distinct) < len(words)):
            continue
        numbers = _by_number(key, distinct, files)
        meant = [names.meant(word) or numbers.get(plain_number(word), set()) for word in distinct]
        named = len({min(places) for places in meant if len(places) == 1})
        if 2 * named >= len(words) + (len(distinct) < len(words)) and named > most:
            best, most = key, named
    return (best, table) if most else None


def _by_number(title: str, words: Iterable[str], files: Sequence[str]) -> dict[str, set[int]]:
    """The files that numbers in a column such as "run" mean: 1 means run1.csv and run01/ft.csv, and also test1.csv if
    the numbers of these files are those of the column."""
    heads: defaultdict[str, defaultdict[str, set[int]]] = defaultdict(lambda: defaultdict(set))
    for place, file in enumerate(files if group_base(title) in GROUPS else ()):
        for part in PurePosixPath(file).with_suffix("").parts:
            if match := re.fullmatch(r"(.*?)(\d+)", part, re.ASCII):
                heads[match[1]][plain_number(match[2])].add(place)
    own = set(map(plain_number, words))
    found = [numbers for head, numbers in heads.items() if numbered(head) == group_base(title) or {*numbers} == own]
    return dict(found[0]) if len(found) == 1 else {}


def absent(rows: AnyMapping[str, Row], records: Iterable[Record], skipped: Iterable[str]) -> str:
    """A warning about rows of the table whose recording was neither read nor skipped; "" = there are none.

    >>> record = Record("a.csv", np.arange(2.0), np.zeros((2, 1)), ("Fz",), ("N",))
    >>> absent({"a.csv": {}, "b": {}, "c.csv": {}}, [record], ["c.csv"])
    "1 row is of no recording here, and left out: 'b'."
    """
    there = {word for record in records for word in (record.name, record.file, record.part)}
    there |= {word for name in skipped for word in (name, *name.split("#", 1))}
    unknown = [word for word in rows if word and word not in there]
    are = plural(len(unknown), "row is", "rows are")
    return f"{are} of no recording here, and left out: {some(unknown)}." if unknown else ""


def _word(value: object) -> str:
    if value is None:
        return ""
    return text(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)
