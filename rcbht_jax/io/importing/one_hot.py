"""Labels in a column of 0 and 1 for each."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.io.importing.guess import some
from rcbht_jax.io.importing.table import Table


def one_hot(table: Table) -> list[str]:
    """A remark on each run of columns of 0 and 1 of which just one is 1 in every row: a label for each.

    >>> columns = {"t": np.arange(4.0), "free": np.array([1.0, 1, 0, 0]), "push": np.array([0.0, 0, 1, 1])}
    >>> one_hot(Table("a.csv", columns))[0][:57]
    "'free', 'push' look like labels, of which one is 1 in eac"
    """
    found = []
    for flags, run in groupby(table.columns, lambda name: _is_of_flags(table.columns[name])):
        listed = list(run)
        if flags and len(listed) > 1 and (np.sum([table.columns[name] for name in listed], 0) == 1).all():
            first = next((name for name in listed if 0 < table.columns[name].sum() < len(table.columns[name])), "")
            how = (
                f'[[annotations]] with track = "label", column = "{first}", words = {{"1" = "{first}"}}, ignore = ["0"]'
            )
            text = f"{some(listed)} look like labels, of which one is 1 in each row; a map reads each column by {how}."
            found += [text] if first else []
    return found


def _is_of_flags(values: NDArray[Any]) -> bool:
    """Whether a column holds nothing but 0 and 1."""
    return values.dtype.kind != "U" and bool(((values == 0) | (values == 1)).all())
