"""Text in blocks, as the UCI repository has "Robot Execution Failures": a line with a class, then rows of a wrench."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rcbht_jax._util.untrusted import MAX_LINE
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.cells import is_number
from rcbht_jax.io.importing.groups import MAX_GROUPS
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.unpacked import opened

COLUMNS = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")  # in the order of the donors' note; units are not documented


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
                    _check_rows(path, blocks[-1:])
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
    _check_rows(path, blocks[-1:])
    return blocks


def _check_rows(path: Path, last: list[tuple[str, list[list[float]]]]) -> None:
    for label, rows in last:
        if not rows:
            raise InputError(f"{path}: no row of six numbers follows the line {label[:30]!r}.")
