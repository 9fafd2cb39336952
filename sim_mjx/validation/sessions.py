"""The recorded sessions simulated as they were done, and how alike the wrenches are.

Session A repeated one pose; session B went through a grid of offsets, one trial per cell; of C and of the OpenHRP
simulation little is known but that the trials differ mildly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.io.hiro import onsets
from rcbht_jax.robots import hiro_kinematics
from rcbht_jax.types import Recordings
from sim_mjx.assembly import sensor
from sim_mjx.assembly.rollout import Rollouts, TrialParams, stack
from sim_mjx.assembly.scene import one_arm
from sim_mjx.engines import native
from sim_mjx.presets import sessions
from sim_mjx.randomization import trials
from sim_mjx.randomization.overrides import Physical
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.validation import signature, snaps
from sim_mjx.validation.replay import Recorder, seated_snaps
from sim_mjx.validation.system_id import Values

Floats = NDArray[np.float64]

# Session B's grid, mm: the coarse 3 x 3 grid first, so that its first cells stand for all.
COARSE = [(dx, dy) for dx in (0, 2, -2) for dy in (0, 2, -2)]
GRID = COARSE + [(dx, dy) for dx in (0, 1, 2, -1, -2) for dy in (0, 1, 2, -1, -2) if (dx, dy) not in COARSE]
RECORDED_OFF = {(0, -2), (1, -2), (2, -2), (-1, -2), (-2, -2), (-1, 2), (-2, 2)}  # cells that ended off-seat
# Session A repeated one nominal trial: only noise, a small drift of the bias and .04 mm (sd) of placement differ.
SAME = ("stiffness", "overlap", "friction", "mount", "gain", "goal", "speed", "tare")
REPEATED: dict[str, Any] = dict.fromkeys(SAME, (1.0, 1.0)) | {
    "shift": (-7e-5, 7e-5), "turn": (-3e-4, 3e-4), "force_bias": (-0.06, 0.06), "moment_bias": (-0.003, 0.003),
}  # fmt: skip
IN_PLACE: dict[str, Any] = {
    "shift": (0.0, 0.0), "turn": (0.0, 0.0), "force_bias": (-0.18, 0.18), "moment_bias": (-0.004, 0.004),
}  # fmt: skip
REPEATS = 16
RING = (0.0, 4.0)  # s after the onset of mating, in which its ring is sought
SLACK = 4.0  # s after the recorded start of mating, by which a shortened trial is over


def trials_of(
    session: str, count: int | None = None, *, seed: int = 0, physical: Physical = (), whole: bool = True
) -> TrialParams:
    """Trials like those of a recorded session.

    Args:
        session: one of ``presets.PRESETS``.
        count: trials; default session B's 25 cells, elsewhere 16.
        seed: of noise, bias and mild differences.
        physical: parameters that replace the nominal ones.
        whole: to the session's end; otherwise just past the first second of mating, which the signature needs.

    Raises:
        InputError: unknown session or parameter, or more trials than session B's grid has cells.
    """
    task = sessions.preset(session)
    spec: dict[str, Any] = {"A": REPEATED, "B": IN_PLACE}.get(session, {})
    longest = None if whole else trials.MATING_BEGINS[session] + SLACK
    count = count or (len(GRID) if session == "B" else REPEATS)
    distribution = DomainRandomization(nominal_share=1.0, longest=longest, physical=physical, **spec)
    drawn = [trials.sample(session, seed, index, distribution)[0] for index in range(count)]
    if session == "B":
        if count > len(GRID):
            raise InputError(f"Session B has {len(GRID)} cells; {count} trials are too many.")
        drawn = [_moved(one, dx * 1e-3, dy * 1e-3) for one, (dx, dy) in zip(drawn, GRID, strict=False)]
    if not whole:
        short = np.array(min(float(task.mating_time), signature.MATING + 0.1))
        drawn = [replace(one, task=replace(one.task, mating_time=short)) for one in drawn]
    return stack(drawn)


def _moved(trial: TrialParams, dx: float, dy: float) -> TrialParams:
    way = trial.task.way_position + np.array([dx, dy, 0.0])
    return replace(trial, task=replace(trial.task, way_position=way))


def harmonised(run: Rollouts) -> Floats:
    """State onsets [trial, 4], s, with the harmonised end of a rotation that lasts one period."""
    out = run.onset.copy()
    for row, samples in enumerate(run.length):
        if onsets.needs_harmonising(run.onset[row], sessions.CONTROL_PERIOD):
            joints = run.joints[row, :samples].astype(np.float64)
            tilt = hiro_kinematics.tilt_degrees(hiro_kinematics.wrist_pose(joints)[1])
            time = np.arange(samples) * sessions.CONTROL_PERIOD
            out[row] = onsets.harmonised(run.onset[row], time, tilt)[0]
    return out


def profiles(run: Rollouts, rows: Sequence[int] | NDArray[np.integer] | None = None) -> Floats:
    """Wrench profiles [n, 4, 100, 6] of the trials that mated for a second; n may be 0.

    Args:
        run: simulated trials.
        rows: which of them; default all.
    """
    chosen = np.arange(len(run.length)) if rows is None else np.asarray(rows, int)
    onset = harmonised(run)
    end = (run.length - 1) * sessions.CONTROL_PERIOD
    # a trial that was stopped has "entered" later states all at once, at its end
    mated = (np.diff(onset, axis=1) > 0).all(1) & (onset[:, 3] + signature.MATING <= end + 1e-9) & ~run.diverged
    kept = chosen[mated[chosen]]
    if len(kept) == 0:
        return np.zeros((0, len(signature.STATES), signature.POINTS, 6))
    return signature.profiles(_as_recordings(run, onset), kept)


def _as_recordings(run: Rollouts, onset: Floats) -> Recordings:
    count = len(run.length)
    blank, unknown = np.full(count, ""), np.full(count, "unknown")
    return Recordings(
        wrench=run.wrench, length=run.length, dt=sessions.CONTROL_PERIOD, onset=run.onset, onset_harmonised=onset,
        trial=np.array([f"simulated {row}" for row in range(count)]), arm=np.full(count, "R"), source=blank,
        session=blank, outcome=unknown, failure_type=blank, deviation=np.zeros((count, 3)), note=blank,
    )  # fmt: skip


@dataclass(frozen=True)
class Target:
    """What a session's simulation should be like."""

    session: str
    profiles: Floats  # [n, 4, 100, 6] N and Nm
    onset: Floats  # [3] s, median start of rotation, insertion (harmonised) and mating
    ring: dict[str, float] | None  # of Fz in mating; see rings
    snaps: dict[str, Any] | None  # in the force before the filter, of trials not off-seat; see snaps.summary


