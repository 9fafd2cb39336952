"""Recordings as they were sampled -> a data set on one grid."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.printable import plural, spelled
from rcbht_jax.annotations import Annotations
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import conform
from rcbht_jax.io.importing.constants import at_once, still_axes
from rcbht_jax.io.importing.families import numbered
from rcbht_jax.io.importing.names import GROUPS, column_name
from rcbht_jax.io.importing.record import Record
from rcbht_jax.io.importing.report import ImportReport
from rcbht_jax.io.importing.unpacked import ENCODINGS
from rcbht_jax.io.importing.words import OUTCOMES
from rcbht_jax.io.importing.words import text as as_text
from rcbht_jax.io.store import VARIABLES
from rcbht_jax.types import STANDARD_COLUMNS, Recordings

MANY = 0.1  # share of the samples without a value above which a remark says so
SLOW, FAST = 2.5, 100_000  # samples per second: fewer may be those of a time in ms, more has no sensor of forces
_TAKEN = (*VARIABLES, "dt", "axis", "time", "axes", "units", "annotations", "columns", "rate")  # names of other things


def assemble(records: list[Record], source: Path, rate: float | None, report: ImportReport) -> Recordings:
    """The data set of recordings with the same axes; notes and report list what was changed.

    Args:
        records: at least one.
        source: where they come from; names the data set.
        rate: samples per second; None = that of most of them.
        report: gets the names of what is imported, and remarks.

    Raises:
        InputError: none can be brought onto the grid, or their rate is impossible.
    """
    clocks = [conform.clock(record.time) for record in records]
    period = conform.checked_period(1 / rate if rate else conform.common(clocks))
    odd = [(record.name, one.rate) for record, one in zip(records, clocks, strict=True) if not SLOW <= one.rate <= FAST]
    report.warnings += [(name, f"has {rate:.3g} samples per second. Is the unit of time right?") for name, rate in odd]
    why = "samples come in bursts; if they were taken evenly, --source-rate"
    bursts = [(record.name, one.rate) for record, one in zip(records, clocks, strict=True) if one.bursts]
    report.warnings += [(name, f"{why} {rate:.6g} replaces their stamps.") for name, rate in bursts]
    kept: list[Record] = []
    values: list[NDArray[np.float32]] = []
    for record, clock in zip(records, clocks, strict=True):
        try:
            wrench, flags = _moved(record, clock, period)
        except InputError as error:
            report.skipped.append((record.name, str(error)))
            continue
        record.notes.extend(flags)
        kept.append(record)
        values.append(wrench)
    if not kept:
        raise InputError(f"{source} holds no usable recording.{report.first_reason}")
    report.remarks += _remarks([note for record in kept for note in record.notes], period)
    report.remarks += still_axes(kept) + at_once(kept)
    report.remarks += _interpolated(kept)
    report.imported = [record.name for record in kept]
    _words(kept)
    columns = _columns(kept, source, report)
    marks = [(number, *interval) for number, record in enumerate(kept) for interval in record.intervals]
    recordings = Recordings.from_arrays(
        values, axes=kept[0].axes, units=kept[0].units, annotations=Annotations.from_rows(marks), **columns
    )
    return replace(recordings, dt=period)  # exact: the reciprocal of a rate need not be


def _moved(record: Record, clock: conform.Clock, period: float) -> tuple[NDArray[np.float32], list[str]]:
    """The values of a recording on the grid, and notes of how they came there."""
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused
        moved, flags = conform.on_grid(record.time, record.values, clock, period)
        wrench = moved.astype(np.float32)
    if not np.isfinite(wrench).all():
        raise InputError("a value is too large for single precision; scale the channel in a map.")
    return wrench, flags


def _remarks(notes: list[str], period: float) -> list[str]:
    """What was done to several recordings, from the notes of all."""
    found, counts = [], Counter(note.partition(":")[0] for note in notes)
    if uneven := counts["uneven"]:
        were = plural(uneven, "recording was", "recordings were")
        found.append(f"{were} not sampled evenly and interpolated at {1 / period:.6g} Hz.")
    if held := counts["held"]:
        found.append(f"{plural(held, 'log', 'logs')} held each value for several rows; the repeats were left out.")
    gaps = [float(note.removeprefix("gap:")) for note in notes if note.startswith("gap:")]
    if gaps:
        have = plural(len(gaps), "recording has", "recordings have")
        found.append(
            f"{have} times without samples, the longest of {max(gaps):.3g} s; straight lines stand there, which words "
            "describe as if they were measured."
        )
    origins = {
        "restarts": "tables in which the time starts anew.",
        "again": "tables in which values of the group come again after others; each stretch is one.",
    }
    for encoding, word in ENCODINGS.items():
        origins[encoding] = f"a file that is not UTF-8, read as {word}; if names are garbled, save it as UTF-8."
    for note, where in origins.items():
        if counts[note]:
            found.append(f"{plural(counts[note], 'recording is', 'recordings are')} from {where}")
    rates = Counter(f"{note.partition(':')[2]} Hz" for note in notes if note.startswith("resampled:"))
    if rates:
        listed = ", ".join(f"{rate} ({count})" for rate, count in rates.most_common(6))
        filtered = counts["filtered"]
        low = f"; {filtered} of them low-passed before, at {0.4 / period:.4g} Hz" if filtered else ""
        were = plural(rates.total(), "recording was", "recordings were")
        found.append(f"{were} resampled to {1 / period:.6g} Hz, from {listed}{low}.")
    return found


def _interpolated(records: list[Record]) -> list[str]:
    """A remark on recordings in which many samples had no value."""
    counts = [(int(note.removeprefix("missing:")), len(record.time))
              for record in records for note in record.notes if note.startswith("missing:")]  # fmt: skip
    shares = [missing / samples for missing, samples in counts if missing > MANY * samples]
    lack = plural(len(shares), "recording lacks", "recordings lack")
    found = f"{lack} values in many samples, up to {100 * max(shares, default=0):.0f} %"
    return [f"{found}; straight lines stand there, as if they were measured."] if shares else []


def _words(records: list[Record]) -> None:
    """Make a column that changes within any recording a track in all; a constant value spans the whole recording."""
    tracks = {track for record in records for track, *_ in record.intervals}
    for record in records:
        for name in tracks & set(record.columns):
            label = str(record.columns.pop(name))
            if label and not any(track == name for track, *_ in record.intervals):
                record.intervals.append((name, label, 0.0, record.end))


def _columns(records: list[Record], source: Path, report: ImportReport) -> dict[str, Any]:
    """Every column of the data set, names and sessions included."""
    owns = [{column_name(key): value for key, value in record.columns.items()} for record in records]
    names = dict.fromkeys(name for own in owns for name in own)
    columns: dict[str, Any] = {}
    for name in names:
        values = [own.get(name) for own in owns]
        target = f"c_{name}" if name in _TAKEN and name not in (*STANDARD_COLUMNS, "trial") else name
        if name in STANDARD_COLUMNS or name == "trial" or any(isinstance(value, str) for value in values):
            columns[target] = np.array(["" if value is None else as_text(value) for value in values], np.str_)
        else:
            columns[target] = np.array([np.nan if value is None else value for value in values], np.float64)
    folders = _folders(records)
    defaults: dict[str, list[str]] = {
        "trial": _trials(records),
        "arm": [record.arm or STANDARD_COLUMNS["arm"] for record in records],
        "source": [spelled(source.resolve().stem)] * len(records),
        "session": folders if any(folders) else [STANDARD_COLUMNS["session"]] * len(records),
        "outcome": [STANDARD_COLUMNS["outcome"]] * len(records),
        "note": [""] * len(records),
    }
    if any(folders) and "session" not in columns:
        report.remarks.append(f"The sessions are the sub-folders of {spelled(source.name)}: {len(set(folders))}.")
    if "outcome" not in columns and not all("changes:outcome" in record.notes for record in records):
        text = "No column states the outcome: it is unknown. Name one with --outcome or in a map."
        report.remarks += [text, *_outcome_folders(records)]
    words = sorted({str(word) for word in columns.get("outcome", [])} - {""})
    if words and not {"success", "failure"} & set(words):
        listed = ", ".join(words[:3]) + (", ..." if len(words) > 3 else "")
        report.remarks.append(f"No outcome is success or failure ({listed}); state in a map which words mean them.")
    for name, texts in defaults.items():
        given = columns.get(name, np.full(len(records), ""))
        columns[name] = np.where(given == "", texts, given).astype(np.str_)
    columns |= _names_apart(columns, defaults["trial"], report)
    notes = [
        ";".join(filter(None, [given.replace(";", ","), *record.notes]))  # a semicolon would begin another flag
        for given, record in zip(columns["note"].tolist(), records, strict=True)
    ]
    return {**columns, "note": np.array(notes, np.str_)}


def _names_apart(columns: dict[str, Any], files: list[str], report: ImportReport) -> dict[str, NDArray[np.str_]]:
    """Trials that tell the recordings of an arm apart, where the values of the files do not; these become a column."""
    trials, arms, sessions, sources = (columns[name].tolist() for name in ("trial", "arm", "session", "source"))
    within = [f"{session}/{trial}" for session, trial in zip(sessions, trials, strict=True)]
    candidates = {"": trials, "session and value": within, "file": files}
    keys = {how: zip(sources, own, arms, strict=True) for how, own in candidates.items()}
    how = next((how for how, own in keys.items() if len(set(own)) == len(trials)), "file")
    if not how:
        return {}
    report.remarks.append(
        f"Recordings have the same value of trial, so each is named by its {how}; the values are the column c_trial."
    )
    return {"trial": np.array(candidates[how], np.str_), "c_trial": columns["trial"]}


def _outcome_folders(records: list[Record]) -> list[str]:
    """How to take the outcome from folders, if those of one level have names of success and failure."""
    paths = [PurePosixPath(record.file).parent.parts for record in records]
    for level in range(1, min(map(len, paths), default=0) + 1):
        words = {path[level - 1]: OUTCOMES.get(path[level - 1].lower(), "") for path in paths}
        if set(words.values()) == {"success", "failure"}:
            meant = ", ".join(f'"{word}" = "{outcome}"' for word, outcome in sorted(words.items()))
            return [
                f"The folders {' and '.join(map(repr, sorted(words)))} may be outcomes, not sessions: for these, write "
                f"in a map [columns.outcome] with folder = {level} and words = {{{meant}}}."
            ]
    return []


def _folders(records: list[Record]) -> list[str]:
    """The folder of each recording; where every file has a folder of its own, that around it, if it is not a session.

    Folders directly in the source, with one file each, are trials if they are called so: trial_0, run_1, ...
    """
    files = {record.file: record.folder for record in records}
    outer = [str(PurePosixPath(record.folder).parent) for record in records]
    own = 1 < len(files) == len(set(files.values()))
    trials = all(numbered(folder.rstrip("0123456789")) in GROUPS for folder in files.values())
    if own and "." not in outer:
        return outer
    return [""] * len(records) if own and trials else [record.folder for record in records]


def _trials(records: list[Record]) -> list[str]:
    """Names without suffix, where that leaves them apart; topics of a bag and groups of a column arm share a trial."""
    short = []
    for record in records:
        stem = PurePosixPath(record.file).with_suffix("").as_posix()
        short.append("-".join(filter(None, [stem, record.trial_part])))
    pairs = Counter(zip(short, (record.arm for record in records), strict=True))
    if max(pairs.values()) > 1:
        return [record.name for record in records]
    return short
