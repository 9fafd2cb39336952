"""One mapping for all recordings of a source: a column may be absent or constant in the first, and change in others."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from rcbht_jax.io.importing.guess import Understood
from rcbht_jax.io.importing.mapping import Mapping

Meaning = tuple[Mapping, list[Understood]]  # of the columns of a table


def merged(meanings: Iterable[Meaning]) -> Meaning:
    """The mapping of the first table with the annotations and columns of all, and what all columns are understood as.

    A column that is a track of annotations in any table is one in all; one that counts with its last value in any
    does so in all. One that separates recordings in any does so if all have it. There is at least one meaning.

    >>> from rcbht_jax.io.importing.mapping import Track, Value
    >>> first = Mapping(columns={"phase": Value("phase")}), [Understood("phase", "column phase")]
    >>> second = Mapping(annotations=(Track("phase", "phase"),)), [Understood("phase", "annotations phase")]
    >>> mapping, rows = merged([first, second])
    >>> mapping.annotations[0].column, mapping.columns, rows[0].role
    ('phase', {}, 'annotations phase')
    """
    several = list({id(one): one for one in meanings}.values())
    first = several[0][0]
    tracks, columns = list(first.annotations), dict(first.columns)
    fixed = {channel.column for channel in first.channels} | {first.time, first.nanoseconds, first.group} - {""}
    for mapping, _ in several[1:]:
        known = {track.column for track in tracks} | fixed
        tracks += [track for track in mapping.annotations if track.column and track.column not in known]
        for name, value in mapping.columns.items():
            if value.column not in fixed:
                own = columns.setdefault(name, value)
                columns[name] = value if value == replace(own, last=True) else own
    changing = {(track.track, track.column) for track in tracks}
    columns = {name: value for name, value in columns.items() if (name, value.column) not in changing}
    titles = [{row.column for row in rows} for mapping, rows in several if mapping.channels]
    groups = (mapping.group for mapping, _ in several if all(mapping.group in columns for columns in titles))
    group = first.group or next(groups, "")
    return replace(first, annotations=tuple(tracks), columns=columns, group=group), _rows(several)


def _rows(meanings: Iterable[Meaning]) -> list[Understood]:
    """A row per column of the first table, and per column with a meaning of the others."""
    rows: dict[str, Understood] = {}
    for number, (_, others) in enumerate(meanings):
        for row in others:
            known = rows.get(row.column)
            new = number == 0 or row.role != "left out" if known is None else _rank(row) > _rank(known)
            if new:
                rows[row.column] = row
    return list(rows.values())


def _rank(row: Understood) -> int:
    """How much a meaning counts where tables differ: that of a column that changes most, none least."""
    return 0 if row.role == "left out" else 2 if row.role.startswith("annotations ") else 1
