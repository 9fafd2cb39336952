"""``rcbht import hiro`` and ``rcbht info``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from rcbht_jax._util.columns import with_units
from rcbht_jax._util.printable import padded, plural, room
from rcbht_jax._util.untrusted import checked_number
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, Flag, Folder, option, progress_bar, unset

FIRST = 5  # trials whose names are shown


@dataclass(frozen=True)
class ImportHiro(Command):
    """Import recorded trials of the HIRO robot (folders of R_Torques.dat and its companions) into a store.

    Broken trials are reported and left out; exact copies are imported once.

    Example: rcbht import hiro path/to/hiro hiro.zarr
    """

    directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Folder of the data sets, or one data set."""
    out: common.OutStore
    overwrite: common.Overwrite = False

    FORMER: ClassVar[dict[str, str]] = {"-o": "", "--out": ""}

    def run(self) -> dict[str, Any]:
        from rcbht_jax.io.hiro.importer import import_hiro

        report = import_hiro(
            self.directory, self.out, self.overwrite, lambda folders: progress_bar("import", "trials", iterable=folders)
        )
        return {"store": str(self.out), **report.to_dict()}

    def text(self, result: dict[str, Any]) -> str:
        sets = Counter(name.rsplit("/", 2)[0] for name in result["imported"] if name.count("/") > 1)
        lines = [f"{plural(len(result['imported']), 'recording')} in {result['store']}"]
        lines += [f"  {count:5d}  {source}" for source, count in sorted(sets.items())]
        for title, key in (("left out", "skipped"), ("exact copies", "duplicates"), ("warnings", "warnings")):
            lines += listed(title, result[key])
        return "\n".join(lines)


def listed(title: str, rows: list[tuple[str, str]], most: int | None = None) -> list[str]:
    """Lines of what an import reports of files, beyond ``most`` of them only how many; --json gives all."""
    lines = [f"{title}: {len(rows)}"] * bool(rows)
    for path, reason in rows[:most]:
        lines.append(f"  {reason}" if reason.startswith(path) else f"  {path}: {reason}")  # messages of the parser
    rest = len(rows[:most]) < len(rows)
    return [*lines, *[f"  ... and {len(rows) - len(rows[:most])} more; --json lists them all"] * rest]


@dataclass(frozen=True)
class Join(Command):
    """Join several stores into one, for example recorded and simulated trials that are to train together.

    The stores need the same axes, units and sampling rate. Annotations and columns are kept; label tracks and the
    parameters of simulations are not: encode the new store. Of exact copies, one is kept. A sensor that was not tared
    reads an offset in free space that simulated sensors lack: use --tare 1.

    Example: rcbht join hiro.zarr trials.zarr -o both.zarr --tare 1
    """

    stores: Annotated[tuple[Path, ...], tyro.conf.Positional, unset(metavar="STORE.zarr STORE.zarr"), common.STORE]
    """Stores to read, two or more."""
    out: Annotated[Path, option("Store to create.", aliases=["-o"], metavar="OUT.zarr"), Folder()]
    tare: float = 0.0
    """Subtract the mean of this many seconds at the beginning of each recording; 0 = nothing."""
    overwrite: common.Overwrite = False

    def run(self) -> dict[str, Any]:
        from rcbht_jax.io.joining import join_stores

        joined = join_stores(self.stores, self.out, tare_seconds=self.tare, overwrite=self.overwrite)
        return {"store": str(self.out), "taken": joined.taken, "copies": joined.copies}

    def text(self, result: dict[str, Any]) -> str:
        lines = [f"{plural(sum(result['taken'].values()), 'recording')} in {result['store']}"]
        for name, count in result["taken"].items():
            left = result["copies"][name]
            lines.append(
                f"  {count:5d}  {name}" + (f" ({plural(left, 'exact copy', 'exact copies')} left out)" if left else "")
            )
        return "\n".join(lines)


