"""Columns of a mapping that some tables lack."""

from __future__ import annotations

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.record import no_column
from rcbht_jax.io.importing.table import Table


class Lacks:
    """Tables without a column of annotations, or one that describes recordings: these are imported without it."""

    def __init__(self, mapping: Mapping) -> None:
        """Take the mapping of all tables."""
        tracks = {track.column: f"annotations {track.track}" for track in mapping.annotations if track.column}
        facts = {value.column: f"column {name}" for name, value in mapping.columns.items() if value.column}
        self._roles, self._held = tracks | facts, set[str]()
        self._lacking: list[tuple[str, str, str]] = []  # table, column, sentence

    def add(self, table: Table) -> None:
        """Take a table from which recordings were read."""
        for column in self._roles:
            if column in table.columns or column in table.facts:
                self._held.add(column)
            else:
                self._lacking.append((table.name, column, no_column(table, column)))

    def warnings(self) -> list[tuple[str, str]]:
        """A warning about each table that lacks a column.

        Raises:
            InputError: no table has the column.
        """
        if wrong := next((sentence for _, column, sentence in self._lacking if column not in self._held), ""):
            raise InputError(wrong)
        return [(name, f"has no column {column!r}, so no {self._roles[column]}.") for name, column, _ in self._lacking]
