"""The recorded sessions simulated as they were recorded, and the similarity of their wrenches.

Session A repeated one pose; session B covered a grid of offsets, one trial per cell; of C and of the OpenHRP
simulation only a mild variation between trials is known.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float64, Int
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.robots.snap_assembly import HARMONISED, RECORDED, snap_recordings
from rcbht_jax.types import Recordings
from sim_mjx.assembly.rollout import Rollouts, TrialParams
from sim_mjx.assembly.task import CONTROL_PERIOD, horizontal
from sim_mjx.engines import native
from sim_mjx.presets import preset
from sim_mjx.presets.session import SessionPreset
from sim_mjx.presets.session_a import SESSION_A
from sim_mjx.randomization import trials
from sim_mjx.randomization.overrides import Physical
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.synthesis import records
from sim_mjx.validation import signature, snaps
from sim_mjx.validation.dynamics import Dynamics, dynamics
from sim_mjx.validation.replay import Recorder, seated_snaps
from sim_mjx.validation.signature import Profiles, Rows
from sim_mjx.validation.system_id import Losses, Values

Floats = NDArray[np.float64]

REPEATS = 16  # trials of a session without a grid
SLACK = 4.0  # s after the recorded start of mating, at which a shortened trial ends


def trials_of(
    session: SessionPreset,
    count: int | None = None,
    *,
    seed: int = 0,
    physical: Physical = (),
    whole: bool = True,
    placements: tuple[tuple[int, int], ...] | None = None,
    longest: float = np.inf,
) -> TrialParams:
    """Trials like those of a recorded session.

    Args:
        session: of one arm.
        count: trials; default one per placement, or 16.
        seed: of noise, bias and mild differences.
        physical: parameters that replace the nominal ones.
        whole: to the session's end; otherwise just past the first second of mating, which the signature needs.
        placements: mm, of a session with a grid, one trial each; default all of the session.
        longest: s, of mating; if finite, trials that begin mating more than ``SLACK`` s late are also cut.

    Raises:
        InputError: unknown parameter, or more trials than the session's grid has cells.
    """
    mating = min(float(session.task.mating_time), longest if whole else signature.MATING + 0.1)
    in_time, cut = session.mating_begins + SLACK, np.isfinite(longest)
    limit = None if whole and not cut else in_time + mating * whole
    cells = session.placements if placements is None else placements
    count = count or len(cells) or REPEATS
    if cells and count > len(cells):
        raise InputError(f"The count is {count}; session {session.name} has {len(cells)} cells, for a trial each.")
    repeats: dict[str, Any] = session.repeats
    spec = DomainRandomization(nominal_share=1.0, longest=limit, physical=physical, **repeats)
    drawn, _ = trials.sample_batch(session, seed, range(count), spec)
    way = drawn.task.way_position
    if cells:
        way = way + horizontal(np.array(cells[:count]) * 1e-3)[:, None]
    return replace(drawn, task=replace(drawn.task, way_position=way, mating_time=np.full(count, mating)))


def harmonised(run: Rollouts) -> Float64[np.ndarray, "trial 4"]:
    """State onsets, s, with the harmonised end of a rotation that lasts one period."""
    tilts = partial(records.tilts, run.joints)
    return records.harmonised(run.onset, run.length, np.zeros_like(run.diverged), tilts)[0]


def profiles(run: Rollouts, rows: Rows = None) -> Profiles:
    """Wrench profiles of the trials that mated for a second, maybe none.

    Args:
        run: simulated trials.
        rows: which of them; default all.
    """
    chosen = np.arange(len(run.length)) if rows is None else np.asarray(rows, int)
    onset = harmonised(run)
    end = (run.length - 1) * CONTROL_PERIOD
    # false for NaN, of a state that was never reached
    mated = (np.diff(onset, axis=1) > 0).all(1) & (onset[:, 3] + signature.MATING <= end + 1e-9) & ~run.diverged
    complete = chosen[mated[chosen]]
    if len(complete) == 0:
        return np.zeros((0, len(signature.STATES), signature.POINTS, 6))
    return signature.profiles(_as_recordings(run, onset), complete)


def _as_recordings(run: Rollouts, onset: Floats) -> Recordings:
    count = len(run.length)
    blank, unknown = np.full(count, ""), np.full(count, "unknown")
    return snap_recordings(
        wrench=run.wrench, length=run.length, dt=CONTROL_PERIOD, onset=run.onset, onset_harmonised=onset,
        trial=np.array([f"simulated {row}" for row in range(count)]), arm=np.full(count, "R"), source=blank,
        session=blank, outcome=unknown, failure_type=blank, deviation=np.zeros((count, 3)), note=blank,
    )  # fmt: skip


@dataclass(frozen=True)
class Target:
    """Recorded reference of a session's simulation."""

    session: SessionPreset
    profiles: Profiles
    onset: Float64[np.ndarray, " 3"]  # s, median start of rotation, insertion (harmonised) and mating
    dynamics: Dynamics  # first impact and ringing
    snaps: dict[str, Any] | None  # in the unfiltered force of seated trials; see snaps.summary


def recorded(recordings: Recordings, session: str, rows: Rows = None) -> Target:
    """The recorded trials of a session that reached every state.

    Args:
        recordings: of the imported data sets.
        session: name of a one-arm preset.
        rows: some of those of :func:`recorded_rows`; default all.

    Raises:
        InputError: unknown preset, or no such trials.
    """
    constants = preset(session)
    rows = recorded_rows(recordings, session) if rows is None else np.asarray(rows, int)
    onset = np.median(recordings.starts(HARMONISED)[rows, 1:], axis=0)
    starts = recordings.starts(RECORDED)[rows]
    events = dynamics(recordings.wrench[rows, :, 2], recordings.length[rows], starts[:, 1], starts[:, 3])
    # The parts of OpenHRP have no tabs.
    summary = snaps.summary(list(recorded_snaps(recordings, rows).values())) if constants.real else None
    return Target(constants, signature.profiles(recordings, rows), onset, events, summary)


