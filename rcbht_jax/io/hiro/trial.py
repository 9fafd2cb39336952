"""One trial folder in HIRO's layout -> one record per arm.

An arm is skipped only if its wrench table is broken; if its state, angle or pose file is, a note says so. A file that
is a link out of the data set counts as broken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float64

from rcbht_jax._util.digest import content_hash
from rcbht_jax._util.printable import spelled
from rcbht_jax._util.untrusted import check_inside
from rcbht_jax.errors import InputError
from rcbht_jax.io.hiro import dat, onsets
from rcbht_jax.io.hiro.names import TrialName, parse_trial
from rcbht_jax.io.hiro.onsets import Onset
from rcbht_jax.robots import kinematics

ARMS = ("R", "L")
Report = Callable[[Path, str], None]  # called with a path and what is wrong with it
T = TypeVar("T")


@dataclass(frozen=True)
class ArmRecord:
    """One arm of one trial, as read."""

    folder: Path
    trial: str
    arm: str
    name: TrialName
    table: dat.TimedTable
    onset: Onset
    onset_harmonised: Onset
    deviation: Float64[np.ndarray, 3]  # m, m, rad; NaN = unknown
    notes: tuple[str, ...]

    def digest(self) -> str:
        """Digest of the wrench table: equal for exact copies."""
        return content_hash([self.table.time, self.table.values])


def data_file(folder: Path, arm: str, kind: str) -> Path | None:
    """An arm's file of a kind such as "State", the right arm's also without prefix; None = missing."""
    names = [f"{arm}_{kind}.dat"] + ([f"{kind}.dat"] if arm == "R" else [])
    return next((folder / name for name in names if (folder / name).is_file()), None)


def read_trial(folder: Path, source: str, skip: Report, warn: Report) -> list[ArmRecord]:
    """Read the arms of one trial.

    Args:
        folder: the trial's folder.
        source: name of its data set.
        skip: called for every arm that cannot be used.
        warn: called for every unusable file of an arm that can be used.

    Returns:
        right arm, left arm: those with a valid wrench table.
    """
    trial = spelled(folder.name)
    paths = {arm: data_file(folder, arm, "Torques") for arm in ARMS}
    if not any(paths.values()):
        skip(folder, "no R_Torques.dat or L_Torques.dat inside.")
    records = []
    for arm, path in paths.items():
        if path is not None and (table := _read(path, partial(dat.read_timed, quantity="wrench"), skip)) is not None:
            records.append(_read_arm(folder, trial, arm, parse_trial(source, trial), table, warn))
    return records


def _read(path: Path, read: Callable[[Path], T], report: Report) -> T | None:
    """The content of a file of a trial; None if it is unusable, which is reported."""
    try:
        check_inside(path, path.parent.resolve().parent)
        return read(path)
    except InputError as error:
        report(path, str(error))
        return None


def _read_arm(folder: Path, trial: str, arm: str, name: TrialName, table: dat.TimedTable, warn: Report) -> ArmRecord:
    notes = list(name.notes)
    if abs(table.time[0]) > table.dt / 2:
        notes.append(f"clock-starts-at:{table.time[0]:g}")
    onset, more = _read_onset(folder, arm, table, warn)
    notes += more
    angles = _read_signal(folder, arm, "Angles", "joint angles", warn)
    if angles is not None and len(angles.time) != len(table.time):
        notes.append(f"angles-length:{len(angles.time)}/{len(table.time)}")
    harmonised = onset
    if onsets.needs_harmonising(onset, table.dt):
        harmonised, more = _harmonise(folder, arm, onset, table, angles, warn)
        notes += more
    deviation = np.array(name.deviation if name.deviation is not None else (np.nan,) * 3)
    if name.session == "B":
        deviation = _grid_offset(folder, onset, warn)
    return ArmRecord(folder, trial, arm, name, table, onset, harmonised, deviation, tuple(notes))


def _read_signal(folder: Path, arm: str, kind: str, quantity: str, warn: Report) -> dat.TimedTable | None:
    """A signal file; None if it is missing, or unusable, which is reported to ``warn``."""
    path = data_file(folder, arm, kind)
    return None if path is None else _read(path, partial(dat.read_timed, quantity=quantity), warn)


def _read_onset(folder: Path, arm: str, table: dat.TimedTable, warn: Report) -> tuple[Onset, list[str]]:
    """Start times of the states of an arm; a left arm with fewer than two uses those of the right arm."""
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


def _read_marks(folder: Path, arm: str, warn: Report) -> tuple[Float64[np.ndarray, " mark"], list[str]]:
    path = data_file(folder, arm, "State")
    if path is None:
        return np.zeros(0), ["state-file-missing"]
    marks = _read(path, dat.read_state_times, warn)
    return (np.zeros(0), ["state-file-unusable"]) if marks is None else (marks, [])


def _harmonise(
    folder: Path,
    arm: str,
    onset: Onset,
    table: dat.TimedTable,
    angles: dat.TimedTable | None,
    warn: Report,
) -> tuple[Onset, list[str]]:
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


def _grid_offset(folder: Path, onset: Onset, warn: Report) -> Float64[np.ndarray, 3]:
    """Session B's commanded offset (m, m, rad), from the position of the hand just before contact.

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
