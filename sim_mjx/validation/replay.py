"""The motion of a trial: simulated again from its seed, or the arm moved through the recorded joint angles.

A simulated trial is fully determined by its store, so physics, tabs and mount are those of the trial. Of a recorded
one only the joint angles are known: the arm follows them, the parts stand still.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.hiro import dat
from rcbht_jax.io.hiro.trial import data_file
from rcbht_jax.robots import kinematics
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import Recordings
from sim_mjx.assembly import parts
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.scene import Scene
from sim_mjx.engines import native
from sim_mjx.engines.native import Rows, States, Steps
from sim_mjx.presets import ONE_ARM
from sim_mjx.presets.session import SessionPreset
from sim_mjx.registry import Scenario, get_scenario
from sim_mjx.synthesis.plan import scenario_of
from sim_mjx.validation import snaps

Floats = NDArray[np.float64]
Positions = Float64[np.ndarray, "time nq"]  # of the model, m and rad
Past = Bool[np.ndarray, "time tab"]  # tabs past their lips, order of parts.TABS
PASSES = " past lip"  # follows a tab's name in the names of events
MIDDLE = "mid-rotation"  # the only event of a state that is not its start, which is the touch


@dataclass(frozen=True)
class Replay:
    """A trial's motion, one row per sample of its wrench."""

    model: mujoco.MjModel  # with the trial's own parts
    qpos: Positions
    dt: float  # s between rows
    past: Past
    height: Float64[np.ndarray, "time tab"]  # m, tips above the height at which they count as past their lips
    how: str  # the origin of the motion, one sentence
    marks: tuple[str, ...] = parts.TABS  # names of what ``past`` and ``height`` are about
    missing: tuple[str, ...] = ()  # names of tabs that have broken off

    @property
    def of_parts(self) -> bool:
        """Whether it is an assembly of ``sim_mjx.assemblies``, not the recorded one."""
        return self.marks != parts.TABS


class Recorder:
    """Records positions and sensor readings: pass its ``watch`` to ``native.simulate``."""

    def __init__(self, scene: Scene, trials: int) -> None:
        self._scene = scene
        self._rows: list[list[tuple[Floats, Floats]]] = [[] for _ in range(trials)]

    def watch(self, trials: Rows, state: States, wanted: Steps, sensors: Steps) -> None:
        """Called by the engine once per control period of some trials."""
        del wanted
        qpos = state[:, 1 : 1 + self._scene.model.nq]  # a full physics state begins with the time
        wrench = (self._scene.forces[:, None] + np.arange(6)).ravel()
        for trial, now, raw in zip(trials.tolist(), qpos.copy(), -sensors[:, 0, wrench], strict=True):
            self._rows[trial].append((now, raw))

    def qpos(self, trial: int) -> Positions:
        """Positions at the beginning of each control period."""
        return np.stack([now for now, _ in self._rows[trial]])

    def raw(self, trial: int) -> Float64[np.ndarray, "time reading"]:
        """Wrench of the parts on the hands, six readings per wrist, N and Nm, wrist frames, before the sensor."""
        return np.stack([raw for _, raw in self._rows[trial]])


def raw_force(recorder: Recorder, run: Rollouts, trial: int) -> Float64[np.ndarray, "time 3"]:
    """Right hand's force, N, world axes, before the sensor, without the tool's weight at the start."""
    force = recorder.raw(trial)[:, :3]
    _, rotation, _ = kinematics.fk(run.joints[trial, : len(force), :6].astype(np.float64))
    return ((force - force[0])[:, None, :] * rotation).sum(-1)


def find_snaps(run: Rollouts, recorder: Recorder, among: slice = slice(None)) -> dict[int, list[snaps.Snap]]:
    """Snaps in the force before the sensor, of the trials that seated, by row."""
    mated = run.seated.all(1) & np.isfinite(run.onset[:, 3])
    rows = [row for row in np.arange(len(mated))[among].tolist() if mated[row]]
    return {row: snaps.find(raw_force(recorder, run, row)[:, 2], float(run.onset[row, 1])) for row in rows}


def seated_snaps(run: Rollouts, recorder: Recorder, among: slice = slice(None)) -> dict[str, Any]:
    """What :func:`find_snaps` finds, counted; see ``snaps.summary``."""
    return snaps.summary(list(find_snaps(run, recorder, among).values()))