def recorded(recordings: Recordings, session: str) -> Target:
    """The recorded trials of a session that reached every state.

    Args:
        recordings: of the imported data sets.
        session: one of ``presets.PRESETS``.

    Raises:
        InputError: there are none.
    """
    sessions.preset(session)
    name = "SIM1" if session == "openhrp" else session
    usable = (recordings.session == name) & np.isfinite(recordings.onset_harmonised).all(1)
    usable &= np.char.find(recordings.note, "other-setup") < 0
    if session == "openhrp":
        usable &= recordings.outcome == "success"
    rows = np.flatnonzero(usable)
    if len(rows) == 0:
        raise InputError(f"The store holds no trial of session {session} that reached every state.")
    onset = np.median(recordings.onset_harmonised[rows, 1:], axis=0)
    ring = rings(recordings.wrench[rows, :, 2], recordings.length[rows], recordings.onset[rows, 3])
    return Target(session, signature.profiles(recordings, rows), onset, ring, _snaps(recordings, rows, session))


def _snaps(recordings: Recordings, rows: NDArray[np.integer], session: str) -> dict[str, Any] | None:
    """Snaps of the recorded trials that seated; None of the OpenHRP simulation, whose parts have no tabs."""
    if session == "openhrp":
        return None
    touch = sensor.real_sensor()
    seated = rows[(np.char.find(recordings.note[rows], "off-seat") < 0) & (recordings.outcome[rows] == "success")]
    forces = [snaps.unfiltered(recordings.wrench[row, : recordings.length[row], 2], touch) for row in seated]
    starts = recordings.onset[seated, 1].tolist()
    return snaps.summary([snaps.find(force, begin) for force, begin in zip(forces, starts, strict=True)])


def rings(force: NDArray[np.floating], length: NDArray[np.integer], mating: Floats) -> dict[str, float] | None:
    """How Fz rings after the push that begins mating: medians over the trials that last long enough.

    Args:
        force: Fz [trial, time], N. length: samples [trial]. mating: its onset [trial], s, NaN = never.

    Returns:
        "hertz", the strongest frequency between 1 and 6 Hz in the first 4 s after the onset, and "peak", N, in the
        first second; None if no trial lasts so long.
    """
    found = []
    for row, begin in enumerate(np.nan_to_num(mating, nan=np.inf)):
        last = (begin + RING[1]) / sessions.CONTROL_PERIOD
        if last <= length[row]:
            first = round(begin / sessions.CONTROL_PERIOD)
            found.append((_frequency(force[row], begin), force[row, first : first + 200].max()))
    return None if not found else dict(zip(("hertz", "peak"), np.median(found, axis=0).tolist(), strict=True))


