"""A trial as it moved: simulated again from its seed, or the arm led through the recorded joint angles.

A simulated trial is fully determined by what its store holds, so that physics, tabs and mount are those of the
trial. Of a recorded one only the joint angles are known: the arm follows them, the parts stand still.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.data import dat, hiro_kinematics, store
from rcbht_jax.data.hiro_trial import data_file
from rcbht_jax.errors import InputError
from rcbht_jax.types import Recordings
from sim_mjx import kinematics, parts, randomize
from sim_mjx.engines import native
from sim_mjx.engines.common import past_lips
from sim_mjx.randomize import Randomisation
from sim_mjx.rollout import Rollouts, TrialParams
from sim_mjx.scene import Scene, one_arm
from sim_mjx.synth import LANES

Floats = NDArray[np.float64]
PASSES = " past lip"  # of a tab's name, in the names of moments


@dataclass(frozen=True)
class Replay:
    """A trial's motion, one row per sample of its wrench."""

    model: mujoco.MjModel  # with the trial's own parts
    qpos: Floats  # [time, nq]
    dt: float  # s between rows
    past: NDArray[np.bool_]  # [time, tab] tabs beyond their lips, order of parts.TABS
    height: Floats  # [time, tab] m, tips above the place at which they count as past their lips
    how: str  # where the motion comes from, one sentence


class Recorder:
    """Keeps what the native engine passes by: give its ``watch`` to ``native.simulate``."""

    def __init__(self, scene: Scene, trials: int) -> None:
        self._scene, self._trials = scene, trials
        self._qpos: list[Floats] = []
        self._raw: list[Floats] = []

    def watch(self, live: NDArray[np.intp], state: Floats, wanted: Floats, sensors: Floats) -> None:
        """Called by the engine once per control period; an ended trial keeps its last values."""
        del wanted
        nq = self._scene.model.nq
        qpos = self._qpos[-1].copy() if self._qpos else np.zeros((self._trials, nq))
        raw = self._raw[-1].copy() if self._raw else np.zeros((self._trials, 6))
        qpos[live] = state[:, 1 : 1 + nq]  # a full physics state begins with the time
        force = int(self._scene.forces[0])
        raw[live] = -sensors[:, 0, force : force + 6]
        self._qpos.append(qpos)
        self._raw.append(raw)

    @property
    def qpos(self) -> Floats:
        """Positions [trial, period, nq] at the beginning of each control period."""
        return np.stack(self._qpos, 1)

    @property
    def raw(self) -> Floats:
        """What the part exerted on the hand [trial, period, 6], wrist frame, before the sensor's chain."""
        return np.stack(self._raw, 1)

    def raw_in_world(self, run: Rollouts) -> Floats:
        """Raw forces [trial, period, 3] in the world's axes, N, without the tool's weight at the start."""
        force = self.raw[..., :3]
        _, rotation, _ = kinematics.fk(run.joints[:, : force.shape[1]].astype(np.float64))
        return ((force - force[:, :1])[..., None, :] * rotation[:, : force.shape[1]]).sum(-1)


def simulated(path: Path, recordings: Recordings, row: int) -> Replay:
    """Simulate a stored trial again.

    Args:
        path: store made by "rcbht simulate". recordings: its content. row: of the trial.

    Raises:
        InputError: the store was not simulated, or by a version whose options are unknown here.
    """
    params = stored_trial(path, row)
    scene = one_arm()
    # as in synthesis, a batch is filled up: a compiler may round a single trial differently
    batch = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], LANES, axis=0), params)
    timeout = np.where(np.arange(LANES) == 0, batch.task.timeout, 0.0)  # the others end at once
    batch = replace(batch, task=replace(batch.task, timeout=timeout))
    recorder = Recorder(scene, LANES)
    run = native.simulate(scene, batch, watch=recorder.watch)
    samples = int(run.length[0])
    qpos = _as_long_as(recorder.qpos[0], samples)
    model = native.model_of(scene, params.parts)
    past, height = tab_states(scene, model, qpos)
    return Replay(model, qpos, recordings.dt, past, height, _likeness(run, recordings, row))


def stored_trial(path: Path, row: int) -> TrialParams:
    """Parameters of a stored trial: its store holds the seed, the index and the distributions.

    Raises:
        InputError: the store was not simulated, or by a version whose options are unknown here.
    """
    made = store.read_attrs(path).get("simulated")
    if made is None:
        raise InputError(f'{path} was not made by "rcbht simulate"; its trials cannot be simulated again.')
    job, index = made["job"], int(store.read_simulation(path)["index"][row])
    try:
        spec = Randomisation(**{name: _tuples(value) for name, value in job["spec"].items()})
        return randomize.draw(job["preset"], job["seed"], index, spec)[0]
    except (TypeError, KeyError) as error:
        raise InputError(f"{path} was simulated by another version of rcbht; simulate its trials anew.") from error


