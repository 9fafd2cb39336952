"""The meaning of columns from names and values, where no mapping states it; units of channels are never guessed."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import FORCES, MOMENTS, TIMES, base_and_unit, snake, split_unit
from rcbht_jax._util.printable import plural
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import names
from rcbht_jax.io.importing.cells import two_meanings
from rcbht_jax.io.importing.mapping import Channel, Mapping, Track, Value
from rcbht_jax.io.importing.record import check_columns, rows_of_recordings
from rcbht_jax.io.importing.rows import filled
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.timing import are_dates, grows, is_clock, is_stamp, unit_of_times, with_time
from rcbht_jax.io.importing.words import OUTCOMES, is_outcome
from rcbht_jax.io.importing.words import text as as_text
from rcbht_jax.types import STANDARD_COLUMNS

MAX_LABELS = 64  # different values of a column of labels
FEWEST = 4  # samples of a recording, in the mean of those of a table
MOST_GROUPS = 1000  # that show whether a column changes within them
MAX_CHANNELS = 64  # where every numeric column is one
_BAD = re.compile(r"anomal|(?<!de)fault|fail|error|defect|collision|unsuccess|reject|fehler|^(?:nok|nio|ng)$")
_DENIAL = re.compile(r"(?:no|non|not|without|ohne|free|frei)$|[a-z]+(?:less|free|frei)$")


def outcome_words(column: str) -> dict[str, str]:
    """The outcome that each text means in a column of that name: an anomaly that is true is a failure.

    >>> outcome_words("result")["true"], outcome_words("anomaly")["true"], outcome_words("anomaly")["ok"]
    ('success', 'failure', 'success')
    >>> outcome_words("no_fault")["true"], outcome_words("not_ok")["true"]
    ('success', 'failure')
    """
    turned = {"1": "failure", "true": "failure", "0": "success", "false": "success"}
    words = re.split(r"[\W\d_]+", snake(column))
    denied = sum(bool(_DENIAL.match(word)) for word in words) % 2 == 1
    return OUTCOMES | turned if any(map(_BAD.search, words)) != denied else OUTCOMES


def stated_words(value: Value, words: Iterable[str]) -> dict[str, str]:
    """The outcome that each word means in a column, for which a mapping states none; {} = not all are known.

    >>> stated_words(Value(table="result"), ["OK", "nok", ""])["nok"], stated_words(Value("class"), ["1", "2"])
    ('failure', {})
    """
    known = {*OUTCOMES, "unknown", "unfinished", ""}
    if value.words or not {word.lower() for word in words} <= known:
        return {}
    return outcome_words(value.column or value.table)


@dataclass(frozen=True)
class Understood:
    """The meaning that was assigned to a column."""

    column: str
    role: str  # "time", "channel Fx", "annotations phase", "column class", "group", "left out", ...
    unit: str = ""


Meaning = tuple[Mapping, list[Understood]]  # of the columns of a table


@np.errstate(invalid="ignore", over="ignore")  # of infinite values, which are refused later
def guess(table: Table, base: Mapping | None = None) -> Meaning:
    """The mapping of a table: what ``base`` states, and guesses for the rest.

    Where ``base`` names channels, only the time is guessed.

    >>> columns = {"t_ms": np.arange(9.0), "Fx": np.ones(9), "phase": np.array(["a"] * 5 + ["b"] * 4)}
    >>> mapping, rows = guess(Table("a.csv", columns))
    >>> [(row.column, row.role) for row in rows]
    [('t_ms', 'time'), ('Fx', 'channel Fx'), ('phase', 'annotations phase')]

    Raises:
        InputError: a column of ``base`` is missing, no column is a channel, there are too many, an axis of a wrench
            holds text, or nothing states the time or the rate.
    """
    base = base or Mapping()
    if not table.columns:
        raise InputError(f"{table.name} holds no array of at least two rows [time] or [time, axis].")
    check_columns(table, base)
    free = [name for name in table.columns if name not in _used(base)]
    mapping = base
    if not base.time and base.source_rate is None:
        mapping = with_time(table, mapping, free)
        free = [name for name in free if name not in (mapping.time, mapping.nanoseconds)]
    if mapping.time:
        mapping = replace(mapping, time_unit=unit_of_times(table, mapping))
    if base.channels:
        return mapping, _understood(table, mapping)
    if not base.group:
        mapping = replace(mapping, group=_group(table, mapping.time, free))
        free = [name for name in free if name != mapping.group]
    # A column of arms separates recordings: the group, or one of text beside it.
    beside = [name for name in free if mapping.group and table.columns[name].dtype.kind == "U"]
    if arm := next((name for name in (mapping.group, *beside) if base_and_unit(name)[0] == "arm"), ""):
        mapping = replace(mapping, columns={"arm": Value(arm), **mapping.columns})
        free = [name for name in free if name != arm]
    _check_axes(table, free)
    mapping = _words(table, mapping, free)
    mapping = replace(mapping, channels=_channels(table, [name for name in free if name not in _used(mapping)]))
    return mapping, _understood(table, mapping)


def _used(mapping: Mapping) -> set[str]:
    used = {channel.column for channel in mapping.channels} | {track.column for track in mapping.annotations}
    used |= {value.column for value in mapping.columns.values()}
    return used | {mapping.time, mapping.nanoseconds, mapping.group} - {""}


def _group(table: Table, time: str, free: list[str]) -> str:
    bases = {names.group_base(name): name for name in free} | {base_and_unit(name)[0]: name for name in free}
    for base in names.GROUPS:
        values = table.columns[bases[base]] if base in bases else np.empty(0)
        several = 1 < len(_distinct(values)) <= len(values) / FEWEST  # else it counts messages
        if several and (values.dtype.kind == "U" or _integers(values)):
            return bases[base]
    for name in (bases[base] for base in names.WEAK_GROUPS if base in bases):
        values = table.columns[name]
        stretches = (values[1:] != values[:-1]).sum() + 1
        if 1 < len(_distinct(values)) == stretches <= len(values) / 10:
            return name
    if time and table.columns[time].dtype.kind != "U" and (back := np.diff(table.columns[time]) < 0).any():
        # What changes where the time starts anew, each time to a new value, names the recordings.
        for name in (name for name in free if not _is_label(name)):
            values = table.columns[name]
            new = np.array_equal(values[1:] != values[:-1], back)
            if new and len(_distinct(values)) == back.sum() + 1 <= len(values) / 2:  # each of several samples
                return name
    arm = bases.get("arm", "")
    return arm if arm and table.columns[arm].dtype.kind == "U" and len(_distinct(table.columns[arm])) > 1 else ""


def _words(table: Table, mapping: Mapping, free: list[str]) -> Mapping:
    """Columns of the data set and annotations, from columns of text and of labels."""
    columns, tracks = dict(mapping.columns), list(mapping.annotations)
    groups = rows_of_recordings(table, mapping)
    facts = _facts(table, groups, free)
    groups = groups[:MOST_GROUPS]
    numbers: list[str] = []
    for name in free:
        values, plain = table.columns[name], _of_any_arm(table, name)
        base = base_and_unit(plain)[0]
        short = re.split(r"[./]", base)[-1]
        text = values.dtype.kind == "U"
        stamps = text and ((base in TIMES and are_dates(values)) or is_clock(values))  # that --source-rate replaces
        if (
            (base in names.COUNTERS and not text)
            or (short in names.ENDS and _is_flag(values))
            or stamps
            or not (text or name in facts or (_is_label(plain) and _integers(values)))
        ):
            continue
        target = short if short in (*STANDARD_COLUMNS, "trial") else names.column_name(plain)
        result = short == "success" and _is_flag(values) and _rises(values, groups)
        # An outcome that changes is a mistake, not a track, which would replace it in every recording.
        if short == "outcome" or result or all(_constant(values[rows], short in names.LABELS) for rows in groups):
            if is_outcome(short, _distinct(values).tolist()):
                columns.setdefault("outcome", Value(name, words=OUTCOMES, last=result))
            columns.setdefault(target, Value(name, last=result))
        elif short in names.TOPICS:
            continue
        elif not text:
            numbers.append(name)
        elif len(_distinct(values)) <= max(MAX_LABELS, len(values) // 20) and not mapping.annotations:
            tracks.append(Track(target, name))
    if not tracks:  # numbers stand for labels only where no column of text does
        tracks = [
            Track(names.column_name(_of_any_arm(table, name)), name)
            for name in numbers
            if len(_distinct(table.columns[name])) <= MAX_LABELS
        ]
    return replace(mapping, columns=columns, annotations=tuple(tracks))


def _of_any_arm(table: Table, name: str) -> str:
    """The name of a column without the place of its arm, unless another column is called so."""
    plain = names.of_any_arm(name)
    return name if not plain or plain in table.columns else plain


def _facts(table: Table, groups: list[NDArray[np.int64]], free: list[str]) -> set[str]:
    """Numbers that change only from one recording of a table to the next: they describe these, and are no signal."""
    starts = np.sort([rows[0] for rows in groups])[1:]
    if not len(starts) or any((np.diff(rows) != 1).any() for rows in groups):
        return set()
    border = np.isin(np.arange(1, len(next(iter(table.columns.values())))), starts)
    axes = _axes(free)
    numbers = (name for name in free if table.columns[name].dtype.kind != "U" and name not in axes)
    steps = ((name, np.diff(table.columns[name])) for name in numbers)
    return {name for name, step in steps if len(step[~border]) and not step[~border].any() and step.any()}


def _axes(columns: Iterable[str]) -> set[str]:
    """The columns that are axes of a wrench."""
    return {column for wrench in names.wrenches(columns) for column in wrench.values()}


def _is_label(name: str) -> bool:
    """Whether whole numbers in a column of this name stand for words."""
    short = re.split(r"[./]", base_and_unit(name)[0])[-1]
    return short in (*names.LABELS, *STANDARD_COLUMNS, "success", "trial")


def _integers(values: NDArray[Any]) -> bool:
    known = values[np.isfinite(values)]
    return bool((known == np.round(known)).all())


def _distinct(values: NDArray[Any]) -> NDArray[Any]:
    return np.unique(values[values != ""] if values.dtype.kind == "U" else values[np.isfinite(values)])


def _is_flag(values: NDArray[Any]) -> bool:
    words = _distinct(values)
    return len(words) <= 2 and {as_text(word).lower() for word in words} <= {"true", "false", "1", "0"}


def _rises(values: NDArray[Any], groups: list[NDArray[np.int64]]) -> bool:
    """Whether a flag is set in the course of recordings and never taken back, so that its last value is the result."""
    truth = np.isin([as_text(value).lower() for value in values], ("true", "1"))
    known = filled(values)
    steps = [np.diff(truth[rows[known[rows]]].astype(np.int8)) for rows in groups]
    return any((step > 0).any() for step in steps) and not any((step < 0).any() for step in steps)


def _constant(values: NDArray[Any], label: bool) -> bool:
    """Whether a column has one value; a label that only some rows have is not constant."""
    gone = values == "" if values.dtype.kind == "U" else ~np.isfinite(values)
    return len(_distinct(values)) <= 1 and not (label and gone.any() and not gone.all())


def _check_axes(table: Table, free: list[str]) -> None:
    """Raise InputError where an axis, or a whole wrench, is text, such as 1.234,50: it must not be left out."""
    axes = _axes(free)
    for column in (name for name in free if table.columns[name].dtype.kind == "U"):
        words = _distinct(table.columns[column])
        whole = len(words) > MAX_LABELS and re.split(r"[\W_]+", snake(column))[-1] in names.WHOLE
        if len(words) and (column in axes or whole):
            first = next(text for text in table.columns[column] if text)
            how = " Write plain numbers, and their unit in the name of the column: Fx [N]."
            raise InputError(
                f"{table.name}: column {column!r} holds {str(first)[:30]!r}, which is not a number."
                + (two_meanings(str(first)) or how)
            )


def _channels(table: Table, free: list[str]) -> tuple[Channel, ...]:
    numeric = [name for name in free if table.columns[name].dtype.kind != "U"]
    if wrench := names.preferred(names.wrenches(numeric)):
        return tuple(Channel(column, axis, _unit_of(table, column, axis)) for axis, column in wrench.items())
    other = {*names.COUNTERS, *names.ENDS, *names.GROUPS, *names.NANOSECONDS}
    rest = [name for name in numeric if not other & {base_and_unit(name)[0], names.group_base(name)}]
    # a T that does not grow is a temperature or a torque
    rest = [name for name in rest if base_and_unit(name)[0] not in TIMES or not grows(table, name)]
    rest = [name for name in rest if np.isfinite(table.columns[name]).any()]  # an empty column is none
    rest = [name for name in rest if not is_stamp(table, name)]
    rest = [name for name in rest if not (_is_label(name) and _integers(table.columns[name]))]
    rest = [name for name in rest if name != "c0" or not (np.diff(table.columns[name]) == 1).all()]
    if not rest:
        more = f" Arrays of another shape or kind are left out: {some(table.others)}." if table.others else ""
        if key := next((name for name in table.columns if names.group_base(name) in names.GROUPS), ""):
            more += (
                " If it describes other files, add a column 'file' with their names; if parts of one, write in a map"
                f" table = {table.name!r} and key = {key!r}."
            )
        raise InputError(f"{table.name} has no column of numbers to import; it has {some(table.columns)}.{more}")
    if len(rest) > MAX_CHANNELS:
        raise InputError(
            f"{table.name} has {plural(len(rest), 'column')} of numbers and none is a wrench; choose some with --map."
        )
    short = [names.axis_name(name) or split_unit(name)[0] for name in rest]
    titles = short if len(set(short)) == len(rest) else rest
    return tuple(Channel(name, title, _unit_of(table, name)) for name, title in zip(rest, titles, strict=True))


def some(texts: Iterable[str]) -> str:
    """The first names of many.

    >>> some(["a", "b"])
    "'a', 'b'"
    """
    listed = list(texts)
    more = f" and {len(listed) - 12} more" if len(listed) > 12 else ""
    return (", ".join(map(repr, listed[:12])) or "none") + more


def _unit_of(table: Table, name: str, axis: str = "") -> str:
    """The unit of a column; "" = unknown, also where a whole wrench states one that only some axes can have."""
    unit = table.units.get(name, "") or base_and_unit(name)[1]
    return "" if unit in {"F": MOMENTS, "M": FORCES}.get(axis[:1], ()) else unit


def _understood(table: Table, mapping: Mapping) -> list[Understood]:
    """A row per column of the table."""
    rows = [Understood(track.column, f"annotations {track.track}") for track in mapping.annotations]
    rows += [Understood(value.column, f"column {name}") for name, value in mapping.columns.items()]
    rows += [Understood(one.column, f"channel {one.name or one.column}", one.unit) for one in mapping.channels]
    rows += [
        Understood(mapping.group, "group: a recording for each value"),
        Understood(mapping.nanoseconds, "nanoseconds of the time", "ns"),
        Understood(mapping.time, "time", mapping.time_unit),
    ]
    roles = {row.column: row for row in rows if row.column}
    return [roles.get(name, Understood(name, "left out")) for name in table.columns]


def merged(meanings: Iterable[Meaning]) -> Meaning:
    """The mapping of the first table with the annotations and columns of all, and what all columns are understood as.

    A column that is a track of annotations in any table is one in all; one that counts with its last value in any
    does so in all. One that separates recordings in any does so if all have it. There is at least one meaning.

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
    return replace(first, annotations=tuple(tracks), columns=columns, group=group), _merged_rows(several)


def _merged_rows(meanings: Iterable[Meaning]) -> list[Understood]:
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