def simulated(path: Path, recordings: Recordings, row: int) -> Replay:
    """Simulate a stored trial again.

    Args:
        path: store made by "rcbht simulate". recordings: its content. row: of the recording.

    Raises:
        InputError: the store was not simulated, or by a version whose options are unknown here.
    """
    scenario, params = stored_trial(path, row)
    scene = scenario.scene()
    recorder = Recorder(scene, 1)
    run = native.simulate(scene, jax.tree.map(lambda leaf: np.asarray(leaf)[None], params), watch=recorder.watch)
    qpos = _as_long_as(recorder.qpos(0), int(run.length[0]))
    model = native.model_of(scene, params.parts)
    past, height = tab_states(scene, model, qpos)
    columns = slice(6 * scenario.arms.index(str(recordings.arm[row])), None)
    how = _difference(run.wrench[0, : run.length[0], columns][:, :6], recordings, row)
    if not scenario.recorded:
        return Replay(model, qpos, recordings.dt, past, height, how, tuple(model.geom(i).name for i in scene.tips))
    missing = tuple(parts.TABS[tab] for tab in np.flatnonzero(params.parts.missing))
    return Replay(model, qpos, recordings.dt, past, height, how, missing=missing)


def stored_trial(path: Path, row: int) -> tuple[Scenario, Any]:
    """Scenario and parameters of a stored recording, drawn again from its seed, index and distributions.

    Raises:
        InputError: the store was not simulated, or by a version whose options are unknown here.
    """
    provenance = store.read_attrs(path).get("simulated")
    if provenance is None:
        raise InputError(f'{path} was not made by "rcbht simulate"; its trials cannot be simulated again.')
    job, index = provenance["job"], int(store.read_simulation(path)["index"][row])
    try:
        scenario, spec = scenario_of(job)
        return scenario, scenario.draw(job["seed"], index, spec)[0]
    except InputError:  # its message already says what is wrong
        raise
    except (TypeError, KeyError, ValueError) as error:
        raise InputError(f"{path} was simulated by another version of rcbht; simulate its trials anew.") from error


def _as_long_as(rows: Floats, samples: int) -> Floats:
    """The first rows, the last one repeated where there are too few."""
    return rows[np.minimum(np.arange(samples), len(rows) - 1)]


def _difference(wrench: NDArray[np.float32], recordings: Recordings, row: int) -> str:
    samples, stored = len(wrench), int(recordings.length[row])
    if samples != stored:
        seconds = (samples * recordings.dt, stored * recordings.dt)
        return "simulated again; differs from the stored trial: {:.2f} s, stored {:.2f} s".format(*seconds)
    gap = np.abs(wrench - recordings.wrench[row, :samples])
    if not gap.any():
        return "simulated again; equal to the stored trial"
    force, moment = gap[:, :3].max(), gap[:, 3:].max()
    return f"simulated again; forces within {force:.2g} N of the stored trial, moments within {moment:.2g} Nm"


def recorded(folder: Path, recordings: Recordings, row: int) -> Replay:
    """Move the arms through the recorded joint angles.

    Args:
        folder: of the authors' data sets, or one of them. recordings: imported from it. row: of the recording.

    Raises:
        InputError: the trial's folder or its angles are missing.
    """
    trial, source = str(recordings.trial[row]), str(recordings.source[row])
    place = _place(folder, recordings, row)
    same = (recordings.trial == trial) & (recordings.source == source)
    scenario = get_scenario("two" if "L" in recordings.arm[same] else preset_of(str(recordings.session[row])))
    scene = scenario.scene()
    angles = [_angles(place, arm, scenario.preset.last_joint_offset) for arm in scenario.arms]
    samples = int(recordings.length[row])
    qpos = np.zeros((samples, scene.model.nq))
    qpos[:, scene.joints] = np.concatenate([_as_long_as(one, samples) for one in angles], axis=1)
    model = native.model_of(scene, scenario.preset.parts)
    past, height = tab_states(scene, model, qpos)
    how = "arm moved through the recorded joint angles; the parts stand still in the session's assumed place"
    return Replay(model, qpos, recordings.dt, past, height, how)


