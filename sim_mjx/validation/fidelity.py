"""Fidelity of the simulation: solver convergence, engine parity, kinematics, similarity to the recordings.

Each function measures one of them and returns JSON values with the limits that must hold.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float64, Int32
from matplotlib.figure import Figure

from rcbht_jax.errors import InputError
from rcbht_jax.io.hiro import dat
from rcbht_jax.io.hiro.importer import find_trials
from rcbht_jax.io.hiro.names import parse_trial
from rcbht_jax.io.hiro.trial import data_file
from rcbht_jax.robots.kinematics import rotation_from_rpy
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts, TrialParams
from sim_mjx.assembly.scene import ITERATIONS, LS_ITERATIONS, one_arm
from sim_mjx.engines import native
from sim_mjx.presets import ONE_ARM
from sim_mjx.presets.session import SessionPreset
from sim_mjx.randomization.trials import DomainRandomization, sample_batch
from sim_mjx.validation import gate, sessions, signature, snaps
from sim_mjx.validation.dynamics import Dynamics, dynamics
from sim_mjx.validation.engine_parity import FORCE_LIMIT, LABELS_LIMIT, MOMENT_LIMIT, OUTCOME_LIMIT, reference
from sim_mjx.validation.engine_parity import parity as compared
from sim_mjx.validation.replay import Recorder, seated_snaps
from sim_mjx.validation.sessions import Target
from sim_mjx.validation.solver_convergence import certify

Errors = Float64[np.ndarray, "_sample 2"]  # mm and degrees
Poses = Float64[np.ndarray, "sample 6"]  # joint angles, rad; or place and roll, pitch, yaw of the tool, m and rad
# Folders whose poses are of another point of the hand or of another base height.
OTHER_POSE = ("ERROR-14", "20120426")


def _trials(session: SessionPreset, count: int, seed: int, longest: float) -> TrialParams:
    """Randomised trials with and without faults."""
    return sample_batch(session, seed, range(count), DomainRandomization(longest=longest))[0]


def convergence(session: SessionPreset, trials: int = 16, seed: int = 0, longest: float = 13.0) -> dict[str, Any]:
    """Production settings of the solver against far more iterations; see ``solver_convergence``."""
    certificate = certify(_trials(session, trials, seed, longest), session.scene)
    return {
        "settings": [ITERATIONS, LS_ITERATIONS],
        **asdict(certificate),
        "limits": {"force": FORCE_LIMIT, "moment": MOMENT_LIMIT},
        "holds": certificate.converged,
    }


def parity(
    engine: str, session: SessionPreset, trials: int = 16, seed: int = 0, longest: float = 13.0
) -> dict[str, Any]:
    """The same trials in another engine and in the native one; see ``sim_mjx.validation.engine_parity``.

    Raises:
        InputError: unknown engine.
    """
    params, scene = _trials(session, trials, seed, longest), session.scene()
    expected, contact = reference(scene, params)
    differences = compared(expected, contact, engines.simulate(scene, params, engine))
    limits = {"force": FORCE_LIMIT, "moment": MOMENT_LIMIT, "labels": LABELS_LIMIT, "outcome": OUTCOME_LIMIT}
    return {"engine": engine, **asdict(differences), "limits": limits, "holds": differences.holds}


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
    errors: dict[str, list[Errors]] = {name: [] for name in ONE_ARM}
    by_recording = {preset.recorded_as: preset for preset in ONE_ARM.values()}
    for source, trial in find_trials(folder):
        name = parse_trial(source, trial.name)
        session = by_recording.get(name.session)
        if session is None or any(word in trial.name for word in OTHER_POSE):
            continue
        # recorded failures of the simulation log their poses in another way
        pair = _approach(trial, session) if session.real or name.outcome == "success" else None
        if pair is not None:
            errors[session.name].append(_pose_errors(scene.model, data, site, scene.joints, *pair))
    out: dict[str, Any] = {}
    for key, rows in errors.items():
        limits = ONE_ARM[key].pose_limits
        if rows and limits is not None:
            distance, turn = np.sqrt((np.concatenate(rows) ** 2).mean(0)).tolist()
            holds = bool(distance <= limits[0] and turn <= limits[1])
            row = {"trials": len(rows), "rms_mm": distance, "rms_degrees": turn, "limits": list(limits)}
            out[key] = row | {"holds": holds}
    if not out:
        raise InputError(f"{folder} holds no trial with R_Angles.dat, R_CartPos.dat and R_State.dat.")
    return out


def _approach(trial: Path, session: SessionPreset) -> tuple[Poses, Poses] | None:
    """Joint angles and tool poses before contact; None where a file or the mark is missing."""
    paths = [data_file(trial, "R", kind) for kind in ("Angles", "CartPos", "State")]
    found = [path for path in paths if path is not None]
    if len(found) < len(paths):
        return None
    try:
        angles, pose = (dat.read_timed(path, "joint angles") for path in found[:2])
        marks = dat.read_state_times(found[2])
    except InputError:
        return None
    if len(marks) < 2:
        return None
    late = session.pose_lag
    contact = min(round(marks[1] / angles.dt) - 5, len(angles.values) + late, len(pose.values))
    if contact <= late + 10:
        return None
    joints = angles.values[: contact - late, :6].copy()
    joints[:, 5] -= session.last_joint_offset
    return joints, pose.values[late:contact, :6]


def _pose_errors(
    model: mujoco.MjModel, data: mujoco.MjData, site: int, address: Int32[np.ndarray, " 6"], joints: Poses, poses: Poses
) -> Errors:
    """Distance and turn."""
    place, turn = np.zeros((len(joints), 3)), np.zeros((len(joints), 3, 3))
    for row, now in enumerate(joints):
        data.qpos[address] = now
        mujoco.mj_kinematics(model, data)
        place[row], turn[row] = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
    away = np.linalg.norm(place - poses[:, :3], axis=1) * 1e3
    # the chord between two rotations keeps its precision at small angles, where the trace loses it
    chord = np.linalg.norm(turn - rotation_from_rpy(poses[:, 3:]), axis=(1, 2))
    return np.stack([away, np.degrees(2 * np.arcsin(np.minimum(chord / np.sqrt(8), 1.0)))], 1)


def session(target: Target, count: int | None = None, seed: int = 0) -> tuple[dict[str, Any], Figure | None]:
    """A session simulated as it was recorded, compared with its recordings.

    Args:
        target: the recorded session.
        count: trials; default the session's own number.
        seed: of the simulation.

    Returns:
        the result and the figure of the bands; no figure where no simulated trial mated for a second.
    """
    recorded = target.session
    run, events, found = rerun(recorded, count, seed)
    seated = run.seated.all(1)
    onset = np.nanmedian(sessions.harmonised(run)[:, 1:], axis=0) if np.isfinite(run.onset[:, 3]).any() else None
    result: dict[str, Any] = {
        "trials": len(run.length),
        "recorded_trials": len(target.profiles),
        "seated": float(seated.mean()),
        "onsets": None if onset is None else onset.tolist(),
        "recorded_onsets": target.onset.tolist(),
    }
    if recorded.placements:
        result["outcomes_as_recorded"] = [sessions.agreement(recorded, run), len(run.length)]
    result |= {"ring": _ring(events), "recorded_ring": _ring(target.dynamics)}
    result |= {"snaps": found, "recorded_snaps": target.snaps}
    simulated = sessions.profiles(run)
    result |= {"mated": len(simulated), "gate": {}, "holds": False}
    if len(simulated) == 0:
        return result, None
    if len(simulated) >= gate.LEAST and onset is not None and recorded.gate is not None:
        checks = gate.checks(
            recorded.gate,
            target.profiles,
            simulated,
            (target.dynamics, events),
            snap_shares(target, found),
            float(np.abs(onset - target.onset).max()),
        )
        result |= {"gate": gate.as_json(checks), "holds": all(check.holds for check in checks.values())}
    title = f"Session {recorded.name}: recorded and simulated"
    return result, signature.signature_figure(target.profiles, simulated, title, ("recorded", "simulated"))


def rerun(session: SessionPreset, count: int | None = None, seed: int = 0) -> tuple[Rollouts, Dynamics, dict[str, Any]]:
    """A session simulated as it was recorded, its fast events, and the snaps of its seated trials."""
    params = sessions.trials_of(session, count, seed=seed)
    scene = session.scene()
    recorder = Recorder(scene, len(params.command_delay))
    run = native.simulate(scene, params, watch=recorder.watch)
    events = dynamics(run.wrench[..., 2], run.length, run.onset[:, 1], run.onset[:, 3])
    return run, events, seated_snaps(run, recorder)


def snap_shares(target: Target, found: dict[str, Any]) -> tuple[float, float] | None:
    """Shares of seated trials with a snap, recorded and simulated; None where no recorded trial seated."""
    if not target.snaps or not target.snaps["trials"]:
        return None
    return snaps.share(target.snaps), snaps.share(found)


def _ring(events: Dynamics) -> dict[str, float] | None:
    return None if events.ring is None else events.ring._asdict()
