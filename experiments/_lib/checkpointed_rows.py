"""Rows of a result kept one by one, so that an interrupted experiment goes on where it stopped."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from typing import Any

from tqdm import tqdm

import rcbht_jax
from experiments._lib.results_io import RESULTS, write_result


class Rows:
    """The rows of ``experiments/results/<name>.json``, which are kept if they were made in the same way.

    Args:
        name: of the result.
        command: that makes it.
        about: what holds for all rows (JSON values); rows made with another one are made anew.
        seed: of the experiment.
    """

    def __init__(self, name: str, command: str, about: Mapping[str, Any], seed: int) -> None:
        self.name, self.command, self.about, self.seed = name, command, dict(about), seed
        self.done: dict[str, Any] = {}
        path = RESULTS / f"{name}.json"
        record = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        result = dict(record.get("result", {}))
        rows = result.pop("rows", {})
        result.pop("complete", None)
        known = (record.get("rcbht_jax_version"), record.get("seed"), result)
        if known == (rcbht_jax.__version__, seed, json.loads(json.dumps(self.about))):
            self.done = rows

    def fill(self, wanted: Mapping[str, Callable[[], Any]], only: Callable[[str], bool] = lambda row: True) -> None:
        """Make the rows that are missing, in order; each is on disk before the next is begun.

        Args:
            wanted: how to make each row (JSON values); all of them together are the complete result.
            only: which to make now.
        """
        self.done = {row: self.done[row] for row in wanted if row in self.done}
        missing = [row for row in wanted if row not in self.done and only(row)]
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