def _tuples(value: Any) -> Any:
    """JSON lists back into the tuples that they were."""
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _as_long_as(rows: Floats, samples: int) -> Floats:
    """The first rows, the last one repeated where there are too few."""
    return rows[np.minimum(np.arange(samples), len(rows) - 1)]


def _likeness(run: Rollouts, recordings: Recordings, row: int) -> str:
    samples = int(run.length[0])
    if samples != recordings.length[row]:
        had = recordings.length[row] * recordings.dt
        return f"simulated again; differs from the stored trial: {samples * recordings.dt:.2f} s, stored {had:.2f} s"
    gap = np.abs(run.wrench[0, :samples] - recordings.wrench[row, :samples])[:, :3].max()
    said = "equal to the stored trial" if gap == 0 else f"forces within {gap:.2g} N of the stored trial"
    return f"simulated again; {said}"


def recorded(folder: Path, recordings: Recordings, row: int) -> Replay:
    """Lead the arm through the joint angles that a robot recorded.

    Args:
        folder: of the authors' data sets, or one of them. recordings: imported from it. row: of the trial.

    Raises:
        InputError: the trial's folder or its angles are not there, or the trial is not of the one-arm scene.
    """
    trial, source = str(recordings.trial[row]), str(recordings.source[row])
    places = [place for place in (folder / source / trial, folder / trial) if place.is_dir()]
    if not places:
        raise InputError(f"{folder} holds no trial {source}/{trial}; give the folder that was imported: --data DIR.")
    if "L" in recordings.arm[(recordings.trial == trial) & (recordings.source == source)]:
        raise InputError(f"{trial} was done with two arms; only trials of the right arm alone can be replayed.")
    path = data_file(places[0], "R", "Angles")
    if path is None:
        raise InputError(f"{places[0]} holds no R_Angles.dat; without joint angles there is nothing to replay.")
    angles = dat.read_timed(path, "joint angles").values[:, :6].copy()
    session = str(recordings.session[row])
    if session == "C":
        angles[:, 5] -= hiro_kinematics.FAILURE_SESSION_Q5_OFFSET
    scene = one_arm()
    part = parts.nominal({"SIM1": "openhrp"}.get(session, session if session in parts.SESSION_SHIFT else "A"))
    model = native.model_of(scene, part)
    qpos = np.zeros((len(angles), scene.model.nq))
    qpos[:, scene.joints] = angles
    qpos = _as_long_as(qpos, int(recordings.length[row]))
    past, height = tab_states(scene, model, qpos)
    how = "arm led through the recorded joint angles; the parts stand still where the session's are taken to be"
    return Replay(model, qpos, recordings.dt, past, height, how)


def tab_states(scene: Scene, model: mujoco.MjModel, qpos: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """Per row of positions [time, nq]: tabs past their lips [time, tab], and their heights above that, m."""
    data = mujoco.MjData(model)
    places = np.zeros((len(qpos), len(scene.tips), 3))
    lips, turns = np.zeros_like(places), np.zeros((*places.shape, 3))
    for row, now in enumerate(qpos):
        data.qpos[:] = now
        mujoco.mj_kinematics(model, data)
        places[row], lips[row] = data.geom_xpos[scene.tips], data.geom_xpos[scene.lips]
        turns[row] = data.geom_xmat[scene.lips].reshape(-1, 3, 3)
    past = np.asarray(past_lips(places, lips, turns))
    local = ((places - lips)[..., None, :] * np.swapaxes(turns, -1, -2)).sum(-1)
    return past, local[..., 2] - (parts.LIP[2] - parts.TIP_RADIUS * 0.2)


def moments(replay: Replay, onset: Floats) -> dict[str, float]:
    """Moments that tell a trial's story, name -> s, in order: what was reached, and when tabs passed for good.

    Args:
        replay: how it moved.
        onset: of its states [4], s, NaN = never reached.
    """
    touch, turned, mating = (float(at) for at in onset[1:])
    found = {"before touch": max(touch - 0.6, 0.0) if np.isfinite(touch) else 0.0}
    for name, at in (("touch", touch), ("rotation", (touch + turned) / 2), ("insertion", turned), ("mating", mating)):
        if np.isfinite(at):
            found[name] = at
    # a tab is in from the moment after which it stays past its lip
    for tab in np.flatnonzero(replay.past[-1]):
        first = len(replay.past) - int(np.argmin(np.append(replay.past[::-1, tab], False)))
        found[f"{parts.TABS[tab]}{PASSES}"] = first * replay.dt
    found["end"] = (len(replay.qpos) - 1) * replay.dt
    return dict(sorted(found.items(), key=lambda item: item[1]))