def _frequency(force: NDArray[np.floating], begin: float) -> float:
    first, last = (round((begin + at) / sessions.CONTROL_PERIOD) for at in RING)
    times = np.arange(last - first)
    tail = force[first:last] - np.polyval(np.polyfit(times, force[first:last], 1), times)
    power = np.abs(np.fft.rfft(tail * np.hanning(len(tail)), 1 << 15))
    hertz = np.fft.rfftfreq(1 << 15, sessions.CONTROL_PERIOD)
    return float(hertz[np.where((hertz > 1.0) & (hertz < 6.0), power, -1.0).argmax()])


# What one unit of each term of the loss is worth; the worst cells of the metric's tables count as this many sd.
WORST_CELL, ONSET_UNIT, ONSET_WEIGHT, OUTCOME_WEIGHT, SNAP_WEIGHT, LOST = 2.0, 0.3, 0.1, 1.0, 0.5, 3.0


def loss(target: Target, run: Rollouts, *, outcomes: bool) -> float:
    """How unlike a session a simulated batch is: 0 = alike; the sum of

    1 - coverage; half the mean of W1/sd and half that of DTW/sd over the 24 cells, each cell at most 2; a tenth per
    0.3 s by which the median onsets are off; 3 x the share of trials that do not mate for a second; and, with
    ``outcomes``, the share of session B's cells whose outcome is not the recorded one.
    """
    found = profiles(run)
    total = LOST * (1.0 - len(found) / len(run.length))
    if outcomes:
        total += OUTCOME_WEIGHT * (1.0 - agreement(run) / len(run.length))
    if len(found) == 0:
        return total + 1.0 + WORST_CELL
    score = signature.compare(target.profiles, found)
    late = np.abs(np.nanmedian(harmonised(run)[:, 1:], axis=0) - target.onset)
    unlike = sum(np.minimum(table, WORST_CELL).mean() / 2 for table in (score.w1_table, score.dtw_table))
    return float(total + 1.0 - score.coverage + unlike + ONSET_WEIGHT * np.nansum(late) / ONSET_UNIT)


def missing_snaps(target: Target, found: dict[str, Any]) -> float:
    """By how much the share of seated trials with a snap like the recorded ones falls short of the recorded share."""
    if target.snaps is None or target.snaps["trials"] == 0:
        return 0.0
    recorded, simulated = (
        each["trials_with_a_snap_as_recorded"] / max(each["trials"], 1) for each in (target.snaps, found)
    )
    return float(max(recorded - simulated, 0.0))


def agreement(run: Rollouts) -> int:
    """How many of the simulated cells of session B seat, or do not, as the recorded ones; whole trials only."""
    seated: list[bool] = np.atleast_1d(run.seated.all(1)).tolist()
    return sum(seat == (cell not in RECORDED_OFF) for seat, cell in zip(seated, GRID, strict=False))


@dataclass(frozen=True)
class SessionObjective:
    """The loss of a population of candidate parameters, all trials of all candidates in one batch."""

    target: Target
    count: int  # trials per candidate
    seed: int = 0
    outcomes: bool = False  # session B: simulate whole trials and compare how they ended
    snaps: bool = False  # simulate whole trials and miss the snaps that the recorded ones have
    fixed: Physical = ()  # parameters that are set and not searched

    def __call__(self, candidates: list[Values]) -> Floats:
        session, whole = self.target.session, self.outcomes or self.snaps
        losses = np.full(len(candidates), np.nan)
        batches: list[TrialParams] = []
        possible = []
        for row, values in enumerate(candidates):
            physical = (*self.fixed, *values.items())
            try:
                batches.append(trials_of(session, self.count, seed=self.seed, physical=physical, whole=whole))
                possible.append(row)
            except InputError:
                continue  # parts that cannot be: the worst loss
        if not batches:
            return losses
        recorder = Recorder(one_arm(), len(batches) * self.count)
        together = jax.tree.map(lambda *leaves: np.concatenate(leaves), *batches)
        run = native.simulate(one_arm(), together, watch=recorder.watch if self.snaps else None)
        for place, row in enumerate(possible):
            rows = slice(place * self.count, (place + 1) * self.count)
            losses[row] = loss(self.target, _part(run, rows), outcomes=self.outcomes)
            if self.snaps:
                losses[row] += SNAP_WEIGHT * missing_snaps(self.target, seated_snaps(run, recorder, rows))
        return losses


def _part(run: Rollouts, rows: slice) -> Rollouts:
    return Rollouts(
        run.wrench[rows], run.joints[rows], run.length[rows], run.onset[rows], run.seated[rows], run.diverged[rows]
    )
