"""``rcbht import``: files of any robot into a store."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from rcbht_jax._util.columns import with_units
from rcbht_jax._util.printable import plural
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, Flag, option, progress_bar, unset
from rcbht_jax.cli.store import listed

if TYPE_CHECKING:
    from rcbht_jax.io.importing.mapping import Mapping

MOST = 20  # lines of one list in the text
_HELP = """Import {what} into a store: a file, or a folder of files.

The meaning of columns is guessed from their names and shown in a table; --map states it instead, and --write-map
saves it for editing. All recordings get one uniform time grid. What is left out, and why, is reported; exact copies
are imported once. A folder of "rcbht export" is restored unchanged, but for labels and the table of
a simulation.

Example: rcbht import {kind} {example}"""


@dataclass(frozen=True)
class Import(Command):
    """Base of the commands that import files of one kind."""

    KIND: ClassVar[str] = "auto"
    source: Annotated[Path, tyro.conf.Positional, option("File, or folder of files.", metavar="SOURCE")]
    out: common.OutStore
    map: Annotated[Path | None, option("File that says what the columns mean.", "", metavar="FILE.toml")] = None
    write_map: Annotated[Path | None, option("File to save the meaning of columns in.", "", metavar="FILE.toml")] = None
    files: Annotated[str, unset("all of the kind", metavar="PATTERN")] = ""
    """Pattern of the files that are recordings, such as *_ft.csv."""
    rate: Annotated[float | None, option("Samples per second of the store.", "that of most recordings")] = None
    source_rate: Annotated[float | None, unset("the rate that a file states")] = None
    """Samples per second of files without time stamps."""
    tare: Annotated[float | None, option("Subtract the mean of this many seconds at the beginning.", "none")] = None
    group: Annotated[str, option("Column whose values separate the recordings of one file.", "")] = ""
    topic: Annotated[str, option("Topic of a bag.", "every topic of wrenches")] = ""
    labels: Annotated[str, option("Column that annotates the samples, with text or numbers.", "")] = ""
    outcome: Annotated[str, option("Column that states the outcome of a recording.", "")] = ""
    keep_copies: Flag = False
    """Import exact copies of other recordings as well, and note them."""
    overwrite: common.Overwrite = False

    def run(self) -> dict[str, Any]:
        from rcbht_jax.errors import InputError
        from rcbht_jax.io.importing.importer import import_source
        from rcbht_jax.io.importing.mapping import write_mapping
        from rcbht_jax.io.summary import summary_of

        if self.write_map is not None and self.write_map.exists():
            raise InputError(f"{self.write_map} exists already; choose another name, or move it away.")
        imported = import_source(
            self.source, self.out, self.KIND, self._mapping(), self.overwrite,
            lambda items: progress_bar("import", "files", iterable=items), self.keep_copies,
        )  # fmt: skip
        if self.write_map is not None:
            write_mapping(self.write_map, imported.mapping)
        recordings = imported.recordings
        return {
            "store": str(self.out),
            "recordings": len(recordings),
            "rate": 1 / recordings.dt,
            "axes": dict(zip(recordings.axes, recordings.units, strict=True)),
            "tracks": {track: list(names) for track, names in recordings.annotations.labels.items()},
            "columns": list(recordings.columns),
            "notes": dict(sorted(summary_of(recordings)["notes"].items())),
            **imported.report.to_dict(),
        }

    def _mapping(self) -> Mapping:
        """The mapping file with the options in place of what it says."""
        from rcbht_jax.io.importing.guess import outcome_words
        from rcbht_jax.io.importing.mapping import Mapping, Track, Value, read_mapping

        mapping = read_mapping(self.map) if self.map else Mapping()
        given = {name: getattr(self, name) for name in ("rate", "source_rate", "tare", "group", "topic")}
        mapping = replace(mapping, **{name: value for name, value in given.items() if value not in (None, "")})
        if self.files:
            mapping = replace(mapping, files=(self.files,))
        if self.labels:
            mapping = replace(mapping, annotations=(Track(self.labels, self.labels),))
        if self.outcome:
            listed = any(value.table == self.outcome for value in mapping.columns.values())  # not in the recordings
            column, table = ("", self.outcome) if listed else (self.outcome, "")
            outcome = Value(column, table, words=outcome_words(self.outcome))
            mapping = replace(mapping, columns={**mapping.columns, "outcome": outcome})
        return mapping

    def text(self, result: dict[str, Any]) -> str:
        count = plural(result["recordings"], "recording")
        lines = [f"{count} at {result['rate']:g} Hz in {result['store']}", f"axes: {with_units(result['axes'])}"]
        lines += [f"annotations {track}: {', '.join(names[:MOST])}" for track, names in result["tracks"].items()]
        if result["columns"]:
            lines.append(f"columns: {', '.join(result['columns'])}")
        if result["understood"]:
            width = max(len(row["column"]) for row in result["understood"])
            lines += ["", f"{'column':{max(width, 6)}}  understood as"]
            for row in result["understood"]:
                unit = f" ({row['unit']})" if row["unit"] else ""
                lines.append(f"{row['column'] or '(no name)':{max(width, 6)}}  {row['role']}{unit}")
            lines.append("")
        lines += result["remarks"]
        if result["notes"]:
            lines.append("notes: " + ", ".join(f"{flag} {count}" for flag, count in result["notes"].items()))
        for title, key in (("left out", "skipped"), ("copies", "duplicates"), ("warnings", "warnings")):
            lines += listed(title, result[key], MOST)
        return "\n".join(lines)


def _command(kind: str, what: str, example: str) -> type[Import]:
    """The command that imports files of one kind."""
    text = _HELP.format(kind=kind, what=what, example=example)
    members = {"__doc__": text, "__module__": __name__, "KIND": kind}
    return dataclass(frozen=True)(type(f"Import{kind.capitalize()}", (Import,), members))


ImportAuto = _command("auto", "files of any kind, recognised by their suffix,", "recordings recordings.zarr")
ImportCsv = _command("csv", "tables as text (.csv, .tsv, .txt, .dat)", "runs runs.zarr")
ImportParquet = _command("parquet", "Parquet and Arrow tables (.parquet, .feather, .arrow)", "runs runs.zarr")
ImportNpz = _command("npz", "NumPy arrays (.npz, .npy)", "runs runs.zarr --source-rate 500")
ImportHdf5 = _command("hdf5", "HDF5 files", "demos.hdf5 demos.zarr")
ImportMatlab = _command("matlab", "MATLAB files", "runs runs.zarr")
ImportMcap = _command("mcap", "MCAP files", "run.mcap run.zarr --topic /wrench")
ImportBag = _command("bag", "bags of ROS 1 and ROS 2", "bags bags.zarr")
ImportLerobot = _command("lerobot", "LeRobot data sets of versions 2 and 3", "pusht pusht.zarr")
ImportJson = _command("json", "JSON documents (.json): lists of samples, or a list per column,", "runs runs.zarr")
ImportJsonl = _command("jsonl", "JSON lines (.jsonl, .ndjson), such as a robot streams,", "readings.jsonl runs.zarr")
ImportZarr = _command("zarr", "Zarr groups (folders, .zarr.zip) with an array episode_ends,", "buffer.zarr runs.zarr")
ImportTs = _command("ts", "files of aeon and sktime (.ts)", "failures.ts failures.zarr --source-rate 50")
ImportUci = _command(
    "uci", 'the files of the UCI set "Robot Execution Failures"', "lp1.data lp1.zarr --source-rate 47.619"
)
