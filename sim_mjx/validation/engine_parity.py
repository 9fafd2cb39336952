"""Parity of an engine with C MuJoCo: equal wrenches until the first contact, equal labels and outcomes after it.

A contact amplifies any difference, so that wrenches of two engines can be compared sample by sample only until the
first contact of any pair, which comes up to half a second before the controller notices one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Int64

from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.labels import LAYERS
from sim_mjx.assembly.rollout import Rollouts, single_trials
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import native
from sim_mjx.engines.native import Rows, States, Steps
from sim_mjx.synthesis.records import label

FORCE_LIMIT, MOMENT_LIMIT = 0.05, 0.005  # N, Nm, until the first contact
LABELS_LIMIT, OUTCOME_LIMIT = 0.95, 0.98  # shares of time and of trials
WINDOW = 5  # samples per window of the labels that are compared
NEVER = np.iinfo(np.int64).max
Contacts = Int64[np.ndarray, " trial"]  # control periods of the first contacts, ``NEVER`` without one
Codes = Int64[np.ndarray, "lane 6 time"]  # label of each sample of a wrist of a trial, 0 = none


@dataclass(frozen=True)
class Parity:
    """How an engine differs from the native one over a batch of trials."""

    trials: int
    touched: int  # trials in which anything touches
    force_until_contact: float  # N, largest difference of any axis before the first contact
    moment_until_contact: float  # Nm
    force_after_contact: float  # N, median difference
    labels: dict[str, float]  # layer -> share of time, over trials and axes, with the same label
    states: float  # share of time in the same state
    same_outcome: float  # share of trials
    onset_difference: float  # s, 95th percentile
    diverged: int  # trials of the other engine

    @property
    def holds(self) -> bool:
        """Whether the engine may replace the native one; False if nothing touched, since nothing was then tested."""
        wrench = self.force_until_contact <= FORCE_LIMIT and self.moment_until_contact <= MOMENT_LIMIT
        return (
            self.touched > 0
            and wrench
            and min(self.labels.values()) >= LABELS_LIMIT
            and self.same_outcome >= OUTCOME_LIMIT
        )


class _FirstContact:
    """Watches the native engine for the control period in which any pair of each trial first touches."""

    def __init__(self, scene: Scene, params: Any) -> None:
        self._models = [native.model_of(scene, parts) for parts in single_trials(params.parts)]
        self._data = mujoco.MjData(scene.model)
        self.period = np.full(len(self._models), NEVER)

    def watch(self, trials: Rows, state: States, *_: Steps) -> None:
        """See ``native.Watch``."""
        for row in np.flatnonzero(self.period[trials] == NEVER).tolist():
            model = self._models[trials[row]]
            mujoco.mj_setState(model, self._data, state[row], native.STATE)
            mujoco.mj_kinematics(model, self._data)
            mujoco.mj_comPos(model, self._data)
            mujoco.mj_collision(model, self._data)
            if self._data.ncon:  # a full physics state begins with the time
                self.period[trials[row]] = round(state[row, 0] / CONTROL_PERIOD)


def reference(scene: Scene, params: Any) -> tuple[Rollouts, Contacts]:
    """A batch of native trials, and their first contacts."""
    contact = _FirstContact(scene, params)
    return native.simulate(scene, params, watch=contact.watch), contact.period


def parity(expected: Rollouts, contact: Contacts, other: Rollouts) -> Parity:
    """Compare trials.

    Args:
        expected: native trials. contact: their first contacts; both of :func:`reference`.
        other: the same trials in another engine.
    """
    samples = min(expected.wrench.shape[1], other.wrench.shape[1])
    period = np.arange(samples)[None]
    shared = period < np.minimum(expected.length, other.length)[:, None]
    free = shared & (period < contact[:, None])
    error = np.abs(expected.wrench[:, :samples] - other.wrench[:, :samples])
    force, moment = np.moveaxis(error.reshape(*error.shape[:2], -1, 2, 3).max((2, 4)), 2, 0)
    touching = shared & ~free
    return Parity(
        trials=len(contact),
        touched=int((contact < samples).sum()),
        force_until_contact=float(force[free].max()),
        moment_until_contact=float(moment[free].max()),
        force_after_contact=float(np.median(force[touching])) if touching.any() else 0.0,
        labels=_label_agreement(expected, other, shared),
        states=float((_states(expected, samples) == _states(other, samples))[shared].mean()),
        same_outcome=float((expected.seated.all(1) == other.seated.all(1)).mean()),
        onset_difference=float(np.nanpercentile(np.abs(expected.onset - other.onset), 95)),
        diverged=int(other.diverged.sum()),
    )


def _label_agreement(expected: Rollouts, other: Rollouts, shared: Bool[np.ndarray, "trial time"]) -> dict[str, float]:
    """Share of time, over all trials and axes, in which both wrenches have the same label; layer by layer."""
    first, second = _labels(expected, shared.shape[1]), _labels(other, shared.shape[1])
    wrists = expected.wrench.shape[2] // 6
    wide = np.repeat(shared, wrists * 6, axis=0).reshape(-1, 6, shared.shape[1])
    return {layer: float((first[layer] == second[layer])[wide].mean()) for layer in LAYERS}


def _labels(out: Rollouts, samples: int) -> dict[str, Codes]:
    """Label of every sample, layer by layer."""
    config = EncoderConfig(window=WINDOW, dt=CONTROL_PERIOD)
    tracks = label(out, config, jnp.asarray(preset("hiro").limits, jnp.float32))
    labels = {}
    for layer in LAYERS:
        track = getattr(tracks, layer)
        used = track.label != 0
        lane = np.nonzero(used)[:2]
        # spans of a lane do not overlap: a label is switched on at its start and off at its end
        change = np.zeros((*track.label.shape[:2], out.wrench.shape[1] + 1), np.int64)
        np.add.at(change, (*lane, track.t0[used]), track.label[used])
        np.subtract.at(change, (*lane, track.t1[used]), track.label[used])
        labels[layer] = np.cumsum(change, axis=2)[:, :, :samples]
    return labels


def _states(out: Rollouts, samples: int) -> Int64[np.ndarray, "trial time"]:
    ticks = np.nan_to_num(np.round(out.onset / CONTROL_PERIOD), nan=np.inf)
    return (np.arange(samples)[None, :, None] >= ticks[:, None, :]).sum(2)
