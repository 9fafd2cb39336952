"""The output of every reader: tables of columns over time."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import decoded, unit_of_time
from rcbht_jax._util.untrusted import MAX_COLUMNS
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.attributes import lists_of_units, units_in
from rcbht_jax.io.importing.families import families, segments
from rcbht_jax.io.importing.names import has_axes, has_forces, wrenches
from rcbht_jax.io.importing.trees import of_groups
from rcbht_jax.io.importing.words import rate_of

LONGEST_TEXT = 100_000  # characters of a fact in which a rate is looked for
_CONTROL = re.compile(r'"control_freq(?:uency)?"\s*:\s*(\d+(?:\.\d+)?)\s*[,}]')
OF_COLUMNS = ("names", "columns", "channels", "axes")  # lists of names
LENGTH_NAMES = ("length", "lengths", "n_samples", "num_samples", "n_steps", "num_steps", "seq_len", "seq_lengths")

Interval = tuple[str, str, float, float]  # track, label, start, end (NaN = unknown) in s from the first sample


@dataclass(frozen=True)
class Table:
    """Columns of equal length from one file, or from one part of it. Host arrays."""

    name: str  # path relative to the source; a part of a file follows after "#"
    columns: Mapping[str, NDArray[Any]]  # [row] float64, or text
    rate: float | None = None  # samples per second, where the file states it
    units: Mapping[str, str] = field(default_factory=dict)  # of columns, where the format states them
    facts: Mapping[str, str | float] = field(default_factory=dict)  # what holds for the whole table
    intervals: tuple[Interval, ...] = ()  # on the clock of the columns, where their times can be nothing else
    notes: tuple[str, ...] = ()
    others: tuple[str, ...] = ()  # arrays of other shapes, which are left out
    lines: tuple[str, ...] = ()  # how lines begin that are no samples, and are left out
    faults: tuple[str, ...] = ()  # words in columns of numbers, each of which is a missing value
    part: str = ""  # of the file, as the name ends with it; "" = the whole file

    @property
    def file(self) -> str:
        """The name without the part; a file's own name may have a "#" too."""
        return self.name.removesuffix(f"#{self.part}") if self.part else self.name


def tables_of(
    path: Path, name: str, arrays: Mapping[str, NDArray[Any]], part: str = "", shared: Container[str] = ()
) -> Iterator[Table]:
    """Tables of named arrays, as array files hold them.

    Arrays ``[row]`` and ``[row, element]`` of one length are columns (elements are ``name_0``, ``name_1``, ...): that
    of a wrench if there is one, else the most frequent. An array ``[recording, row, element]`` makes a table of each
    recording, and arrays ``[recording]`` beside it are facts; one called lengths states where the padding begins.
    Beside a wrench or a time ``[row, element]`` of its length, it is a matrix for every row, and left out.
    Where names number recordings (:func:`~rcbht_jax.io.importing.families.families`), each makes tables of its own,
    as does each group of a whole file with a wrench of its own (:func:`~rcbht_jax.io.importing.trees.of_groups`).
    Scalars called dt or rate state the sampling, other scalars are facts, but for those of numbered groups of
    annotations (:func:`~rcbht_jax.io.importing.families.segments`). Of windows of the last samples,
    ``[row, sample, element]``, each of which is the one before and a new sample, the newest sample is a row.

    >>> [table] = tables_of(Path("a.npz"), "a.npz", {"wrench": np.zeros((9, 2)), "dt": np.array(0.01)})
    >>> list(table.columns), table.rate
    (['wrench_0', 'wrench_1'], 100.0)

    The name is relative to the source and ends with the ``part`` of the file, "" = all of it. Numbers in the names that
    several parts have, ``shared``, separate none.

    Raises:
        InputError: no array has at least two rows, or there are too many columns.
    """
    numbers = families(arrays, shared)
    if several := numbers or ({} if part else of_groups(arrays)):
        used = {id(one) for those in several.values() for one in those.values()}
        lost = [] if numbers else [key for key, one in arrays.items() if id(one) not in used and one.size]
        for which, those in several.items():
            place = f"{part}#{which}" if part else which
            for table in tables_of(path, f"{name}#{which}", those, place, arrays.keys()):
                yield replace(table, others=(*table.others, *lost))
        return
    if dated := [key for key, array in arrays.items() if array.dtype.kind in "mM"]:
        known = {key: _seconds(array) if key in dated else array for key, array in arrays.items()}
        for table in tables_of(path, name, known, part, shared):
            yield replace(table, units={**table.units, **{key: "s" for key in dated if key in table.columns}})
        return
    if lists := lists_of_units(arrays):
        joined = {key: np.array(",".join(map(str, plain(array.ravel()).tolist()))) for key, array in lists.items()}
        for table in tables_of(path, name, {**arrays, **joined}, part, shared):
            yield with_units(table)
        return
    arrays, titles = titled(arrays)
    if titles:
        for table in tables_of(path, name, arrays, part, shared):
            yield replace(table, columns={titles.get(key, key): column for key, column in table.columns.items()})
        return
    intervals, arrays = segments(arrays)
    arrays = {key: array.reshape(()) if array.size == 1 else array for key, array in arrays.items() if array.size}
    rate, facts = scalars_of({key: array for key, array in arrays.items() if array.ndim == 0})
    arrays, windows = _newest(arrays)
    cubes = _cubes(arrays)
    if cubes and not _are_matrices(cubes, arrays):
        for columns, own, number, rest in _recordings(path, arrays, cubes):
            place = f"{part}#{number}" if part else str(number)
            both, notes = {**facts, **own}, _left_out(rest)
            yield Table(f"{name}#{number}", columns, rate, facts=both, notes=notes, others=rest, part=place)
        return
    chosen, others = _of_one_length(arrays)
    if not chosen and not part:
        raise InputError(f"{path} holds no array of at least two rows [time] or [time, axis].")
    if not chosen:
        yield Table(name, {}, part=part)
        return
    last = [f"windows:{windows[key]}" for key in chosen if key in windows][:1]
    yield Table(
        name, _columns(path, chosen), rate, facts=facts, intervals=tuple(intervals), notes=(*last, *_left_out(others)),
        others=others, part=part,
    )  # fmt: skip


