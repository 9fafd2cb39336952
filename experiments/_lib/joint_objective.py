"""One set of parts for several sessions: the loss of shared and of each session's own parameters.

A name such as ``parts.friction`` holds for all sessions, ``B:parts.roll`` for one. Besides the similarity of the wrench
the loss includes the effect of the hooks: which trials seat, and whether a tab gives way while the hand presses.
Without it a search finds parts whose feet slide over the seat and whose hooks touch nothing.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float64
from sklearn.utils.parallel import Parallel, delayed

from rcbht_jax.errors import InputError
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts, TrialParams
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.presets.session_a import SESSION_A
from sim_mjx.randomization.overrides import Physical
from sim_mjx.synthesis.passes import passes_of
from sim_mjx.validation import gate, sessions, snaps
from sim_mjx.validation.dynamics import dynamics
from sim_mjx.validation.sessions import Target
from sim_mjx.validation.system_id import Losses, Values

CELL_WEIGHT, WORST_CELL, SIGN_WEIGHT, EVENT_WEIGHT, OUTCOME_WEIGHT, SNAP_WEIGHT = 0.25, 4.0, 0.05, 0.3, 1.0, 0.5
WAIT_WEIGHT, WAIT, WAITS = 0.5, 7.4, 20.0  # median recorded time of the last snap, s into mating; ratio of loss 1
SNAP, RUNG = 7.0, 1.0  # N, of a snap as recorded; s after mating begins, when the push has rung down
LONGEST = 12.0  # s of mating that are simulated: by then most of the recorded tabs are in
OWNED = re.compile(r"(?:([^:\[]+):)?(.+)")  # a colon in brackets is a range of elements
IMPOSSIBLE = 9.0  # loss of a session that cannot be simulated or compared


class Share(NamedTuple):
    """What a session contributes to a joint fit."""

    target: Target  # recorded trials to fit to
    placements: tuple[tuple[int, int], ...]  # of a session with a grid: the cells to fit to
    trials: int  # simulated per candidate


def physical(values: Values, session: str) -> Physical:
    """The parameters of one session among those of all.

    Example:
        >>> physical({"parts.friction": 0.3, "A:parts.roll": 0.01, "B:parts.roll": 0.02}, "B")
        (('parts.friction', 0.3), ('parts.roll', 0.02))
        >>> physical({"parts.hook_overlap[2:4]": 8e-4}, "B")
        (('parts.hook_overlap[2:4]', 0.0008),)
    """
    owned = [(OWNED.fullmatch(name), value) for name, value in values.items()]
    return tuple((found[2], value) for found, value in owned if found and found[1] in (None, session))


@dataclass(frozen=True)
class JointObjective:
    """Loss of a population of candidates, the sum over sessions; all trials of all candidates are one batch."""

    scene: Scene
    shares: dict[str, Share]
    engine: str = "native"
    seed: int = 0

    def __call__(self, candidates: list[Values]) -> Losses:
        losses = np.zeros(len(candidates))
        batches: list[TrialParams] = []
        spans: list[tuple[int, str, slice]] = []
        for row, values in enumerate(candidates):
            for name, share in self.shares.items():
                try:
                    batch = self._trials(share, physical(values, name))
                except InputError:  # impossible parts
                    losses[row] += IMPOSSIBLE
                    continue
                start = spans[-1][2].stop if spans else 0
                batches.append(batch)
                spans.append((row, name, slice(start, start + share.trials)))
        if not batches:
            return losses
        together = jax.tree.map(lambda *leaves: np.concatenate(leaves), *batches)
        run = engines.simulate(self.scene, together, self.engine)
        parts = [(row, self.shares[name], sessions.part_of(run, rows)) for row, name, rows in spans]
        # a score takes as long as a trial on a GPU
        scores = Parallel(n_jobs=-1)(delayed(session_loss)(share, part) for _, share, part in parts)
        for (row, _, _), score in zip(parts, scores, strict=True):
            losses[row] += score
        return losses

    def _trials(self, share: Share, values: Physical) -> TrialParams:
        session = share.target.session
        return sessions.trials_of(
            session, share.trials, seed=self.seed, physical=values, placements=share.placements or None, longest=LONGEST
        )


def session_loss(share: Share, run: Rollouts) -> float:
    """Distance of simulated whole trials from a session: that of :func:`sessions.loss` and, weighted, the mean distance
    of the 48 means and deviations of the gate's classifier in recorded deviations, wrong signs, logarithms of the
    ratios of first impact and ring, wrong outcomes, and missing snaps.
    """
    target = share.target
    simulated = sessions.profiles(run)
    total = sessions.loss(target, run, outcomes=False) + outcome_loss(share, run)
    if len(simulated) < gate.LEAST:
        return total + IMPOSSIBLE / 3
    recorded, found = gate.cells(target.profiles), gate.cells(simulated)
    unit = np.maximum(recorded.std(0), 0.15 * np.abs(recorded).mean(0) + 0.01)
    away = np.minimum(np.abs(found.mean(0) - recorded.mean(0)) / unit, WORST_CELL).mean()
    signs = gate.wrong_signs(target.profiles, simulated).sum()
    total += CELL_WEIGHT * away + SIGN_WEIGHT * signs + EVENT_WEIGHT * _events(target, run)
    if target.snaps is not None and snaps.share(target.snaps) > 0:
        total += SNAP_WEIGHT * _missing_snaps(share, run) + WAIT_WEIGHT * _wrong_wait(share, run)
    return float(total)


def outcome_loss(share: Share, run: Rollouts) -> float:
    """Weighted mean error of outcomes: share of unseated tabs if a trial should seat, else 1 if it seats."""
    expected = seats(share)
    wrong = np.where(expected, 1.0 - run.seated.mean(1), run.seated.all(1))
    return OUTCOME_WEIGHT * float(wrong.mean())


def seats(share: Share) -> Bool[np.ndarray, " trial"]:
    """Which of the simulated trials should seat."""
    return sessions.should_seat(share.target.session, share.trials, share.placements)


def _events(target: Target, run: Rollouts) -> float:
    """Logarithms of the ratios of first impact and of the ring's frequency, peak and damping, each at most 1."""
    ours = dynamics(run.wrench[..., 2], run.length, run.onset[:, 1], run.onset[:, 3])
    pairs = [(np.median(ours.impact) if len(ours.impact) else np.nan, np.median(target.dynamics.impact))]
    if target.dynamics.ring is not None:
        ring = ours.ring or target.dynamics.ring._replace(hertz=np.nan, peak=np.nan, damping=np.nan)
        pairs += list(zip(ring, target.dynamics.ring, strict=True))
    ratios = np.abs([np.log(max(a, 1e-6) / b) if np.isfinite(a) else 1.0 for a, b in pairs])
    return float(np.minimum(ratios, 1.0).sum())