def recorded_rows(recordings: Recordings, session: str) -> Int[np.ndarray, " row"]:
    """Recordings of a session that reached every state; arguments and errors of :func:`recorded`."""
    constants = preset(session)
    usable = recordings.session == constants.recorded_as
    if {RECORDED, HARMONISED} <= set(recordings.annotations.tracks):
        usable &= np.isfinite(recordings.starts(HARMONISED)).all(1)
    else:  # of another robot or task
        usable[:] = False
    usable &= np.char.find(recordings.note, "other-setup") < 0
    if not constants.real:  # of the OpenHRP simulation only the successes are logged like the other sessions
        usable &= recordings.outcome == "success"
    rows = np.flatnonzero(usable)
    if len(rows) == 0:
        raise InputError(f"The store holds no trial of session {session} that reached every state.")
    return rows


def recorded_snaps(recordings: Recordings, rows: NDArray[np.integer]) -> dict[int, list[snaps.Snap]]:
    """Snaps in the unfiltered force of those recordings of a robot that seated, by row."""
    seated = rows[(np.char.find(recordings.note[rows], "off-seat") < 0) & (recordings.outcome[rows] == "success")]
    forces = [snaps.unfiltered(recordings.wrench[row, : recordings.length[row], 2], SESSION_A.sensor) for row in seated]
    starts = recordings.starts(RECORDED)[seated, 1].tolist()
    found = [snaps.find(force, begin) for force, begin in zip(forces, starts, strict=True)]
    return dict(zip(seated.tolist(), found, strict=True))


# Weights of the terms of the loss; cells of the metric's tables are clipped at WORST_CELL sd.
WORST_CELL, ONSET_UNIT, ONSET_WEIGHT, OUTCOME_WEIGHT, SNAP_WEIGHT, LOST = 2.0, 0.3, 0.1, 1.0, 0.5, 3.0


def loss(target: Target, run: Rollouts, *, outcomes: bool) -> float:
    """Distance of a simulated batch from a session, 0 = equal: the sum of

    1 - coverage; half the mean of W1/sd and half that of DTW/sd over the 24 cells, each cell at most 2; 0.1 per 0.3 s
    of error of the median onsets; 3 x the share of trials that do not mate for a second; and, with ``outcomes``, the
    share of the session's cells whose outcome is not the recorded one.
    """
    simulated = profiles(run)
    total = LOST * (1.0 - len(simulated) / len(run.length))
    if outcomes:
        total += OUTCOME_WEIGHT * (1.0 - agreement(target.session, run) / len(run.length))
    if len(simulated) == 0:
        return total + 1.0 + WORST_CELL
    score = signature.compare(target.profiles, simulated)
    late = np.abs(np.nanmedian(harmonised(run)[:, 1:], axis=0) - target.onset)
    unlike = sum(np.minimum(table, WORST_CELL).mean() / 2 for table in (score.w1_table, score.dtw_table))
    return float(total + 1.0 - score.coverage + unlike + ONSET_WEIGHT * np.nansum(late) / ONSET_UNIT)


def missing_snaps(target: Target, summary: dict[str, Any]) -> float:
    """Shortfall of the share of seated trials with a snap like the recorded ones from the recorded share."""
    if target.snaps is None or target.snaps["trials"] == 0:
        return 0.0
    return max(snaps.share(target.snaps) - snaps.share(summary), 0.0)


def agreement(session: SessionPreset, run: Rollouts) -> int:
    """Number of whole trials whose seating is that of :func:`should_seat`."""
    seated = np.atleast_1d(run.seated.all(1))
    return int((seated == should_seat(session, len(seated), session.placements)).sum())


def should_seat(
    session: SessionPreset, count: int, placements: tuple[tuple[int, int], ...]
) -> Bool[np.ndarray, " trial"]:
    """Which of the first trials should seat: all, but for the placements that were recorded off the seat."""
    if not placements:
        return np.ones(count, np.bool_)
    return np.array([cell not in session.off_seat for cell in placements[:count]])


@dataclass(frozen=True)
class SessionObjective:
    """Loss of a population of candidate parameters, all trials of all candidates in one batch."""

    target: Target
    count: int  # trials per candidate
    seed: int = 0
    outcomes: bool = False  # simulate whole trials and compare their outcomes
    snaps: bool = False  # simulate whole trials and add a loss for snaps that the recorded ones have
    fixed: Physical = ()  # parameters that are not searched

    def __call__(self, candidates: list[Values]) -> Losses:
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
                continue  # impossible parts: the worst loss
        if not batches:
            return losses
        scene = session.scene()
        recorder = Recorder(scene, len(batches) * self.count)
        together = jax.tree.map(lambda *leaves: np.concatenate(leaves), *batches)
        run = native.simulate(scene, together, watch=recorder.watch if self.snaps else None)
        for place, row in enumerate(possible):
            rows = slice(place * self.count, (place + 1) * self.count)
            losses[row] = loss(self.target, part_of(run, rows), outcomes=self.outcomes)
            if self.snaps:
                losses[row] += SNAP_WEIGHT * missing_snaps(self.target, seated_snaps(run, recorder, rows))
        return losses


def part_of(run: Rollouts, rows: slice) -> Rollouts:
    """Some trials of a batch."""
    return Rollouts(**{field.name: getattr(run, field.name)[rows] for field in fields(Rollouts)})
