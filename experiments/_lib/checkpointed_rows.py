"""Rows of a result, stored one by one, so that an interrupted experiment resumes."""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import tyro
from tqdm import tqdm

import rcbht_jax
from experiments._lib.results_io import defaults_of, given, record_of, write_result

Only = Annotated[tuple[str, ...], tyro.conf.arg(help="Make the rows whose names contain one of these; others stay.")]
ALL_ROWS = ("",)


def command_of(main: Callable[..., None], values: Mapping[str, Any], *paths: str) -> str:
    """The command that makes all rows: the module of ``main``, its ``paths``, and every option but ``only``."""
    options = given(values, {name: None for name in defaults_of(main) if name != "only"})
    return " ".join(["python -m", inspect.getmodule(main).__spec__.name, *paths]) + options  # type: ignore[union-attr]


class Rows:
    """The rows of ``experiments/results/<name>.json``; those made in the same way are kept: a run resumes.

    If ``about``, the facts on all rows (JSON values), or the seed differ, all rows are made again.
    """

    def __init__(self, name: str, command: str, about: Mapping[str, Any], seed: int) -> None:
        self.name, self.command, self.about, self.seed = name, command, dict(about), seed
        self.done: dict[str, Any] = {}
        record = record_of(name)
        result = dict(record.get("result", {}))
        rows = result.pop("rows", {})
        result.pop("complete", None)
        known = (record.get("rcbht_jax_version"), record.get("seed"), result)
        if known == (rcbht_jax.__version__, seed, json.loads(json.dumps(self.about))):
            self.done = rows

    def fill(self, wanted: Mapping[str, Callable[[], Any]], only: Sequence[str] = ALL_ROWS) -> None:
        """Make the rows that are missing, in order; each is on disk before the next is begun.

        Rows are JSON values, and all that are ``wanted`` make the result complete. Only rows whose names contain one
        of the texts ``only`` are made now.
        """
        missing = [row for row in wanted if row not in self.done and any(text in row for text in only)]
        with tqdm(missing, desc=self.name, unit="row", file=sys.stderr, disable=None) as bar:
            for row in bar:
                bar.set_postfix_str(row)
                self.done[row] = wanted[row]()
                self._keep(wanted)
        if not missing:
            self._keep(wanted)

    def _keep(self, wanted: Mapping[str, Any]) -> None:
        rows = {row: self.done[row] for row in wanted if row in self.done}
        result = self.about | {"complete": len(rows) == len(wanted), "rows": rows}
        write_result(self.name, self.command, result, self.seed, show=False)