def _missing_snaps(share: Share, run: Rollouts) -> float:
    """Mean shortfall, from a recorded snap, of the quickest fall of the unfiltered force while the hand presses.

    A ringing force falls as quickly as it rises; a tab that gives way only falls.
    """
    force = snaps.unfiltered(run.wrench[..., 2], SESSION_A.sensor)
    begin, end = run.onset[:, 3] + RUNG, run.length * CONTROL_PERIOD
    fall = quickest_fall(force, begin, end) - quickest_fall(-force, begin, end)
    return float((1.0 - np.clip(fall / SNAP, 0.0, 1.0))[seats(share)].mean())


def _wrong_wait(share: Share, run: Rollouts) -> float:
    """Mean logarithm, to base ``WAITS``, of the ratio of the last tab's time to the recorded one; each at most 1, and 1
    where no tab passes in mating.
    """
    passes = passes_of(run.past, run.length)
    last = [max((start for _, start, end in each.tolist() if end), default=0) * CONTROL_PERIOD for each in passes]
    wait = np.array(last) - np.nan_to_num(run.onset[:, 3], nan=np.inf)
    away = np.abs(np.log(np.maximum(wait, WAIT / WAITS) / WAIT)) / np.log(WAITS)
    return float(np.minimum(away, 1.0)[seats(share)].mean())


def quickest_fall(
    force: Float64[np.ndarray, "trial time"], begin: Float64[np.ndarray, " trial"], end: Float64[np.ndarray, " trial"]
) -> Float64[np.ndarray, " trial"]:
    """Largest fall of a force within the time that a snap takes, N, between two times, s; 0 where there is none."""
    fall = force[:, : -snaps.FALL] - force[:, snaps.FALL :]
    time = np.arange(fall.shape[1]) * CONTROL_PERIOD
    inside = (time >= begin[:, None]) & (time < end[:, None] - (snaps.FALL + 1) * CONTROL_PERIOD)  # false for NaN
    return np.where(inside, fall, 0.0).max(1, initial=0.0)