@dataclass(frozen=True)
class Info(Command):
    """Summarise a store: recordings by source, session and outcome, names, annotations, columns, tasks, label tracks.

    A small store is read whole, which verifies its checksums, and its tasks are examined. For a store larger
    than 256 MiB, only the counts made when it was written and the names of the first trials are shown; --check reads
    all of it, part by part. If a store is still being written, the recordings written so far are described. --json
    lists the names of all trials of a small store.

    Example: rcbht info hiro.zarr
    """

    store: common.Store
    """Store to describe."""
    check: Flag = False
    """Read all of the store, of any size, and compare it with its checksums."""

    def run(self) -> dict[str, Any]:
        from rcbht_jax.cli.learning import table_and_facts
        from rcbht_jax.io.label_store import list_tracks
        from rcbht_jax.io.store import SMALL_BYTES, progress_of, read_attrs, read_summary, verify
        from rcbht_jax.io.store_reader import first_trials
        from rcbht_jax.io.summary import summary_of
        from rcbht_jax.learning.confounds import examined
        from rcbht_jax.learning.task_choice import task_names
        from rcbht_jax.learning.tasks import TaskSpec

        there, expected, axes, size = progress_of(self.store)
        attrs, tasks, verified = read_attrs(self.store), dict[str, Any](), self.check
        if self.check:
            verify(self.store)
        if small := there == expected and size <= SMALL_BYTES:
            recordings, facts = table_and_facts(self.store)
            summary, verified = summary_of(recordings), True
            trials = list(dict.fromkeys(recordings.trial.tolist()))
            found = {name: examined(recordings, TaskSpec(name), facts) for name in task_names(recordings)}
            tasks = {
                name: {"classes": classes, "sentences": texts + rest} for name, (classes, texts, rest) in found.items()
            }
        else:
            summary, trials = read_summary(self.store), first_trials(self.store, FIRST)
        dt = checked_number(f"{self.store}: dt", attrs["dt"])
        return {
            "store": str(self.store),
            "recordings": there,
            "expected": expected,
            "verified": verified,
            "dt": dt,
            "axes": axes,
            "trials": trials,
            "all_trials": small or there <= FIRST,
            "groups": [_group(group, dt) for group in summary["groups"]],
            "annotations": summary["annotations"],
            "columns": {name: _column(values) for name, values in summary["columns"].items()},
            "tasks": tasks,
            "notes": dict(sorted(summary["notes"].items())),
            "label_tracks": list_tracks(self.store),
            "created": attrs["created"],
            "rcbht_jax_version": attrs["rcbht_jax_version"],
            "content_sha256": attrs.get("content_sha256"),
        }

    def text(self, result: dict[str, Any]) -> str:
        count = plural(result["recordings"], "recording")
        head = f"{result['store']}: {count} of {with_units(result['axes'])} at {1 / result['dt']:g} Hz"
        if result["content_sha256"] is None:
            head += f"\n{result['recordings']} of {plural(result['expected'], 'recording')}; still being written"
        elif not result["verified"]:
            head += "\nlarge: checksums not compared, tasks not examined; --check compares the checksums"
        elif self.check:
            head += "\nevery checksum is right"
        lines = [head, f"created: {result['created']}, by rcbht-jax {result['rcbht_jax_version']}", ""]
        keys = ("source", "session", "outcome", "arm")
        rows = [keys, *(tuple(str(group[key]) for key in keys) for group in result["groups"])]
        wide = [max(map(room, column)) for column in zip(*rows, strict=True)]
        seconds = ["{:7.2f} {:7.2f} {:7.2f}".format(*group["seconds"]) for group in result["groups"]]
        sizes = [f"{group['recordings']:5d}" for group in result["groups"]]
        for row, count, times in zip(rows, ["count", *sizes], [" seconds (min/median/max)", *seconds], strict=True):
            names = " ".join(padded(text, width) for text, width in zip(row, wide, strict=True))
            lines.append(f"{names}  {count}  {times}")
        if shown := result["trials"][:FIRST]:
            more, others = len(result["trials"]) - len(shown), "" if result["all_trials"] else ", ..."
            lines.append(f"trials: {', '.join(shown)}" + (f" and {more} more" if more else others))
        lines += [f"annotations {track}: {_counts(labels)}" for track, labels in result["annotations"].items()]
        lines += [f"column {name}: {values}" for name, values in result["columns"].items()]
        for name, task in result["tasks"].items():
            counts = ", ".join(f"{label} ({count})" for label, count in task["classes"].items())
            lines.append(f"task {name}: {counts or 'not possible'}")
            lines += [f"  {sentence}" for sentence in task["sentences"]]
        notes = ", ".join(f"{flag} {count}" for flag, count in result["notes"].items())
        tracks = ", ".join(result["label_tracks"]) or f'none; make them with "rcbht encode {result["store"]}"'
        return "\n".join([*lines, "", f"notes: {notes or 'none'}", f"label tracks: {tracks}"])


def _group(group: list[Any], dt: float) -> dict[str, Any]:
    """One row of the summary."""
    from rcbht_jax.io.summary import quantiles

    *key, lengths = group
    return {
        **dict(zip(("source", "session", "outcome", "arm"), key, strict=True)),
        "recordings": sum(lengths.values()),
        "seconds": [round(samples * dt, 6) for samples in quantiles(lengths)],
    }


def _counts(labels: dict[str, list[int]]) -> str:
    return ", ".join(f"{label} ({count} in {plural(rows, 'recording')})" for label, (count, rows) in labels.items())


def _column(found: dict[str, Any]) -> str:
    """Values of a column in a few words."""
    if "numbers" in found:
        low, high = found["range"] or (0.0, 0.0)
        return f"{found['numbers']} numbers" + (f", {low:g} to {high:g}" if found["range"] else "")
    if found["texts"] is None:
        return "texts, most of them different"
    counts = Counter(found["texts"])
    shown = ", ".join(f"{text} ({count})" for text, count in counts.most_common(8))
    return (shown or "empty") + (f", {len(counts) - 8} more" if len(counts) > 8 else "")
