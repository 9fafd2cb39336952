"""What a mapping names and tables do not have: columns, arms, and words in columns."""

from __future__ import annotations

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.record import no_column
from rcbht_jax.io.importing.rows import filled
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.words import OUTCOMES, text, words_of_numbers


class Lacks:
    """Tables without a column of annotations, or one that describes recordings: these are imported without it."""

    def __init__(self, mapping: Mapping) -> None:
        """Take the mapping of all tables."""
        tracks = {track.column: f"annotations {track.track}" for track in mapping.annotations if track.column}
        facts = {value.column: f"column {name}" for name, value in mapping.columns.items() if value.column}
        self._roles, self._held, self._folded = tracks | facts, set[str](), set(facts)
        self._unread: dict[str, str] = {}  # column -> a table that has it and from which no recording was read
        self._folders = {name: value for name, value in mapping.columns.items() if value.folder}
        self._strange = {name: set(value.words) - set(OUTCOMES) for name, value in self._folders.items()}
        self._lacking: list[tuple[str, str, str, str]] = []  # table, what it lacks, sentence, warning
        words = {track.column: {*track.words, *track.ignore} for track in mapping.annotations if track.column}
        words |= {value.column: set(value.words) - set(OUTCOMES) for value in mapping.columns.values() if value.column}
        self._unmatched = {column: those for column, those in words.items() if those}
        self._arms = {arm.lower(): arm for arm in mapping.arms}  # that no table has

    def add(self, table: Table, read: bool = True) -> None:
        """Take a table, and whether recordings were read from it."""
        self._arms.pop(str(table.facts.get("arm", "")).lower(), None)
        for column, role in self._roles.items():
            if (column in table.columns or column in table.facts) and read:
                self._held.add(column)
            elif column in table.columns:
                self._unread.setdefault(column, table.name)
            elif read:
                warning = f"has no column {column!r}, so no {role}."
                self._lacking.append((table.name, column, no_column(table, column), warning))
        for name, value in self._folders.items():
            what = f"folder {value.folder}"
            if folder := value.folder_of(table.file):
                self._held.add(what)
                self._strange[name].difference_update((folder, folder.lower()))
            elif read:
                lies = f"lies in no {what} of the source, so no column {name}."
                self._lacking.append((table.name, what, f"{table.name} {lies}", lies))
        for column, words in self._unmatched.items():
            values = table.columns.get(column)
            there = [table.facts.get(column, "")] if values is None else set(values[filled(values)].tolist())
            seen = {text(value) for value in there}
            seen |= {value.lower() for value in seen if column in self._folded}  # labels are taken as they are written
            words -= {word for word in words if not seen.isdisjoint(words_of_numbers({word: word}))}

    def warnings(self) -> list[tuple[str, str]]:
        """A warning about each table that lacks a column, or lies in no folder that names one.

        Raises:
            InputError: no table has the column, or lies in such a folder.
        """
        alone = {column: name for column, name in self._unread.items() if column not in self._held}
        if wrong := next((sentence for _, what, sentence, _ in self._lacking if what not in {*self._held, *alone}), ""):
            raise InputError(wrong)
        how = "if its rows describe the recordings, add a column 'file' with their names."
        found = [
            (name, f"alone has a column {column!r} and is no recording, so no {self._roles[column]}; {how}")
            for column, name in alone.items()
        ]
        return found + [(name, warning) for name, what, _, warning in self._lacking if what not in alone]

    def remarks(self) -> list[str]:
        """Remarks on words and arms of the mapping that no table has."""
        wrong = {f"are no values of column {column!r}": words for column, words in self._unmatched.items()}
        wrong |= {f"for column {name} are no folders": words for name, words in self._strange.items()}
        pairs = ((what, ", ".join(map(repr, sorted(words)))) for what, words in wrong.items() if words)
        found = [f"These words of the map {what}: {several}." for what, several in pairs]
        arms = ", ".join(map(repr, self._arms.values()))
        return [*found, *([f"No column names these arms of the map: {arms}."] if arms else [])]