def with_units(table: Table) -> Table:
    """The table with the units that its facts state (:func:`~rcbht_jax.io.importing.attributes.units_in`)."""
    facts, units = units_in(table.facts, table.columns)
    return replace(table, facts=facts, units={**units, **table.units})


def _cubes(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays of three dimensions as ``[recording, row, element]``, of one number of recordings and rows."""
    cubes = {key: array for key, array in arrays.items() if array.ndim == 3 and array.dtype.kind in "fiub"}
    lying = {key for key, cube in cubes.items() if _lies(key, cube, arrays)}
    upright = {cube.shape[:2] for key, cube in cubes.items() if key not in lying}
    lying = {key for key in lying if cubes[key].shape[:2] not in upright}
    cubes = {key: cube.swapaxes(1, 2) if key in lying else cube for key, cube in cubes.items()}
    turned = {cube.shape[::2] for key, cube in cubes.items() if _ends_in_recordings(key, cube, arrays)}
    cubes = {key: np.moveaxis(cube, 2, 0) if cube.shape[::2] in turned else cube for key, cube in cubes.items()}
    shapes = {key: cube.shape[:2] for key, cube in cubes.items()}
    chosen = _usual(shapes, lambda shape: _titles({key: cubes[key][0] for key in cubes if shapes[key] == shape}))
    return {key: cube for key, cube in cubes.items() if shapes[key] == chosen}


def _recordings(
    path: Path, arrays: Mapping[str, NDArray[Any]], cubes: Mapping[str, NDArray[Any]]
) -> Iterator[tuple[dict[str, NDArray[Any]], dict[str, str | float], int, tuple[str, ...]]]:
    """Columns, facts and number of each recording of arrays ``[recording, row, element]``, and what is left out."""
    count, rows = next(iter(cubes.values())).shape[:2]
    others = {key: array for key, array in arrays.items() if key not in cubes and array.ndim and _usable(array)}
    each = {**cubes, **{key: array for key, array in others.items() if array.shape == (count, rows)}}
    facts = {key: array for key, array in others.items() if array.shape == (count,)}
    shared = {key: array for key, array in others.items() if array.shape == (rows,) and rows != count}
    rest = tuple(key for key in others if key not in {*each, *facts, *shared})
    for number in range(count):
        own = {key: _fact(array[number]) for key, array in facts.items()}
        lengths = [fact for key, fact in own.items() if key.lower() in LENGTH_NAMES and isinstance(fact, float)]
        ends = [int(length) for length in lengths if length.is_integer() and 1 < length <= rows]
        cut = {key: array[number] for key, array in each.items()} | shared
        columns = _columns(path, {key: array[: ends[0]] if ends else array for key, array in cut.items()})
        yield columns, own, number, rest


def _of_one_length(arrays: Mapping[str, NDArray[Any]]) -> tuple[dict[str, NDArray[Any]], tuple[str, ...]]:
    """The arrays that are columns of one table, upright, and the names of the others; none without two rows."""
    numbers = {key: array for key, array in arrays.items() if array.dtype.kind in "fiub"} or arrays
    vectors = {array.size for array in numbers.values() if array.ndim in (1, 2) and array.size in array.shape}
    flat = {
        key: _upright(key, array, vectors) for key, array in arrays.items() if array.ndim in (1, 2) and _usable(array)
    }
    lengths = {key: len(flat[key]) for key in flat if key in numbers and len(flat[key]) > 1}
    rows = _usual(lengths, lambda length: _titles({key: flat[key] for key in lengths if lengths[key] == length}))
    chosen = {key: array for key, array in flat.items() if len(array) == rows}
    return chosen, tuple(key for key in flat if key not in chosen)


def _usual(lengths: Mapping[str, Any], titles: Callable[[Any], list[str]]) -> Any:
    """The length of the arrays of a wrench, else of forces, which need not be six, else the most frequent; None = none.

    ``titles`` gives the names of the columns of a length, which may be a pair of numbers of recordings and rows.
    """
    every = list(lengths.values())
    found = [length for length in set(every) if wrenches(titles(length))]
    found = found or [length for key, length in lengths.items() if has_forces(key)]
    return max(found or every, key=lambda length: (every.count(length), length), default=None)


def _left_out(arrays: tuple[str, ...]) -> tuple[str, ...]:
    """The note on arrays that are left out."""
    return (f"other-arrays:{len(arrays)}",) if arrays else ()


def titled(arrays: Mapping[str, NDArray[Any]]) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """The arrays, with a column for each name where a list of names belongs to the only table of as many columns.

    Where it belongs to an array ``[recording, row, column]``, this stays, and names of columns are a second result.

    >>> found, _ = titled({"data": np.zeros((9, 2)), "columns": np.array(["t", "Fz"])})
    >>> {name: array.shape for name, array in found.items()}
    {'t': (9,), 'Fz': (9,)}
    >>> titled({"data": np.zeros((4, 9, 2)), "columns": np.array(["t", "Fz"])})[1]
    {'data_0': 't', 'data_1': 'Fz'}
    """
    numeric = {name: one for name, one in arrays.items() if one.dtype.kind in "fiu" and one.ndim in (2, 3)}
    for key, array in arrays.items():
        texts = [str(text).strip() for text in plain(array.ravel()).tolist()] if array.dtype.kind in "US" else []
        named = array.size in array.shape and 1 < len(set(texts)) == len(texts) and not set(texts) & set(arrays)
        said = re.split(r"[\W_]", key.lower())[-1] in OF_COLUMNS
        if not named or not (said or wrenches(texts) or any(map(unit_of_time, texts))):
            continue
        tables = [
            name for name, one in numeric.items() if len(texts) in (one.shape if one.ndim == 2 else one.shape[2:])
        ]
        if len(tables) != 1:
            continue
        table, others = arrays[tables[0]], {name: one for name, one in arrays.items() if name != key}
        if table.ndim == 3:
            return others, {f"{tables[0]}_{number}": text for number, text in enumerate(texts)}
        table = table if table.shape[1] == len(texts) else table.T
        del others[tables[0]]
        return {**dict(zip(texts, table.T, strict=True)), **others}, {}
    return dict(arrays), {}


def _seconds(times: NDArray[Any]) -> NDArray[np.float64]:
    """Dates as seconds since 1970, or durations as seconds; a missing one is NaN."""
    fine = times.astype(f"{times.dtype.kind}8[ns]")
    return np.where(np.isnat(fine), np.nan, fine.astype(np.int64) * 1e-9)


def _newest(arrays: Mapping[str, NDArray[Any]]) -> tuple[dict[str, NDArray[Any]], dict[str, int]]:
    """The arrays, of those that hold the last samples at every time the newest sample alone, and how many these held.

    Such an array ``[time, sample, axis]`` repeats itself: each row is the one before without its oldest sample.
    """
    found, windows = dict(arrays), dict[str, int]()
    for key, array in arrays.items():
        if array.ndim == 3 and array.dtype.kind in "fiu" and min(array.shape[:2]) > 2 and len(array) > array.shape[1]:
            moved = all(np.array_equal(some[1:, :-1], some[:-1, 1:]) for some in (array[:3], array))
            if moved and (array != array[0, 0]).any():
                found[key], windows[key] = array[:, -1], array.shape[1]
    return found, windows


def _titles(arrays: Mapping[str, NDArray[Any]]) -> list[str]:
    """The names of the columns of numbers."""
    those = {key: array for key, array in arrays.items() if array.dtype.kind in "fiu"}
    wide = [f"{key}_{number}" for key, array in those.items() if array.ndim == 2 for number in range(array.shape[1])]
    return [key for key, array in those.items() if array.ndim == 1] + wide


def _are_matrices(cubes: Mapping[str, NDArray[Any]], arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Whether cubes are a matrix for every sample, and no recordings: beside a wrench, or a time of their length."""
    flat = {key: array for key, array in arrays.items() if array.ndim in (1, 2)}
    own = _titles({key: array for key, array in flat.items() if len(array) == len(next(iter(cubes.values())))})
    if wrenches(_titles({key: cube[0] for key, cube in cubes.items()})):
        return bool(wrenches(own))  # a time may be that of each recording
    return bool(wrenches(_titles(flat))) or any(map(unit_of_time, own))


def _lies(key: str, cube: NDArray[Any], arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Whether an array is ``[recording, element, row]``: rows are many, or elements those of a wrench beside more rows
    than recordings, of which there may be as many as facts."""
    count, elements, rows = cube.shape
    if not has_axes(key, elements) or has_axes(key, rows):
        return rows > 10 * elements and not has_axes(key, rows)
    timed = {array.size for name, array in arrays.items() if unit_of_time(name)}
    facts = {array.size for name, array in arrays.items() if array.ndim == 1} - timed
    return rows in timed or (count not in timed and rows not in facts and (rows > count or count in facts))


def _ends_in_recordings(key: str, cube: NDArray[Any], arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Whether an array is ``[row, element, recording]``: facts are as many as its last dimension, or nothing else has
    its rows, and a time or the elements of a wrench show them."""
    rows, elements, last = cube.shape
    if has_axes(key, last) and not has_axes(key, elements):
        return False  # as many numbers may be a vector in space
    flat = {name: array for name, array in arrays.items() if array.ndim in (1, 2)}
    counts = {len(array) for name, array in flat.items() if array.ndim == 1 and not unit_of_time(name)}
    if last in counts and rows not in counts:
        return True
    if any(rows in array.shape for name, array in flat.items() if not unit_of_time(name)):
        return False
    timed = {len(array) for name, array in flat.items() if unit_of_time(name)}
    forces, others = (bool(wrenches(f"{key}_{number}" for number in range(count))) for count in (elements, last))
    return elements not in timed and (forces > others or (rows in timed and (forces or elements != last)))


def _usable(array: NDArray[Any]) -> bool:
    return array.dtype.kind in "fiubUS"


def _upright(key: str, array: NDArray[Any], vectors: set[int]) -> NDArray[Any]:
    """Rows are time: by the axes of a wrench, as long as a vector is, or not ten times fewer than the axes."""
    if array.ndim == 1:
        return array
    if 1 in array.shape:
        return array.ravel()
    rows, columns = array.shape
    lies = columns in vectors if (columns in vectors) != (rows in vectors) else columns > 10 * rows
    if has_axes(key, rows) != has_axes(key, columns):
        lies = has_axes(key, rows)
    return array.T if lies else array


def _columns(path: Path, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {}
    for key, array in arrays.items():
        width = 1 if array.ndim == 1 else array.shape[1]
        if len(columns) + width > MAX_COLUMNS:
            raise InputError(f"{path} has more than {MAX_COLUMNS} columns; that is not a recording.")
        if array.ndim == 1:
            columns[key] = plain(array)
        else:
            columns |= {f"{key}_{number}": plain(array[:, number]) for number in range(width)}
    return columns


def plain(array: NDArray[Any]) -> NDArray[Any]:
    """A column ``[row]`` as float64 or text."""
    if array.dtype.kind in "fiu":
        return array.astype(np.float64)
    if array.dtype.kind == "S":
        return np.array([decoded(text) for text in array.tolist()], np.str_)
    return array.astype(np.str_)


def scalars_of(scalars: Mapping[str, NDArray[Any]]) -> tuple[float | None, dict[str, str | float]]:
    """Samples per second, if one of the single values ``[]`` states it or the time between samples, and the others.

    >>> scalars_of({"dt": np.array(0.01), "part": np.array("A")})
    (100.0, {'part': 'A'})
    """
    rate, within, facts = None, None, dict[str, str | float]()
    for key, value in scalars.items():
        if not _usable(value):
            continue
        fact = _fact(value[()])
        if stated := rate_of(re.split("[./]", key)[-1], fact):
            rate = stated
        else:
            facts[key] = fact
            within = within or (_control_rate(fact) if isinstance(fact, str) else None)
    return rate or within, facts


def _control_rate(text: str) -> float | None:
    """The rate of the controller in a JSON object such as ``env_args`` of robomimic; None = it states none."""
    found = _CONTROL.search(text[:LONGEST_TEXT]) if text.startswith("{") else None
    return float(found[1]) if found and 0 < float(found[1]) < np.inf else None


def _fact(value: Any) -> str | float:
    return str(decoded(value)) if isinstance(value, str | bytes) else float(value)
