"""The two-arm task: kinematics, signature per arm, displacement of the left hand under load, seating, convergence.

Run: python -m experiments.classification.two_arm
Reads the authors' two-arm trials (RCBHT_DATA); simulates with the native engine; about 10 minutes on 2 cores. Writes
experiments/results/two_arm.json and the signature pictures docs/images/two-arm-right.png and two-arm-left.png.
"""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from experiments._lib.benchmarks import SIM2
from experiments._lib.catalogue import DATA
from experiments._lib.results_io import pictures, write_result
from experiments._lib.simulated import assembled
from rcbht_jax.io.hiro import dat
from rcbht_jax.io.hiro.importer import read_hiro
from rcbht_jax.robots import kinematics
from rcbht_jax.robots.snap_assembly import HARMONISED, RECORDED
from rcbht_jax.types import Recordings
from sim_mjx.assembly.controllers import approach
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.assembly.two_arm_scene import ARMS, two_arm
from sim_mjx.engines import native
from sim_mjx.presets import TWO_ARM
from sim_mjx.presets import two_arm as presets
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.randomization.two_arm import REPEATED
from sim_mjx.registry import get_scenario
from sim_mjx.validation import signature
from sim_mjx.validation.solver_convergence import certify

SEED = 0
LIKE_RECORDED, MILD, CERTIFIED, FAULTY = 16, 64, 64, 64  # trials
SHARES = (0.0, 0.1, 0.2, 0.5, 1.0)  # of the right arm's gains
NAMES = {"R": "right", "L": "left"}


def simulated(name: str, count: int, spec: DomainRandomization) -> tuple[Rollouts, list[str], float]:
    """Trials of a preset, their faults and the seconds that the physics took."""
    params, faults = get_scenario(name).draw_batch(SEED, range(count), spec)
    start = time.perf_counter()
    run = native.simulate(two_arm(), params)
    return run, [fault.kind for fault in faults], time.perf_counter() - start


def angles(folder: Path, arm: str) -> np.ndarray:
    return dat.read_timed(folder / f"{arm}_Angles.dat", "joint angles").values


def forward_kinematics(root: Path) -> dict[str, Any]:
    """The compiled model against the kinematic table on every recorded angle, and the recorded approach's shape."""
    model = two_arm().model
    data = mujoco.MjData(model)
    out: dict[str, Any] = {}
    for arm in ARMS:
        addresses = [model.joint(f"{arm}ARM_JOINT{i}").qposadr[0] for i in range(6)]
        distance, turn = [], []
        for folder in sorted(root.iterdir()):
            q = angles(folder, arm)[::20]
            _, rotation, tcp = kinematics.fk(q, arm)
            for row in range(len(q)):
                data.qpos[addresses] = q[row]
                mujoco.mj_kinematics(model, data)
                site = data.site(f"{arm}ARM_TCP")
                distance.append(np.linalg.norm(site.xpos - tcp[row]))
                turn.append(angle_between(site.xmat.reshape(3, 3), rotation[row]))
        out[f"{NAMES[arm]}, model against table, rms mm"] = rms(np.array(distance) * 1e3)
        out[f"{NAMES[arm]}, model against table, rms degrees"] = rms(np.array(turn))
    return out | recorded_approach(root)


def recorded_approach(root: Path) -> dict[str, Any]:
    """The preset's waypoints and inverse kinematics against the recorded angles up to just before contact."""
    task = presets.TASK
    near, turn, still = [], [], []
    for folder in sorted(root.iterdir()):
        q = angles(folder, "R")
        t = np.arange(len(q)) * CONTROL_PERIOD
        free = (t >= task.way_time[0]) & (t < 3.9)
        planned = approach(task.home, task.way_time, task.way_position, task.way_rpy, t[free])
        _, expected, tcp = kinematics.fk(q[free])
        _, rotation, position = kinematics.fk(planned)
        near.append(np.linalg.norm(tcp - position, axis=1))
        turn.append([angle_between(a, b) for a, b in zip(rotation, expected, strict=True)])
        still.append(np.ptp(angles(folder, "L"), axis=0).max())
    return {
        "right, planned against recorded approach from 2 s on, rms mm": rms(np.concatenate(near) * 1e3),
        "right, planned against recorded approach from 2 s on, rms degrees": rms(np.concatenate(turn)),
        "left, largest change of a recorded angle, rad": float(max(still)),
        "left, recorded pose against the preset's, rad": float(
            max(np.abs(angles(folder, "L")[0] - presets.HOLD.home).max() for folder in root.iterdir())
        ),
    }


def angle_between(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(first - second) / np.sqrt(2)))  # of small angles


def rms(values: np.ndarray) -> float:
    return float(f"{np.sqrt(np.mean(values**2)):.3g}")


def as_recordings(run: Rollouts, name: str) -> Recordings:
    """Both arms of the simulated trials that reached mating, as the importer stores them."""
    end = (run.length - 1) * CONTROL_PERIOD
    complete = np.flatnonzero((np.diff(run.onset, axis=1) > 0).all(1) & (run.onset[:, 3] < end) & ~run.diverged)
    count, arms = len(complete), len(ARMS)
    wrench = run.wrench[complete].reshape(count, -1, arms, 6).swapaxes(1, 2).reshape(count * arms, -1, 6)
    rows = np.repeat(complete, arms)
    onset, length = run.onset[rows], run.length[rows]
    seated = np.where(run.seated[complete].all(1), "success", "failure")
    return assembled(
        wrench, length, onset, name, outcome=np.repeat(seated, arms), arm=np.tile(ARMS, count),
        trial=np.repeat([f"{name}-{i}" for i in complete], arms),
    )  # fmt: skip