def preset_of(session: str) -> str:
    """The one-arm preset of a recorded session; OpenHRP's for an unknown one."""
    return session if session in ONE_ARM else "openhrp"


def recorded_angles(
    folder: Path, recordings: Recordings, row: int, preset: SessionPreset
) -> Float64[np.ndarray, "time 6"]:
    """Joint angles of a recorded arm, rad; arguments and errors of :func:`recorded`."""
    return _angles(_place(folder, recordings, row), str(recordings.arm[row]), preset.last_joint_offset)


def _place(folder: Path, recordings: Recordings, row: int) -> Path:
    """The folder of a recorded trial."""
    trial, source = str(recordings.trial[row]), str(recordings.source[row])
    places = [place for place in (folder / source / trial, folder / trial) if place.is_dir()]
    if not places:
        raise InputError(f"{folder} holds no trial {source}/{trial}; give the folder that was imported: --data DIR.")
    return places[0]


def _angles(trial: Path, arm: str, last_joint_offset: float) -> Floats:
    """Joint angles [n, 6] of one arm, rad, less the offset of the last joint."""
    path = data_file(trial, arm, "Angles")
    if path is None:
        raise InputError(f"{trial} holds no {arm}_Angles.dat; without joint angles there is nothing to replay.")
    angles = dat.read_timed(path, "joint angles").values[:, :6].copy()
    angles[:, 5] -= last_joint_offset
    return angles


def tab_states(scene: Scene, model: mujoco.MjModel, qpos: Positions) -> tuple[Past, Float64[np.ndarray, "time tab"]]:
    """Per row of positions: tabs past their lips, and their heights above that, m."""
    data = mujoco.MjData(model)
    places = np.zeros((len(qpos), len(scene.tips), 3))
    lips, turns = np.zeros_like(places), np.zeros((*places.shape, 3))
    for row, now in enumerate(qpos):
        data.qpos[:] = now
        mujoco.mj_kinematics(model, data)
        places[row], lips[row] = data.geom_xpos[scene.tips], data.geom_xpos[scene.lips]
        turns[row] = data.geom_xmat[scene.lips].reshape(-1, 3, 3)
    local = parts.from_lips(places, lips, turns)
    return np.asarray(scene.seated(local)), local[..., 2] - scene.past


def events(replay: Replay, recordings: Recordings, row: int) -> dict[str, float]:
    """Key events of a trial, name -> s, in order: :func:`moments` of the recorded assembly, else the phases."""
    if HARMONISED in recordings.annotations.labels:
        return moments(replay, recordings.starts(HARMONISED)[row])
    track = recordings.annotations.choose()
    names, starts = recordings.annotations.labels[track], recordings.starts(track)[row].tolist()
    times = {name: start for name, start in zip(names, starts, strict=True) if np.isfinite(start)}
    end = "end of the trial" if "end" in times else "end"  # a phase may have this name
    return times | {end: (len(replay.qpos) - 1) * replay.dt}


def moments(replay: Replay, onset: Float64[np.ndarray, " 4"]) -> dict[str, float]:
    """Key events of a trial, name -> s, in order.

    They are the touch, with which the rotation begins, the middle of the rotation, the starts of insertion and mating,
    the passes of tabs that stay past their lips, and the end.

    Args:
        replay: of the trial.
        onset: of its states, s, NaN = never reached.
    """
    touch, turned, mating = (float(at) for at in onset[1:])
    passes = {}
    # a tab is in from the moment after which it stays past its lip
    for tab in np.flatnonzero(replay.past[-1]):
        first = len(replay.past) - int(np.argmin(np.append(replay.past[::-1, tab], False)))
        passes[f"{parts.TABS[tab]}{PASSES}"] = first * replay.dt
    met = touch if np.isfinite(touch) else min(passes.values(), default=0.0)  # a hand may jam before it feels a touch
    events = {"before touch": max(met - 0.6, 0.0)}
    for name, at in (("touch", touch), (MIDDLE, (touch + turned) / 2), ("insertion", turned), ("mating", mating)):
        if np.isfinite(at):
            events[name] = at
    events |= passes | {"end": (len(replay.qpos) - 1) * replay.dt}
    return dict(sorted(events.items(), key=lambda item: item[1]))
