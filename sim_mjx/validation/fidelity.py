"""How much the simulation can be trusted: solver, engines, kinematics and the wrench's likeness to the recordings.

Each function measures one of them and returns JSON values; limits are those that the project holds itself to.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.io.hiro import dat
from rcbht_jax.io.hiro.importer import find_trials
from rcbht_jax.io.hiro.names import parse_trial
from rcbht_jax.io.hiro.trial import data_file
from rcbht_jax.robots import hiro_kinematics
from sim_mjx import engines
from sim_mjx.assembly.rollout import TrialParams
from sim_mjx.assembly.scene import ITERATIONS, LS_ITERATIONS, one_arm
from sim_mjx.engines import native
from sim_mjx.presets import sessions as presets
from sim_mjx.randomization import trials as randomize
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.validation import sessions, signature
from sim_mjx.validation.engine_parity import FORCE_LIMIT as FORCE
from sim_mjx.validation.engine_parity import LABELS_LIMIT, OUTCOME_LIMIT, reference
from sim_mjx.validation.engine_parity import MOMENT_LIMIT as MOMENT
from sim_mjx.validation.engine_parity import parity as compared
from sim_mjx.validation.replay import Recorder, seated_snaps
from sim_mjx.validation.sessions import Target
from sim_mjx.validation.signature import Similarity
from sim_mjx.validation.solver_convergence import FORCE_LIMIT, MOMENT_LIMIT, certify

Floats = NDArray[np.float64]
COVERAGE, W1, DTW = 0.64, 0.75, 0.67  # as near as session A is to session B
HELD = ("A", "B")  # sessions that the limits are for
ONSETS = {"A": 0.3}  # s, largest error of a median onset
RING = (0.05, 0.15)  # shares by which session A's ring may be off in frequency and in peak
# Largest rms distance (mm) and turn (degrees) of computed and recorded tool poses; the angles of session A are
# encoder readings beside commanded poses. Source: the identification of the kinematic table.
POSE_LIMITS = {"A": (0.3, 0.1), "B": (0.01, 0.002), "C": (0.01, 0.002), "openhrp": (0.01, 0.002)}
# Folders whose poses are of another point of the hand or of another base height.
OTHER_POSE = ("ERROR-14", "20120426")


def mixed_trials(count: int, seed: int, longest: float | None) -> TrialParams:
    """Randomised trials with and without faults, of all one-arm presets in turn."""
    names = list(presets.PRESETS)
    spec = DomainRandomization(longest=longest)
    drawn = [randomize.sample(names[index % len(names)], seed, index, spec)[0] for index in range(count)]
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *drawn)


def convergence(trials: int = 64, seed: int = 0, longest: float = 13.0) -> dict[str, Any]:
    """Production settings of the solver against far more iterations; see ``certificate``."""
    found = certify(mixed_trials(trials, seed, longest))
    return {
        "settings": [ITERATIONS, LS_ITERATIONS],
        **asdict(found),
        "limits": {"force": FORCE_LIMIT, "moment": MOMENT_LIMIT},
        "holds": found.converged,
    }


def parity(engine: str, trials: int = 64, seed: int = 0, longest: float = 13.0) -> dict[str, Any]:
    """The same trials in another engine and in the native one; see ``sim_mjx.validation.engine_parity``.

    Raises:
        InputError: unknown engine.
    """
    params, scene = mixed_trials(trials, seed, longest), one_arm()
    expected, contact = reference(scene, params)
    found = compared(expected, contact, engines.simulate(scene, params, engine))
    limits = {"force": FORCE, "moment": MOMENT, "labels": LABELS_LIMIT, "outcome": OUTCOME_LIMIT}
    return {"engine": engine, **asdict(found), "limits": limits, "holds": found.holds}


def kinematics(folder: Path) -> dict[str, Any]:
    """Tool poses of the MuJoCo model at recorded joint angles, during the approach, against the recorded poses.

    Args:
        folder: of the authors' data sets, or one of them.

    Returns:
        per session: trials, rms distance in mm and rms turn in degrees over all samples.

    Raises:
        InputError: the folder holds no trial with angles and poses.
    """
    scene = one_arm()
    data, site = mujoco.MjData(scene.model), scene.model.site("RARM_TCP").id
    errors: dict[str, list[Floats]] = {name: [] for name in POSE_LIMITS}
    for source, trial in find_trials(folder):
        name = parse_trial(source, trial.name)
        session = {"SIM1": "openhrp"}.get(name.session, name.session)
        # recorded failures of the simulation log their poses in another way
        usable = session in errors and not any(word in trial.name for word in OTHER_POSE)
        if not usable or (session == "openhrp" and name.outcome != "success"):
            continue
        pair = _approach(trial, session)
        if pair is not None:
            errors[session].append(_pose_errors(scene.model, data, site, scene.joints, *pair))
    out: dict[str, Any] = {}
    for session, found in errors.items():
        if found:
            distance, turn = np.sqrt((np.concatenate(found) ** 2).mean(0)).tolist()
            most = POSE_LIMITS[session]
            holds = bool(distance <= most[0] and turn <= most[1])
            row = {"trials": len(found), "rms_mm": distance, "rms_degrees": turn, "limits": list(most), "holds": holds}
            out[session] = row
    if not out:
        raise InputError(f"{folder} holds no trial with R_Angles.dat, R_CartPos.dat and R_State.dat.")
    return out


def _approach(trial: Path, session: str) -> tuple[Floats, Floats] | None:
    """Joint angles [n, 6] and tool poses [n, 6] before contact; None where a file or the mark is missing."""
    paths = [data_file(trial, "R", kind) for kind in ("Angles", "CartPos", "State")]
    if None in paths:
        return None
    try:
        angles, pose = (dat.read_timed(path, "joint angles") for path in paths[:2] if path is not None)
        marks = dat.read_state_times(paths[2]) if paths[2] is not None else np.zeros(0)
    except InputError:
        return None
    if len(marks) < 2:
        return None
    # the commanded pose is logged one period late; session A's angles are read, not commanded
    late = 0 if session == "A" else 1
    contact = min(round(marks[1] / angles.dt) - 5, len(angles.values) + late, len(pose.values))
    if contact <= late + 10:
        return None
    joints = angles.values[: contact - late, :6].copy()
    if session == "C":
        joints[:, 5] -= hiro_kinematics.FAILURE_SESSION_Q5_OFFSET
    return joints, pose.values[late:contact, :6]


def _pose_errors(
    model: mujoco.MjModel, data: mujoco.MjData, site: int, address: NDArray[np.int32], joints: Floats, poses: Floats
) -> Floats:
    """Distance (mm) and turn (degrees) [n, 2]."""
    place, turn = np.zeros((len(joints), 3)), np.zeros((len(joints), 3, 3))
    for row, now in enumerate(joints):
        data.qpos[address] = now
        mujoco.mj_kinematics(model, data)
        place[row], turn[row] = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
    away = np.linalg.norm(place - poses[:, :3], axis=1) * 1e3
    # the chord between two rotations keeps its precision at small angles, where the trace loses it
    chord = np.linalg.norm(turn - hiro_kinematics.rpy_rotation(poses[:, 3:]), axis=(1, 2))
    return np.stack([away, np.degrees(2 * np.arcsin(np.minimum(chord / np.sqrt(8), 1.0)))], 1)


def session(target: Target, count: int | None = None, seed: int = 0) -> tuple[dict[str, Any], Figure | None]:
    """A session simulated as it was done, beside its recordings.

    Args:
        target: the recorded session.
        count: trials; default the session's own number.
        seed: of the simulation.

    Returns:
        the result and the figure of the bands; no figure where no simulated trial mated for a second.
    """
    name = target.session
    params = sessions.trials_of(name, count, seed=seed)
    recorder = Recorder(one_arm(), len(params.command_delay))
    run = native.simulate(one_arm(), params, watch=recorder.watch)
    seated = run.seated.all(1)
    onset = np.nanmedian(sessions.harmonised(run)[:, 1:], axis=0) if np.isfinite(run.onset[:, 3]).any() else None
    result: dict[str, Any] = {
        "trials": len(run.length),
        "recorded_trials": len(target.profiles),
        "seated": float(seated.mean()),
        "onsets": None if onset is None else onset.tolist(),
        "recorded_onsets": target.onset.tolist(),
    }
    if name == "B":
        result["outcomes_as_recorded"] = [sessions.agreement(run), len(run.length)]
    rings = sessions.rings(run.wrench[..., 2], run.length, run.onset[:, 3])
    result |= {"ring": rings, "recorded_ring": target.ring}
    result |= {"snaps": seated_snaps(run, recorder), "recorded_snaps": target.snaps}
    found = sessions.profiles(run)
    if len(found) == 0:
        return {**result, "mated": 0, "limits": None, "holds": False if name in HELD else None}, None
    score = signature.compare(target.profiles, found)
    result |= {
        "mated": len(found), "coverage": score.coverage, "w1_over_sd": score.w1_over_sd,
        "dtw_over_sd": score.dtw_over_sd, "limits": None, "holds": None,
    }  # fmt: skip
    if name in HELD:
        holds = _alike(name, score, np.abs(np.array(onset) - target.onset).max(), rings, target.ring)
        result |= {"limits": {"coverage": COVERAGE, "w1_over_sd": W1, "dtw_over_sd": DTW}, "holds": holds}
    title = f"Session {name}: recorded and simulated"
    return result, signature.signature_figure(target.profiles, found, title, ("recorded", "simulated"))


def _alike(
    name: str, score: Similarity, late: float, found: dict[str, float] | None, recorded: dict[str, float] | None
) -> bool:
    """Whether a session's simulation keeps within the limits; session A's ring is one of them."""
    good = score.coverage >= COVERAGE and score.w1_over_sd <= W1 and score.dtw_over_sd <= DTW
    if name == "A" and found is not None and recorded is not None:
        off = [abs(found[key] / recorded[key] - 1) for key in ("hertz", "peak")]
        good = good and off[0] <= RING[0] and off[1] <= RING[1]
    return bool(good and late <= ONSETS.get(name, np.inf))