def profiles(recordings: Recordings, arm: str) -> np.ndarray:
    complete = np.isfinite(recordings.starts(HARMONISED)).all(1)
    return signature.profiles(recordings, np.flatnonzero(complete & (recordings.arm == arm)))


def signatures(recorded: Recordings, run: Rollouts, picture: bool) -> dict[str, Any]:
    synthetic = as_recordings(run, "two")
    out: dict[str, Any] = {}
    for arm, name in NAMES.items():
        reference, test = profiles(recorded, arm), profiles(synthetic, arm)
        score = signature.compare(reference, test)
        out[name] = {key: round(getattr(score, key), 3) for key in ("coverage", "w1_over_sd", "dtw_over_sd")}
        halves = [signature.compare(reference[i::2], reference[1 - i :: 2]) for i in (0, 1)]
        out[f"{name}, recorded half against half"] = {
            key: round(float(np.mean([getattr(half, key) for half in halves])), 3) for key in out[name]
        }
        if picture:
            title = f"Two arms, {name} wrist, its own frame"
            figure = signature.signature_figure(reference, test, title, ("recorded", "simulated"))
            figure.savefig(pictures() / f"two-arm-{name}.png", dpi=70)
    full = np.isfinite(recorded.starts(RECORDED)).all(1)
    out["median onsets, recorded, s"] = np.round(np.median(recorded.starts(RECORDED)[full], axis=0), 3).tolist()
    out["median onsets, simulated, s"] = np.round(np.nanmedian(run.onset, axis=0), 3).tolist()
    return out


def way_of_left_hand(run: Rollouts) -> dict[str, Any]:
    """How far the left wrist is from where it began, mm: back = pushed off by the right hand."""
    back, across, final = [], [], []
    for row, samples in enumerate(run.length):
        wrist, rotation, _ = kinematics.fk(run.joints[row, :samples, 6:].astype(np.float64), "L")
        way = (wrist - wrist[0]) @ rotation[0] * 1e3
        back.append(way[:, 0].max())
        across.append(np.hypot(way[:, 1], way[:, 2]).max())
        final.append(way[-1, 0])
    push = np.nanmedian(np.abs(run.wrench[..., 6] - TWO_ARM["two"].offset[6]).max(1))
    return {
        "largest, along the hand, median mm": round(float(np.median(back)), 3),
        "largest, across, median mm": round(float(np.median(across)), 3),
        "at the end, along the hand, median mm": round(float(np.median(final)), 3),
        "largest push along the hand, logged, median N": round(float(push), 2),
    }


def by_gain() -> dict[str, Any]:
    """Way of the left hand and seating in trials like the recorded ones, by the left arm's share of the gains."""
    out: dict[str, Any] = {}
    params, _ = get_scenario("two").draw_batch(SEED, range(LIKE_RECORDED), REPEATED)
    for share, goal in [*((share, 1.0) for share in SHARES), (presets.HOLD_SHARE, 0.0)]:
        factor, held = share / presets.HOLD_SHARE, params.hold
        held = replace(
            held, force_gain=held.force_gain * factor, moment_gain=held.moment_gain * factor, force=held.force * goal,
            moment=held.moment * goal,
        )  # fmt: skip
        run = native.simulate(two_arm(), replace(params, hold=held))
        name = f"{share:g}" if goal else f"{share:g}, all set-points zero"
        out[name] = way_of_left_hand(run) | {"seated": round(float(run.seated.all(1).mean()), 3)}
    return out


def seating(run: Rollouts, faults: list[str], seconds: float) -> dict[str, Any]:
    seated = np.atleast_1d(run.seated.all(1))
    by_fault = {kind: seated[np.array(faults) == kind] for kind in sorted({*faults})}
    return {
        "trials": len(seated),
        "seated": round(float(seated.mean()), 3),
        "seated by fault": {kind: f"{int(rows.sum())} of {len(rows)}" for kind, rows in by_fault.items()},
        "diverged": int(run.diverged.sum()),
        "median onsets, s": np.round(np.nanmedian(run.onset, axis=0), 3).tolist(),
        "trials per minute": round(len(seated) / seconds * 60),
    }


def main() -> None:
    root = DATA / SIM2
    recorded, _ = read_hiro(root)
    result: dict[str, Any] = {"recorded trials": len(recorded) // 2, "forward kinematics": forward_kinematics(root)}
    mild = DomainRandomization(nominal_share=1.0)
    for name in TWO_ARM:
        run, _, _ = simulated(name, LIKE_RECORDED, REPEATED)
        varied, faults, seconds = simulated(name, MILD, mild)
        result[name] = {
            "signature of trials like the recorded ones": signatures(recorded, run, picture=name == "two-fixed"),
            "way of the left hand": way_of_left_hand(varied),
            "mildly randomised": seating(varied, faults, seconds),
            "faulty": seating(*simulated(name, FAULTY, DomainRandomization(nominal_share=0.0))),
        }
    result["way of the left hand by share of the right arm's gains"] = by_gain()
    params, _ = get_scenario("two").draw_batch(SEED, range(CERTIFIED), mild)
    certificate = certify(params, two_arm)
    result["certificate of the solver"] = asdict(certificate) | {"converged": certificate.converged}
    write_result("two_arm", "python -m experiments.classification.two_arm", result, seed=SEED)


if __name__ == "__main__":
    main()
