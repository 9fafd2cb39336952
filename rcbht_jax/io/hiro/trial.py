"""One trial folder of the authors' layout -> one record per arm.

Only a broken wrench table loses an arm; a broken state, angle or pose file costs what depends on it and is
noted.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.digest import content_hash
from rcbht_jax.errors import InputError
from rcbht_jax.io.hiro import dat, onsets
from rcbht_jax.io.hiro.names import TrialName, parse_trial
from rcbht_jax.robots import kinematics

ARMS = ("R", "L")
Complain = Callable[[Path, str], None]  # called with a path and what is wrong with it


@dataclass(frozen=True)
class ArmRecord:
    """One arm of one trial, as read."""

    folder: Path
    trial: str
    arm: str
    name: TrialName
    table: dat.TimedTable
    onset: NDArray[np.float64]  # [4] s, NaN = missing
    onset_harmonised: NDArray[np.float64]  # [4] s
    deviation: NDArray[np.float64]  # [3] m, m, rad; NaN = unknown
    notes: tuple[str, ...]

    def digest(self) -> str:
        """Hash of the wrench table: equal for exact copies."""
        return content_hash([self.table.time, self.table.values])


def data_file(folder: Path, arm: str, kind: str) -> Path | None:
    """The arm's file of a kind such as "State", the right arm's also without prefix; None = missing."""
    names = [f"{arm}_{kind}.dat"] + ([f"{kind}.dat"] if arm == "R" else [])
    return next((folder / name for name in names if (folder / name).is_file()), None)


def read_trial(folder: Path, source: str, skip: Complain, warn: Complain) -> list[ArmRecord]:
    """Read the arms of one trial.

    Args:
        folder: the trial's folder.
        source: name of its data set.
        skip: told of every arm that could not be used.
        warn: told of every file that could not be used although the arm was.

    Returns:
        right arm, left arm: those that exist and have a sound wrench table.
    """
    trial = os.fsencode(folder.name).decode("utf-8", "replace")
    found = {arm: data_file(folder, arm, "Torques") for arm in ARMS}
    if not any(found.values()):
        skip(folder, "no R_Torques.dat or L_Torques.dat inside.")
    records = []
    for arm, path in found.items():
        if path is None:
            continue
        try:
            table = dat.read_timed(path, "wrench")
        except InputError as error:
            skip(path, str(error))
            continue
        records.append(_read_arm(folder, trial, arm, parse_trial(source, trial), table, warn))
    return records


def _read_arm(folder: Path, trial: str, arm: str, name: TrialName, table: dat.TimedTable, warn: Complain) -> ArmRecord:
    notes = list(name.notes)
    if abs(table.time[0]) > table.dt / 2:
        notes.append(f"clock-starts-at:{table.time[0]:g}")
    onset, more = _read_onset(folder, arm, table, warn)
    notes += more
    angles = _read_signal(folder, arm, "Angles", "joint angles", warn)
    if angles is not None and len(angles.time) != len(table.time):
        notes.append(f"angles-length:{len(angles.time)}/{len(table.time)}")
    better = onset
    if onsets.needs_harmonising(onset, table.dt):
        better, more = _harmonise(folder, arm, onset, table, angles, warn)
        notes += more
    deviation = np.array(name.deviation if name.deviation is not None else (np.nan,) * 3)
    if name.session == "B":
        deviation = _grid_offset(folder, onset, warn)
    return ArmRecord(folder, trial, arm, name, table, onset, better, deviation, tuple(notes))


def _read_signal(folder: Path, arm: str, kind: str, quantity: str, warn: Complain) -> dat.TimedTable | None:
    """A signal file, or None where it is missing or unusable (then ``warn`` hears why)."""
    path = data_file(folder, arm, kind)
    if path is None:
        return None
    try:
        return dat.read_timed(path, quantity)
    except InputError as error:
        warn(path, str(error))
        return None


def _read_onset(folder: Path, arm: str, table: dat.TimedTable, warn: Complain) -> tuple[NDArray[np.float64], list[str]]:
    """State start times of an arm; a left arm without its own (fewer than two) takes the right arm's."""
    marks, notes = _read_marks(folder, arm, warn)
    if arm == "L" and len(marks) < 2:
        right, right_notes = _read_marks(folder, "R", warn)
        if len(right) > len(marks):
            marks, notes = right, [*right_notes, "state-times-of-right-arm"]
    if notes[:1] in (["state-file-missing"], ["state-file-unusable"]):
        return np.full(4, np.nan), notes
    try:
        onset, more = onsets.onsets_from_marks(marks, table.time, table.dt)
    except InputError as error:
        warn(data_file(folder, arm, "State") or folder, str(error))
        return np.full(4, np.nan), ["state-file-unusable"]
    return onset, [*notes, *more]


def _read_marks(folder: Path, arm: str, warn: Complain) -> tuple[NDArray[np.float64], list[str]]:
    path = data_file(folder, arm, "State")
    if path is None:
        return np.zeros(0), ["state-file-missing"]
    try:
        return dat.read_state_times(path), []
    except InputError as error:
        warn(path, str(error))
        return np.zeros(0), ["state-file-unusable"]


def _harmonise(
    folder: Path,
    arm: str,
    onset: NDArray[np.float64],
    table: dat.TimedTable,
    angles: dat.TimedTable | None,
    warn: Complain,
) -> tuple[NDArray[np.float64], list[str]]:
    """Harmonised onset from the joint angles, else from the recorded pose, else by the fixed share."""
    if angles is not None:
        # Session C's offset of the last joint needs no removal: that joint does not change the tilt.
        tilt = np.degrees(kinematics.tilt(kinematics.fk(angles.values, arm)[1]))
        out, note = onsets.harmonised(onset, angles.time - table.time[0], tilt)
        return out, [note]
    pose = _read_signal(folder, arm, "CartPos", "pose", warn)
    if pose is not None:
        tilt = np.degrees(kinematics.tilt(kinematics.rotation_from_rpy(pose.values[:, 3:])))
        out, note = onsets.harmonised(onset, pose.time - table.time[0], tilt)
        return out, ["angles-missing", f"{note}-from-pose"]
    out, note = onsets.fallback(onset)
    return out, ["angles-missing", note]


def _grid_offset(folder: Path, onset: NDArray[np.float64], warn: Complain) -> NDArray[np.float64]:
    """Session B's commanded offset [3] (m, m, rad), from where the hand is just before contact.

    The approach ends on the line (.311+dx, -.1726+dy, .495) -> (.331+dx, -.1726+dy, .484) with whole
    millimetres dx and dy; the recorded poses lie within 0.03 mm of that grid.
    """
    pose = _read_signal(folder, "R", "CartPos", "pose", warn)
    if pose is None or not np.isfinite(onset[1]):
        return np.full(3, np.nan)
    # The pose file is one tick late, and after contact it holds another point.
    last = int(np.searchsorted(pose.time - pose.time[0], onset[1])) - 2
    if not 0 <= last < len(pose.time):
        return np.full(3, np.nan)
    x, y, z = pose.values[last, :3]
    dx, dy = x - 0.311 - 20 / 11 * (0.495 - z), y + 0.1726
    return np.array([round(dx, 3), round(dy, 3), 0.0]) + 0.0  # + 0.0 turns -0.0 into 0.0


def with_note(record: ArmRecord, note: str) -> ArmRecord:
    """The record with one more note."""
    return replace(record, notes=(*record.notes, note))
