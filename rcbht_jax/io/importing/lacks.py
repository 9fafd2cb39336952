"""What a mapping names and tables do not have: columns, arms, and words in columns."""

from __future__ import annotations

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.record import no_column
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.topics import filled
from rcbht_jax.io.importing.words import OUTCOMES, text, words_of_numbers


class Lacks:
    """Tables without a column of annotations, or one that describes recordings: these are imported without it."""

    def __init__(self, mapping: Mapping) -> None:
        """Take the mapping of all tables."""
        tracks = {track.column: f"annotations {track.track}" for track in mapping.annotations if track.column}
        facts = {value.column: f"column {name}" for name, value in mapping.columns.items() if value.column}
        self._roles, self._held, self._folded = tracks | facts, set[str](), set(facts)
        self._lacking: list[tuple[str, str, str]] = []  # table, column, sentence
        words = {track.column: {*track.words, *track.ignore} for track in mapping.annotations if track.column}
        words |= {value.column: set(value.words) - set(OUTCOMES) for value in mapping.columns.values() if value.column}
        self._unmatched = {column: those for column, those in words.items() if those}
        self._arms = {arm.lower(): arm for arm in mapping.arms}  # that no table has

    def add(self, table: Table, read: bool = True) -> None:
        """Take a table, and whether recordings were read from it."""
        self._arms.pop(str(table.facts.get("arm", "")).lower(), None)
        for column in self._roles:
            if column in table.columns or column in table.facts:
                self._held.add(column)
            elif read:
                self._lacking.append((table.name, column, no_column(table, column)))
        for column, words in self._unmatched.items():
            values = table.columns.get(column)
            there = [table.facts.get(column, "")] if values is None else set(values[filled(values)].tolist())
            seen = {text(value) for value in there}
            seen |= {value.lower() for value in seen if column in self._folded}  # labels are taken as they are written
            words -= {word for word in words if not seen.isdisjoint(words_of_numbers({word: word}))}

    def warnings(self) -> list[tuple[str, str]]:
        """A warning about each table that lacks a column.

        Raises:
            InputError: no table has the column.
        """
        if wrong := next((sentence for _, column, sentence in self._lacking if column not in self._held), ""):
            raise InputError(wrong)
        return [(name, f"has no column {column!r}, so no {self._roles[column]}.") for name, column, _ in self._lacking]

    def remarks(self) -> list[str]:
        """Remarks on words and arms of the mapping that no table has."""
        listed = {column: ", ".join(map(repr, sorted(words))) for column, words in self._unmatched.items() if words}
        found = [
            f"These words of the map are no values of column {column!r}: {words}." for column, words in listed.items()
        ]
        arms = ", ".join(map(repr, self._arms.values()))
        return [*found, *([f"No column names these arms of the map: {arms}."] if arms else [])]
