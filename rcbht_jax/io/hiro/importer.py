"""Import of the HIRO data sets: folders of trials -> ``Recordings`` and a report of what was not imported.

Layout: DIR is a data set, or holds data sets; a data set holds one folder per trial; a trial holds
``R_Torques.dat`` (time Fx Fy Fz Mx My Mz) and, where recorded, ``R_State.dat``, ``R_Angles.dat`` and
``R_CartPos.dat``; ``L_`` files are the left arm.

Notes (semicolon-separated in ``Recordings.note``):
``state-file-missing``, ``state-file-unusable``, ``state-times-empty``, ``state-times-of-right-arm``,
``onset-beyond-end:S1=52.61`` (the mark is after the end: treated as missing), ``onset-before-start:..``,
``onset-at-end:S1`` (on the last sample: used), ``harmonised`` / ``harmonised-fallback`` (rotation boundary
moved, ``-from-pose`` when computed from R_CartPos), ``angles-missing``, ``angles-length:2060/3354``,
``clock-starts-at:..``, ``off-seat`` (a success whose part ended beside the seat), ``other-setup``, ``session-unknown``,
``deviation-unreadable``, ``deviation-suspect``, ``contradictory-duplicate:OTHER``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from rcbht_jax._util.digest import files_hash
from rcbht_jax._util.printable import spelled
from rcbht_jax._util.untrusted import MAX_TEXT_BYTES, leads_out
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.hiro.trial import ArmRecord, Report, data_file, read_trial
from rcbht_jax.robots.snap_assembly import FRAMES, snap_recordings
from rcbht_jax.types import Recordings

Progress = Callable[[list[Path]], Iterable[Path]]
LOGGED = "The wrench is as the robot logged it: not tared, filtered, resampled or rotated."
DT_EQUAL = 1e-3  # relative difference below which two time steps are the same


@dataclass
class ImportReport:
    """Result of an import. Paths are relative to the imported folder."""

    imported: list[str] = field(default_factory=list)  # set/trial/arm
    skipped: list[tuple[str, str]] = field(default_factory=list)  # path, reason
    warnings: list[tuple[str, str]] = field(default_factory=list)  # path, unusable file
    duplicates: list[tuple[str, str]] = field(default_factory=list)  # path of the copy, the original
    content_sha256: str = ""  # of every .dat file of the trials read

    def to_dict(self) -> dict[str, Any]:
        """The report as plain lists and strings."""
        return asdict(self)


def find_trials(directory: Path) -> list[tuple[str, Path]]:
    """(data set, trial folder) for every folder that can be a trial, sorted; links out of ``directory`` are none.

    Raises:
        InputError: ``directory`` is not a folder, is itself a trial, or holds no trial.
    """
    if not directory.is_dir():
        raise InputError(f"{directory} is not a folder; expected the folder of the data sets or one data set.")
    if _is_trial(directory):
        raise InputError(f"{directory} is a single trial; expected its parent folder, the data set.")
    children = _folders(directory, directory)
    if any(_is_trial(child) for child in children):
        return [(spelled(directory.resolve().name), child) for child in children]
    sets = [child for child in children if any(_is_trial(folder) for folder in _folders(child, directory))]
    if not sets:
        linked = "".join(f"; {spelled(link.name)} is a link out of the folder" for link in _links_out(directory)[:1])
        expected = "expected folders with R_Torques.dat inside, or folders of such"
        raise InputError(f"{directory} holds no trial; {expected}{linked}.")
    return [(spelled(child.name), folder) for child in sets for folder in _folders(child, directory)]


def read_hiro(directory: Path, progress: Progress = iter) -> tuple[Recordings, ImportReport]:
    """Read every trial under a folder; a broken one is reported and does not stop the import.

    Exact copies of a trial are imported once. Identical trials whose names contradict each other (outcome or
    deviation) are all imported, without failure type and deviation, and noted ``contradictory-duplicate:OTHER``.
    All recordings have one time step, the most frequent one; trials with another are skipped.

    >>> recordings, report = read_hiro(Path("hiro"))  # doctest: +SKIP

    Args:
        directory: the folder of the data sets, or one of them.
        progress: wraps the list of trial folders, for a progress bar.

    Raises:
        InputError: the folder holds no usable trial.
    """
    report = ImportReport()
    trials = find_trials(directory)

    def name(path: Path) -> str:
        return spelled(path.relative_to(directory))

    def into(problems: list[tuple[str, str]]) -> Report:
        # The report is stored: it must not contain folders of the importing machine.
        prefix = f"{directory}/"
        return lambda path, text: problems.append((name(path), spelled(text.replace(prefix, ""))))

    source_of = {folder: source for source, folder in trials}
    skip, warn = into(report.skipped), into(report.warnings)
    read = [read_trial(folder, source_of[folder], skip, warn) for folder in progress(list(source_of))]
    report.skipped += [(name(link), "is a link out of the folder.") for link in _links_out(directory)]
    records = _without_copies([arms for arms in read if arms], name, report)
    records = _same_time_step(records, name, report)
    if not records:
        first = f" The first reason: {report.skipped[0][1]}" if report.skipped else ""
        raise InputError(f"{directory} holds no usable trial.{first}")
    report.imported = [f"{name(record.folder)}/{record.arm}" for record in records]
    files = (path for folder in source_of for path in sorted(folder.glob("*.dat")) if _is_table(path, directory))
    report.content_sha256 = files_hash(directory, files)  # unreadable files are in the report already
    return _pack(records), report


def import_hiro(directory: Path, path: Path, overwrite: bool = False, progress: Progress = iter) -> ImportReport:
    """Read the folder of the HIRO data sets, or one of them, and write it as a store at ``path``.

    >>> report = import_hiro(Path("hiro"), Path("hiro.zarr"))  # doctest: +SKIP

    Raises:
        InputError: as :func:`read_hiro`, or ``path`` exists and ``overwrite`` is false.
    """
    store.check_target(path, overwrite)
    recordings, report = read_hiro(directory, progress)
    attrs = {
        "importer": "hiro",
        "frames": f"{LOGGED} {FRAMES}",
        "source_sha256": report.content_sha256,
        "import_report": report.to_dict(),
    }
    store.write_recordings(path, recordings, attrs, overwrite)
    return report


def _folders(directory: Path, root: Path) -> list[Path]:
    try:
        return sorted(child for child in directory.iterdir() if child.is_dir() and not leads_out(child, root))
    except OSError as error:
        raise InputError(f"{directory} cannot be read: {error.strerror}.") from error


def _links_out(directory: Path) -> list[Path]:
    """Folders of trials or data sets that are not in the folder, but somewhere else by a link."""
    children = sorted(child for child in directory.iterdir() if child.is_dir())
    inside = [child for child in children if not leads_out(child, directory)]
    below = [folder for child in inside for folder in sorted(child.iterdir()) if folder.is_dir()]
    return [folder for folder in (*children, *below) if leads_out(folder, directory)]


def _is_table(path: Path, root: Path) -> bool:
    """Whether a file may be a table: pipes and devices never end, a film takes long to read, a link may lead out."""
    return path.is_file() and path.stat().st_size <= MAX_TEXT_BYTES and not leads_out(path, root)


def _is_trial(folder: Path) -> bool:
    return any(data_file(folder, arm, "Torques") for arm in "RL")


def _without_copies(
    trials: list[list[ArmRecord]], name: Callable[[Path], str], report: ImportReport
) -> list[ArmRecord]:
    """Keep one of each group of identical trials per outcome and deviation; note groups with more than one."""
    groups: dict[tuple[tuple[str, str], ...], list[list[ArmRecord]]] = {}
    for arms in trials:
        groups.setdefault(tuple((record.arm, record.digest()) for record in arms), []).append(arms)
    originals_of_all: set[Path] = set()
    others: dict[Path, str] = {}
    for group in groups.values():
        originals: dict[object, Path] = {}
        for arms in group:
            first = arms[0]
            label = (first.name.outcome, first.name.deviation)
            if label in originals:
                text = f"exact copy of {name(originals[label])}; imported once."
                report.duplicates.append((name(first.folder), text))
            else:
                originals[label] = first.folder
        originals_of_all.update(originals.values())
        for folder in originals.values() if len(originals) > 1 else ():
            rest = [spelled(other.name) for other in originals.values() if other != folder]
            others[folder] = ",".join(rest).replace(";", ",")
            report.warnings.append((name(folder), f"identical to {', '.join(rest)}, whose name contradicts it."))
    return [
        _contradicted(record, others[record.folder]) if record.folder in others else record
        for arms in trials
        for record in arms
        if record.folder in originals_of_all
    ]


def _contradicted(record: ArmRecord, other: str) -> ArmRecord:
    """The record without failure type and deviation, because it is unknown which of the names is right."""
    name, notes = replace(record.name, failure_type=""), (*record.notes, f"contradictory-duplicate:{other}")
    return replace(record, name=name, deviation=np.full(3, np.nan), notes=notes)


def _same_time_step(records: list[ArmRecord], name: Callable[[Path], str], report: ImportReport) -> list[ArmRecord]:
    if not records:
        return []
    dt = Counter(round(record.table.dt, 6) for record in records).most_common(1)[0][0]
    same = []
    for record in records:
        if abs(record.table.dt - dt) <= DT_EQUAL * dt:
            same.append(record)
        else:
            reason = f"time step {record.table.dt:g} s; the other trials have {dt:g} s. Import it on its own."
            report.skipped.append((f"{name(record.folder)}/{record.arm}", reason))
    return same


def _pack(records: list[ArmRecord]) -> Recordings:
    length = np.array([len(record.table.time) for record in records], np.int32)
    wrench = np.zeros((len(records), int(length.max()), 6), np.float32)
    for row, record in zip(wrench, records, strict=True):
        row[: len(record.table.values)] = record.table.values
    names = [record.name for record in records]
    return snap_recordings(
        wrench,
        length,
        round(records[0].table.dt, 6),
        onset=np.stack([record.onset for record in records]),
        onset_harmonised=np.stack([record.onset_harmonised for record in records]),
        trial=np.array([record.trial for record in records], np.str_),
        arm=np.array([record.arm for record in records], np.str_),
        source=np.array([name.source for name in names], np.str_),
        session=np.array([name.session for name in names], np.str_),
        outcome=np.array([name.outcome for name in names], np.str_),
        failure_type=np.array([name.failure_type for name in names], np.str_),
        deviation=np.stack([record.deviation for record in records]),
        note=np.array([";".join(record.notes) for record in records], np.str_),
    )
