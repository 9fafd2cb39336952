"""Parts identified from recorded motion: the wrench along the hand's recorded path, against the recorded one.

Recorded joint angles give the path of the hand. Moved along the same path, parts of the right shape and stiffness give
the recorded wrench, whatever the controller was: only the parts and their places are fitted. As in
:mod:`experiments._lib.joint_objective` a parameter is shared by all sessions, or belongs to one (``B:parts.roll``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float64, Int

from experiments._lib.joint_objective import physical
from rcbht_jax.errors import InputError
from rcbht_jax.robots import kinematics
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import Recordings
from sim_mjx import engines
from sim_mjx.assembly.parts import TIP_HEIGHT, PartParams
from sim_mjx.assembly.rollout import stack
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.presets.session import SessionPreset
from sim_mjx.randomization import overrides
from sim_mjx.validation.driven import DrivenParams
from sim_mjx.validation.gauss_newton import Residuals
from sim_mjx.validation.replay import recorded_angles
from sim_mjx.validation.system_id import Values

Wrench = Float64[np.ndarray, "time 6"]
BEFORE, AFTER = 0.6, 4.0  # s, of the path before rotation begins and, by default, after mating begins
BASE = slice(10, 100)  # samples before anything touches: what the sensor reads there is subtracted from both wrenches
EARLY = 20  # samples before the recorded start of rotation at which the comparison begins
COMMAND_LAG = 5  # control periods from a command to its servo, 20 to 25 ms as recorded
WINDOW = 10  # samples whose mean is one residual
LEAST = np.array([0.5, 0.5, 0.5, 0.03, 0.03, 0.03])  # N and Nm, least unit of an axis, for axes that hardly change
LOST = 10.0  # residual of a simulation that diverged
PRESSED = 5.0  # N, along the hand, above which the load's place is compared
LOAD_UNIT, LOAD_LOST = 10e-3, 3.0  # m, unit of differences of that place; largest residual, in units


@dataclass(frozen=True)
class DrivenTrial:
    """One recorded trial from just before touch."""

    name: str
    session: str
    path: Float64[np.ndarray, "time 6"]  # rad, joint angles
    wrench: Wrench  # N and Nm, recorded, less its mean before touch
    begin: int  # sample at which the comparison begins


def driven_trial(
    folder: Path, recordings: Recordings, row: int, name: str, preset: SessionPreset, after: float = AFTER
) -> DrivenTrial:
    """A recorded trial, prepared for simulation along its path.

    Args:
        folder: of the authors' data sets. recordings: imported from it. row: of the recording.
        name: of the preset. after: s, of the path after mating begins, at most.

    Raises:
        InputError: the trial's folder or its angles are missing.

    >>> driven_trial(Path("hiro"), recordings, 0, "hooked-B", HOOKED["hooked-B"])  # doctest: +SKIP
    """
    angles = recorded_angles(folder, recordings, row, preset)
    if preset.pose_lag:  # they are commands, which reach the servos late
        angles = np.concatenate([np.repeat(angles[:1], COMMAND_LAG, axis=0), angles[:-COMMAND_LAG]])
    starts = recordings.starts(HARMONISED)[row]
    first = max(round((starts[1] - BEFORE) / CONTROL_PERIOD), 0)
    last = min(round((starts[3] + after) / CONTROL_PERIOD), len(angles), int(recordings.length[row]))
    wrench = recordings.wrench[row, first:last].astype(np.float64)
    begin = round(starts[1] / CONTROL_PERIOD) - first - EARLY
    return DrivenTrial(str(recordings.trial[row]), name, angles[first:last], _relative(wrench), begin)


def _relative(wrench: Wrench) -> Wrench:
    return wrench - wrench[BASE].mean(0)


def units(trials: Sequence[DrivenTrial]) -> Float64[np.ndarray, " 6"]:
    """Unit of the differences of each axis, N and Nm: its recorded standard deviation, at least ``LEAST``.

    >>> wrench = np.zeros((200, 6))
    >>> wrench[100:, 2] = np.tile([2.0, 6.0], 50)  # Fz
    >>> units([DrivenTrial("push", "B", np.zeros((200, 6)), wrench, 100)]).tolist()  # the others hardly change
    [0.5, 0.5, 2.0, 0.03, 0.03, 0.03]
    """
    spread = [trial.wrench[trial.begin :].var(0) for trial in trials]
    return np.maximum(np.sqrt(np.mean(spread, axis=0)), LEAST)


@dataclass(frozen=True)
class DrivenObjective:
    """Residuals of candidates, all trials of all candidates in one batch.

    The sum of a candidate's squares is the mean, over trials and axes, of the share of an axis's variance that is not
    explained. Means of ``WINDOW`` samples are compared, so that sensor noise does not count.

    >>> from sim_mjx.assembly.scene import hooked
    >>> from sim_mjx.presets import HOOKED
    >>> from sim_mjx.validation.driven import driven
    >>> still = DrivenTrial("still", "hooked-B", np.zeros((120, 6)), np.zeros((120, 6)), 100)  # nothing is touched
    >>> objective = DrivenObjective(driven(hooked(4)), {"hooked-B": HOOKED["hooked-B"]}, (still,))
    >>> away = np.array([0, 0, 0.5, 0, 0, 0])  # N, one unit of one axis of six
    >>> round(float((objective.residuals([still.wrench + away]) ** 2).sum()), 3)
    0.167
    """

    scene: Scene  # from :func:`sim_mjx.validation.driven.driven`
    presets: dict[str, SessionPreset]
    trials: tuple[DrivenTrial, ...]
    engine: str = "native"
    load_weight: float = 0.0  # of the load's place, in units of 10 mm, beside the wrench; 0 = not compared

    def __call__(self, candidates: list[Values]) -> Residuals:
        return np.stack([self.residuals(wrenches) for wrenches in self.simulate(candidates)])

    def residuals(self, wrenches: list[Wrench]) -> Float64[np.ndarray, " residual"]:
        """Residuals of one candidate, from its wrenches of :meth:`simulate`, one per trial."""
        unit = units(self.trials)
        parts = [_residual(*pair, unit) for pair in zip(self.trials, wrenches, strict=True)]
        residuals = np.concatenate(parts) / np.sqrt(6 * len(self.trials))
        if not self.load_weight:
            return residuals
        loads = [self._load_residual(at, wrench) for at, wrench in enumerate(wrenches)]
        return np.concatenate([residuals, np.concatenate(loads) * np.sqrt(self.load_weight / (2 * len(self.trials)))])

    def load_point(self, at: int, wrench: Wrench) -> Float64[np.ndarray, "time 2"]:
        """Point at the height of the hooks' tips at which one force would cause the moments, from the part's middle.

        Args:
            at: number of the trial, whose path gives the hand's rotation.
            wrench: along its path, or along the beginning of it; N and Nm.

        Returns:
            Forward and left, m; NaN where less than 1 N presses along the hand.
        """
        rotation = self._rotations[at][: len(wrench)]
        force = np.einsum("tji,tj->ti", rotation, wrench[:, :3])
        reference = np.asarray(self.presets[self.trials[at].session].sensor.reference)
        moment = np.einsum("tji,tj->ti", rotation, wrench[:, 3:]) + np.cross(reference, force)
        up = np.where(np.abs(force[:, 0]) < 1.0, np.nan, force[:, 0])  # x of the wrist points up the hand, z backwards
        back = (moment[:, 1] + TIP_HEIGHT * force[:, 2]) / up
        left = (TIP_HEIGHT * force[:, 1] - moment[:, 2]) / up
        return np.stack([-back, left], axis=1)

    def _load_residual(self, at: int, wrench: Wrench) -> Float64[np.ndarray, " residual"]:
        """Residuals of the load's place, by windows in which the recorded hand was pressed."""
        pressed, recorded = self._recorded_loads[at]
        away = (self.load_point(at, wrench) - recorded)[self.trials[at].begin :] / LOAD_UNIT
        means = block_means(away, WINDOW)[pressed]
        means = np.clip(np.nan_to_num(means, nan=LOAD_LOST), -LOAD_LOST, LOAD_LOST)
        return (means / np.sqrt(max(len(means), 1))).ravel()

    @cached_property
    def _rotations(self) -> list[Float64[np.ndarray, "time 3 3"]]:
        return [np.asarray(jax.vmap(kinematics.fk)(trial.path)[1], np.float64) for trial in self.trials]

    @cached_property
    def _recorded_loads(self) -> list[tuple[Bool[np.ndarray, " window"], Float64[np.ndarray, "time 2"]]]:
        out = []
        for at, trial in enumerate(self.trials):
            up = np.einsum("tj,tj->t", self._rotations[at][:, :, 0], trial.wrench[:, :3])[trial.begin :]
            windows = up[: len(up) // WINDOW * WINDOW].reshape(-1, WINDOW)
            out.append(((windows > PRESSED).all(1), self.load_point(at, trial.wrench)))
        return out

    def simulate(self, candidates: list[Values]) -> list[list[Wrench]]:
        """Wrenches [candidate][trial], less their means before touch, NaN where the physics diverged."""
        longest = max(len(trial.path) for trial in self.trials)
        batch = [self._params(trial, values, longest) for values in candidates for trial in self.trials]
        run = engines.simulate(self.scene, stack(batch), self.engine)
        run.wrench[run.diverged] = np.nan
        lengths = [len(trial.path) for trial in self.trials] * len(candidates)
        wrenches = [_relative(wrench[:n].astype(np.float64)) for wrench, n in zip(run.wrench, lengths, strict=True)]
        return [wrenches[at : at + len(self.trials)] for at in range(0, len(wrenches), len(self.trials))]

    def parts(self, session: str, values: Values) -> PartParams:
        """The parts of one session."""
        return overrides.apply_overrides(self.presets[session].parts, "parts", physical(values, session))

    def _params(self, trial: DrivenTrial, values: Values, longest: int) -> DrivenParams:
        path = trial.path[np.minimum(np.arange(longest), len(trial.path) - 1)]
        parts, sensor = self.parts(trial.session, values), self.presets[trial.session].sensor
        return DrivenParams(parts, sensor, path, np.array(len(trial.path), np.int32))


def _residual(trial: DrivenTrial, wrench: Wrench, unit: Float64[np.ndarray, " 6"]) -> Float64[np.ndarray, " residual"]:
    away = np.nan_to_num((wrench - trial.wrench)[trial.begin :] / unit, nan=LOST)
    means = block_means(away, WINDOW)
    return (np.clip(means, -LOST, LOST) / np.sqrt(len(means))).ravel()


def block_means(values: Float64[np.ndarray, "time column"], samples: int) -> Float64[np.ndarray, "block column"]:
    """Means of blocks of ``samples`` samples; an incomplete block at the end is not used.

    >>> block_means(np.arange(5.0)[:, None], 2).tolist()
    [[0.5], [2.5]]
    """
    blocks = len(values) // samples
    return values[: blocks * samples].reshape(blocks, samples, values.shape[1]).mean(1)


def explained(trial: DrivenTrial, wrench: Wrench) -> Float64[np.ndarray, " 6"]:
    """Share of the variance of each axis of the recorded wrench that a simulated one explains, at most 1.

    >>> wrench = np.random.default_rng(0).normal(size=(200, 6))
    >>> trial = DrivenTrial("push", "B", np.zeros((200, 6)), wrench, 100)
    >>> explained(trial, wrench).tolist()
    [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    >>> explained(trial, wrench / 2).round(1).tolist()  # half of each value leaves about a quarter of the variance
    [0.7, 0.7, 0.7, 0.7, 0.7, 0.7]
    """
    recorded = trial.wrench[trial.begin :]
    left = ((wrench[trial.begin :] - recorded) ** 2).sum(0)
    return 1.0 - left / ((recorded - recorded.mean(0)) ** 2).sum(0)


def rows_with_angles(
    folder: Path, recordings: Recordings, rows: Int[np.ndarray, " row"], preset: SessionPreset
) -> list[int]:
    """The rows of recordings that have joint angles."""
    out = []
    for row in rows.tolist():
        try:
            recorded_angles(folder, recordings, row, preset)
        except InputError:
            continue
        out.append(row)
    return out
