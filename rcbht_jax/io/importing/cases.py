"""Text of labelled series: files .ts of the libraries aeon and sktime, and blocks as the UCI repository has them.

A line of ``.ts`` is a case: its dimensions between colons, then its class. In the UCI's "Robot Execution Failures", a
line with a class stands before rows of a wrench.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.untrusted import MAX_COLUMNS, MAX_LINE
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.cells import is_number
from rcbht_jax.io.importing.rows import MAX_GROUPS
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.unpacked import opened

COLUMNS = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")  # in the order of the donors' note; units are not documented
MAX_CASE = 2**23  # bytes of the line of a case


def read_ts(path: Path, name: str) -> Iterator[Table]:
    """A table of each case, with columns dim_0, dim_1, ... and its class or target; the file states no rate.

    >>> text = "@problemName pokes\\n@classLabel true soft hard\\n@data\\n1,2,3:0,?,0:soft\\n"
    >>> _ = Path("pokes.ts").write_text(text)
    >>> [table] = read_ts(Path("pokes.ts"), "pokes.ts")
    >>> {key: values.tolist() for key, values in table.columns.items()}, table.facts
    ({'dim_0': [1.0, 2.0, 3.0], 'dim_1': [0.0, nan, 0.0]}, {'class': 'soft'})

    Raises:
        InputError: not a regular file, too large, no line @data, values with time stamps, or a case that contradicts
            the lines before @data; the sentence names the line.
    """
    cases: list[tuple[dict[str, NDArray[np.float64]], dict[str, str | float]]] = []
    with opened(path) as file:
        tags, before = _tags(path, file)
        for number, line in enumerate(iter(lambda: file.readline(MAX_CASE), b""), before + 1):
            try:
                if line.strip() and not line.startswith(b"#"):
                    cases.append(_case(line, tags))
            except ValueError as error:  # a UnicodeDecodeError, too
                raise InputError(f"{path}, line {number}: {error}.") from None
            if len(cases) > MAX_GROUPS:
                raise InputError(f"{path} has more than {MAX_GROUPS} cases; split it.")
    if not cases:
        raise InputError(f"{path} has no case below @data.")
    for place, (columns, facts) in enumerate(cases):
        yield Table(f"{name}#{place}", columns, facts=facts, part=str(place))


def _tags(path: Path, file: BinaryIO) -> tuple[dict[str, list[str]], int]:
    """The words of each line that begins with @, by the first, and the number of the line @data."""
    tags: dict[str, list[str]] = {}
    for number, line in enumerate(iter(lambda: file.readline(MAX_LINE), b""), 1):
        key, *words = line.decode("utf-8-sig", "replace").split() or ["#"]
        if key.lower() == "@data":
            if tags.get("@timestamps", [""])[0].lower() == "true":
                raise InputError(f"{path} has values with time stamps, which are not read; write it without them.")
            return tags, number
        if not key.startswith(("@", "#")) or len(line) == MAX_LINE:
            raise InputError(f"{path}, line {number}: expected a line that begins with @, and @data before the cases.")
        tags[key.lower()] = words
    raise InputError(f"{path} has no line @data; that is not a file of aeon or sktime.")


def _case(line: bytes, tags: Mapping[str, list[str]]) -> tuple[dict[str, NDArray[np.float64]], dict[str, str | float]]:
    """The dimensions of a case, and its class or target."""
    if len(line) == MAX_CASE:
        raise ValueError(f"the case has more than {MAX_CASE} bytes; split it")
    parts = line.strip().split(b":")
    facts: dict[str, str | float] = {}
    if tags.get("@classlabel", [""])[0].lower() == "true":
        facts["class"] = label = parts.pop().decode().strip()
        if label not in (known := tags["@classlabel"][1:]):
            raise ValueError(f"the class {label[:30]!r} is not one of @classLabel, {', '.join(known[:9])}")
    elif tags.get("@targetlabel", [""])[0].lower() == "true":
        target = parts.pop().decode().strip()
        if not is_number(target):
            raise ValueError(f"the target {target[:30]!r} is not a number")
        facts["target"] = float(target)
    if len(parts) > MAX_COLUMNS:
        raise ValueError(f"the case has {len(parts)} dimensions; expected at most {MAX_COLUMNS}")
    columns = {f"dim_{k}": _values(part, k) for k, part in enumerate(parts)}
    lengths = {len(values) for values in columns.values()}
    _compare("dimensions", [len(parts)], tags.get("@dimension") or tags.get("@dimensions"))
    _compare("values", sorted(lengths), tags.get("@serieslength"))
    if len(lengths) != 1:
        raise ValueError(f"the dimensions have {min(lengths, default=0)} to {max(lengths, default=0)} values")
    return columns, facts


def _compare(what: str, found: list[int], stated: Any) -> None:
    """Whether a case is as the lines before @data state; a line that is cut off is not."""
    if stated and stated[0].isdecimal() and int(stated[0]) > 0 and found != [int(stated[0])]:
        raise ValueError(f"the case has {' or '.join(map(str, found[:3]))} {what}; expected {int(stated[0])}")


def _values(part: bytes, dimension: int) -> NDArray[np.float64]:
    cells = part.replace(b"?", b"nan").decode("ascii", "replace")
    try:
        return np.loadtxt(io.StringIO(cells), delimiter=",", comments=None, ndmin=1) if cells.strip() else np.empty(0)
    except ValueError:
        stamps = " but one with its time stamp; write it without" if part.lstrip().startswith(b"(") else ""
        raise ValueError(f"a value of dimension {dimension} is not a number{stamps}") from None


def read_blocks(path: Path, name: str) -> Iterator[Table]:
    """A table of each block: rows of six numbers, and the line before them as its class; the file states no rate.

    >>> _ = Path("lp.data").write_text("normal\\n\\t1\\t2\\t3\\t4\\t5\\t6\\n\\t1\\t2\\t3\\t4\\t5\\t7\\n\\n")
    >>> [(table.facts["class"], table.columns["Tz"].tolist()) for table in read_blocks(Path("lp.data"), "lp.data")]
    [('normal', [6.0, 7.0])]

    Raises:
        InputError: not a regular file, too large, not UTF-8, or a line is neither a class nor six numbers.
    """
    for number, (label, rows) in enumerate(_blocks(path)):
        values = np.array(rows, np.float64)
        columns = {column: np.ascontiguousarray(values[:, k]) for k, column in enumerate(COLUMNS)}
        yield Table(f"{name}#{number}", columns, facts={"class": label}, part=str(number))


def _blocks(path: Path) -> list[tuple[str, list[list[float]]]]:
    blocks: list[tuple[str, list[list[float]]]] = []
    try:
        with opened(path) as file:
            for number, line in enumerate(iter(lambda: file.readline(MAX_LINE), b""), 1):
                where = f"{path}, line {number}"
                if len(line) == MAX_LINE:
                    raise InputError(f"{where} is too long; expected a class or six numbers.")
                cells = line.decode("utf-8-sig" if number == 1 else "utf-8").split()
                if len(cells) == 1 and not is_number(cells[0]):
                    blocks.append((cells[0], []))
                elif len(cells) == len(COLUMNS) and all(map(is_number, cells)) and blocks:
                    blocks[-1][1].append(list(map(float, cells)))
                elif cells:
                    raise InputError(f"{where} is neither a class nor, below one, a row of six numbers.")
                if len(blocks) > MAX_GROUPS:
                    raise InputError(f"{path} has more than {MAX_GROUPS} blocks; split it.")
    except UnicodeDecodeError:
        raise InputError(f"{where} is not UTF-8; expected a class or six numbers.") from None
    if not blocks:
        raise InputError(f"{path} is empty; expected lines with a class, and rows of six numbers below each.")
    if bare := next((label for label, rows in blocks if not rows), ""):
        raise InputError(f"{path}: no row of six numbers follows the line {bare[:30]!r}.")
    return blocks
