"""JSON documents: a recording as a list of samples or as a list for each column, or several of them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import unit_of_time
from rcbht_jax._util.untrusted import MAX_JSON_BYTES, MAX_MEMBERS, parse_json
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.arrays import reading
from rcbht_jax.io.importing.attributes import UNITS
from rcbht_jax.io.importing.isolated import apart
from rcbht_jax.io.importing.json_lines import Rows
from rcbht_jax.io.importing.mapping import Track
from rcbht_jax.io.importing.marks import intervals_of, is_intervals
from rcbht_jax.io.importing.names import column_name, names_side, wrenches
from rcbht_jax.io.importing.rows import MAX_GROUPS
from rcbht_jax.io.importing.table import Interval, Table, scalars_of, tables_of, with_units
from rcbht_jax.io.importing.trees import Tree, recordings_in
from rcbht_jax.io.importing.unpacked import opened

DEPTH = 16  # of objects and lists within each other
PROBES = 64  # objects of a list that are looked at
LONGEST = 64  # elements of a list in a sample, such as a matrix; a longer one is a column
LEAST_STAMP = 1e8  # of an index: time since 1970; smaller whole numbers count rows
Object = Mapping[str, Any]


@apart()
def read_json_document(path: Path, name: str) -> Iterator[Table]:
    """The tables of a JSON document.

    A list of objects is a row per object, or a recording per object where each holds lists over time. An object of
    lists is a column per list; one of several such objects with the same names holds a recording in each; an object
    with a list of rows is these rows. Single values beside them are facts (dt, rate: the sampling), and lists of
    objects with a label and a start are annotations. Data frames of pandas are read in each of their orientations.

    >>> text = '{"rate": 100, "Fz": [0, 1.5, null], "phases": [{"label": "push", "start": 0.01, "end": 0.02}]}'
    >>> _ = Path("run.json").write_text(text)
    >>> [table] = read_json_document(Path("run.json"), "run.json")
    >>> table.rate, table.columns["Fz"].tolist(), table.intervals
    (100.0, [0.0, 1.5, nan], (('phases', 'push', 0.01, 0.02),))

    Raises:
        InputError: not a regular file, too large, not JSON, nested too deeply, or without a list of two samples.
    """
    with opened(path, MAX_JSON_BYTES) as file:
        content = file.read()
    with reading(path, "JSON"):
        yield from _tables(path, name, _frame(parse_json(content, finite=False)), "")


def _tables(path: Path, name: str, value: Any, part: str) -> Iterator[Table]:
    if _are_objects(value) and not any(map(_is_recording, value[:PROBES])):
        value = {"rows": value}
    several, around = _several(value)
    if several:
        if len(several) > MAX_GROUPS:
            raise InputError(f"{path} holds more than {MAX_GROUPS} recordings; split it.")
        sides = all(map(names_side, several))
        around = {key: one for key, one in around.items() if _is_shared(one)}
        rate, facts = scalars_of({key: one for key, one in _named(around) if one.ndim == 0})
        intervals = intervals_in(around)
        lost = () if sides else tuple(dict.fromkeys(track for track, *_ in intervals))  # of which trial is unknown
        columns = {key: one for key, one in _flat(around) if isinstance(one, list) and one}
        columns = {key: one for key, one in columns.items() if not isinstance(one[0], list | dict)}
        for which, one in several.items():
            place = f"{part}#{which}" if part else which
            for table in _tables(path, f"{name}#{which}", _with_shared(one, columns), place):
                own = {**facts, **({"arm": which} if sides else {}), **table.facts}
                marks = (*table.intervals, *(intervals if sides else ()))
                whole = replace(table, rate=table.rate or rate, facts=own, intervals=marks)
                yield with_units(replace(whole, others=(*table.others, *lost)))
        return
    value = value if isinstance(value, dict) else {"values": value}
    lists = {key: one for key, one in _flat(value) if _are_objects(one)}
    intervals = intervals_in(value)
    rows: list[Object] = max((one for one in lists.values() if not _marks(one)), key=len, default=[])
    arrays = dict(_named(value))
    if len(rows) > max((len(array) for array in arrays.values() if array.ndim), default=1):
        yield _of_rows(path, name, rows, arrays, intervals, part)
        return
    for table in tables_of(path, name, arrays, part):
        yield with_units(replace(table, intervals=(*table.intervals, *intervals)))


def _is_shared(value: Any) -> bool:
    """Whether a value beside recordings holds none: it may be about all of them."""
    if _are_objects(value):
        return not any(map(_is_recording, value[:PROBES])) and bool(_marks(value))
    return not _several(value)[0]


def _with_shared(one: Any, columns: Object) -> Any:
    """A recording with the lists beside it that are as long as a list of its own, such as a time that all share."""
    if not isinstance(one, dict):
        return one
    lengths = {len(own) for _, own in _flat(one) if isinstance(own, list) and not _are_objects(own)} - {1}
    return {**{key: value for key, value in columns.items() if len(value) in lengths}, **one}


def _of_rows(
    path: Path, name: str, objects: list[Object], arrays: Mapping[str, NDArray[Any]], intervals: Any, part: str
) -> Table:
    rows = Rows()
    for number, one in enumerate(objects):
        try:
            rows.add_object(one)
        except (ValueError, OverflowError) as error:
            raise InputError(f"{path}, object {number}: {error}.") from None
    rate, facts = scalars_of({key: array for key, array in arrays.items() if array.ndim == 0})
    others = tuple(sorted({*rows.others, *(key for key, array in arrays.items() if array.ndim)}))
    return with_units(Table(name, rows.columns(path), rate, facts=facts, intervals=intervals, others=others, part=part))


def annotations_in(name: str, value: Any) -> Table | None:
    """A table of annotations, if a value is a list of objects that state a label, a start and perhaps an end.

    >>> annotations_in("a.json", [{"name": "touch", "begin": 1.0, "end": 1.5}]).columns["begin"].tolist()
    [1.0]

    Raises:
        ValueError: text in a column of numbers, or the reverse.
    """
    rows = Rows()
    for one in _marks(value):
        rows.add_object(one)
    return Table(name, rows.columns(Path(name))) if rows.count else None


def _marks(value: Any) -> list[Object]:
    """The objects of a list if they are annotations, where a name is a label if nothing else is; else none."""
    if not _are_objects(value) or is_intervals(value[0]):
        return value if _are_objects(value) else []
    renamed = ({"label" if key == "name" else key: cell for key, cell in one.items()} for one in value)
    return list(renamed) if is_intervals(["label" if key == "name" else key for key in value[0]]) else []


def intervals_in(value: Object) -> tuple[Interval, ...]:
    """The annotations that an object holds, as tracks with the names of their lists.

    >>> intervals_in({"run": {"phases": [{"name": "touch", "begin": 1.0, "end": 1.5}]}})
    (('phases', 'touch', 1.0, 1.5),)

    Raises:
        ValueError: text in a column of numbers, or the reverse; a time that is text.
    """
    tables = ((key.rpartition(".")[2], annotations_in(key, one)) for key, one in _flat(value))
    return tuple(
        interval for key, table in tables if table for _, interval in intervals_of(table, Track(column_name(key)))
    )


def _frame(value: Any) -> Any:
    """A data frame that pandas wrote, or samples by number or time, as columns or rows; any other value as it is."""
    if not isinstance(value, dict):
        return value
    if set(value) == {"columns", "index", "data"} and _are_lists(value["data"]):
        columns = dict(zip(map(str, value["columns"]), map(list, zip(*value["data"], strict=True)), strict=True))
        return {**_times(value["index"], columns), **columns}
    inner = list(value.values())
    if len(inner) and all(isinstance(one, dict) and len(one) > 1 and set(one) == set(inner[0]) for one in inner):
        scalars = all(not isinstance(cell, dict | list) for one in inner for cell in one.values())
        if scalars and (all(map(_is_number, inner[0])) or _times(list(inner[0]), value)):
            return {**_times(list(inner[0]), value), **{key: list(one.values()) for key, one in value.items()}}
        times = _times(list(value), inner[0]).get("time", [])
        if len(value) > 1 and (times or all(map(_is_number, value))) and not _is_recording(inner[0]):
            return [{"time": time, **one} for time, one in zip(times, inner, strict=True)] if times else inner
    return value


def _times(index: Any, columns: Iterable[str]) -> dict[str, list[Any]]:
    """The index of a data frame as a column, if it holds times and no column does; counted rows are no times."""
    if not isinstance(index, list) or len(index) < 2 or any(map(unit_of_time, columns)):
        return {}
    if all(_is_number(str(one)) for one in index):
        numbers = list(map(float, index))
        counted = all(number.is_integer() and abs(number) < LEAST_STAMP for number in numbers)
        return {} if counted else {"time": numbers}
    texts = list(map(str, index))
    return {"time": texts} if all(re.match(r"\d{4}-?\d\d-?\d\d[T ]", text) for text in texts) else {}


def _is_number(text: str) -> bool:
    return text.lstrip("-").replace(".", "", 1).isdecimal()


def _several(value: Any) -> tuple[Object, Object]:
    """The recordings of a list, or of an object with like objects, and what is beside them; none if it is one."""
    if _are_objects(value):
        return {str(number): one for number, one in enumerate(value)}, {}
    if not isinstance(value, dict):
        return {}, {}
    around: Object = {}
    if found := recordings_in(_tree(value)):
        path, parts = found
        for key in path:
            around = {**around, **{name: one for name, one in value.items() if name != key[:-1]}}
            value = value[key[:-1]]
        several = {key: one for key, one in value.items() if key in parts}  # in the order of the document
        return several, {**around, **{name: one for name, one in value.items() if name not in several}}
    rows: Object = {
        key: one for key, one in value.items() if _are_objects(one) and not _marks(one) and _is_sample(one[0])
    }
    rest = {key: one for key, one in value.items() if key not in rows}
    shapes = {
        f"{key}/": {name: np.broadcast_to(0.0, len(one)) for name, _ in _flat(one[0])} for key, one in rows.items()
    }
    if recordings_in(shapes) and not _is_recording(rest):
        return rows, rest
    lists = [key for key, one in value.items() if _are_objects(one) and any(map(_is_recording, one[:PROBES]))]
    within = [key for key, one in value.items() if isinstance(one, dict)]
    chosen = lists if len(lists) == 1 else within if not _is_recording(value) else []
    if len(chosen) != 1:
        return {}, {}
    within_it, beside = _several(value[chosen[0]])
    return within_it, {**{key: one for key, one in value.items() if key != chosen[0]}, **beside}


def _tree(value: Object, depth: int = 0) -> Tree:
    """The shapes of the lists over time in an object and those within it."""
    if depth > DEPTH:
        raise ValueError(f"objects are nested more than {DEPTH} times")
    tree: Tree = {}
    for key, one in value.items():
        if isinstance(one, list):
            tree[str(key)] = np.broadcast_to(0.0, (len(one), len(one[0])) if _are_lists(one) else len(one))
        elif isinstance(one, dict):
            tree[f"{key}/"] = _tree(one, depth + 1)
    return tree


def _is_sample(value: Object) -> bool:
    """Whether an object holds a time, or the axes of a wrench."""
    names = [key for key, _ in _flat(value)]
    return any(unit_of_time(name.rpartition(".")[2]) for name in names) or bool(wrenches(names))


def _is_recording(value: Object) -> bool:
    """Whether an object holds a signal, and is no sample: lists over time, or a list of rows."""
    lists = {key: one for key, one in _flat(value) if isinstance(one, list) and len(one) > 1}
    wide = {key: one for key, one in lists.items() if _are_lists(one) and len(one) > len(one[0])}
    if any(unit_of_time(key.rpartition(".")[2]) for key in lists) or any(len(one) > LONGEST for one in lists.values()):
        return True
    rows = (one for one in lists.values() if _are_objects(one) and not _marks(one))
    return any(rows) or bool(wrenches(lists)) or any(wrenches([f"{key}_{k}" for k in range(6)]) for key in wide)


def _are_objects(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 0 and all(isinstance(one, dict) for one in value)


def _are_lists(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 0 and all(isinstance(one, list) and one for one in value)


def _flat(value: Object, name: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """The values of an object and of those within it, by names such as "force.x"."""
    if depth > DEPTH:
        raise ValueError(f"objects are nested more than {DEPTH} times")
    for key, one in value.items():
        inner = f"{name}.{key}" if name else str(key)
        if isinstance(one, dict):
            yield from _flat(one, inner, depth + 1)
        else:
            yield inner, one


def _named(value: Object) -> Iterator[tuple[str, NDArray[Any]]]:
    """Arrays of the lists and single values of an object; what is no array is left out."""
    for number, (key, one) in enumerate(_flat(value)):
        if number == MAX_MEMBERS:
            raise ValueError(f"it holds more than {MAX_MEMBERS} values with a name; split it")
        within = key.rpartition(".")[0].rpartition(".")[2].lower()
        if within in UNITS and isinstance(one, list):  # one for each element of a column
            one = ",".join(map(str, one))
        if one is not None and (array := _array(one)) is not None:
            yield key, array


def _array(value: Any) -> Any:
    """An array of numbers or of texts, null = not a number; None = it is neither."""
    if isinstance(value, list) and all(one is None or isinstance(one, bool) for one in value):
        value = [str(one).lower() if isinstance(one, bool) else None for one in value]
    if isinstance(value, list) and any(isinstance(one, str) for one in value):
        texts = all(one is None or isinstance(one, str) for one in value)
        return np.array(["" if one is None else one for one in value]) if texts else None
    if isinstance(value, str | bool):
        return np.array(str(value).lower() if isinstance(value, bool) else value)
    if isinstance(value, list) and (width := max((len(one) for one in value if isinstance(one, list)), default=0)):
        value = [[None] * width if one is None else one for one in value]
    try:
        return np.array(value, np.float64)
    except (ValueError, TypeError):
        return None
