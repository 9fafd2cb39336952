"""Arrays that are stored of a batch of trials, with diverged trials marked, and their labels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int, Shaped
from numpy.typing import NDArray

from rcbht_jax.encoding.batch import encode_on_device
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.io.hiro import onsets
from rcbht_jax.labels import LAYERS
from rcbht_jax.robots import kinematics
from rcbht_jax.types import Array, LabelTrack, LabelTracks
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines.common import blocks
from sim_mjx.synthesis.passes import passes_of

Arrays = dict[str, Shaped[np.ndarray, "_row ..."]]  # by name
Span = tuple[int, slice]  # number of a trial, and samples of it
Degrees = Float64[np.ndarray, " sample"]
LABEL_FIELDS = tuple(field.name for field in fields(LabelTrack))
TILTS = 2**16  # angles that are computed at once
# No robot of this kind measures or moves so much: beyond, the physics has diverged, finite or not.
MOST_WRENCH, MOST_STEP = 2000.0, 0.1  # N or Nm; rad per control period


def of_trials(out: Rollouts, recorded: bool = True) -> Arrays:
    """Stored arrays of a batch of trials; a diverged trial has only its mark.

    Args:
        out: of the engine.
        recorded: whether it is the recorded assembly, whose ends of rotation are moved as in recorded trials.
    """
    diverged, wrench = _diverged(out), out.wrench
    if (diverged & ~out.diverged).any():  # whose wrench an engine has not emptied
        wrench = np.where(diverged[:, None, None], np.float32(0), wrench)
    angles = partial(tilts, out.joints) if recorded else None
    return stored(wrench, out.length, out.onset, out.seated, out.past, diverged, angles)


def stored(
    wrench: Float[np.ndarray, "trial time reading"],
    length: Int[np.ndarray, " trial"],
    onset: Float64[np.ndarray, "trial state"],
    seated: Bool[np.ndarray, "trial tab"],
    past: Bool[np.ndarray, "trial time tab"],
    diverged: Bool[np.ndarray, " trial"],
    tilts: Callable[[list[Span]], list[Degrees]] | None,
) -> Arrays:
    """The arrays by name; ``tilts`` as for :func:`harmonised`, None = the ends of rotations stay as they are."""
    better, notes = onset, np.full(len(onset), "")
    if tilts is not None:
        better, notes = harmonised(onset, length, diverged, tilts)
    return {
        "wrench": wrench, "length": length,
        "onset": onset, "onset_harmonised": better, "note": notes, "seated": seated,
        "passes": passes_of(past, np.where(diverged, 0, length)), "diverged": diverged,
    }  # fmt: skip


def of_labels(tracks: LabelTracks, trials: int) -> Arrays:
    """Labels of ``trials`` trials: arrays [trial, wrist, 6, slot] called ``layer.field``, no longer than needed."""
    arrays = {}
    for layer in LAYERS:
        track = getattr(tracks, layer)
        used = max(1, int(np.count_nonzero(track.label, axis=-1).max()))  # how many are spare depends on the batch
        for name in LABEL_FIELDS:
            values = np.asarray(getattr(track, name))[..., :used]
            arrays[f"{layer}.{name}"] = values.reshape(trials, -1, 6, used)
    return arrays


def _diverged(out: Rollouts) -> NDArray[np.bool_]:
    """Trials [trial] that are unusable: marked by the engine, or with an impossible wrench or motion.

    An engine may reset a trial that came apart, whose values are then finite again.
    """
    diverged = out.diverged.copy()
    for rows in blocks(len(diverged)):
        inside = np.arange(out.wrench.shape[1]) < out.length[rows, None]
        wild = (~(np.abs(out.wrench[rows]) <= MOST_WRENCH).all(2) & inside).any(1)
        step = np.abs(np.diff(out.joints[rows], axis=1)).max(2)
        jumped = (~(step <= MOST_STEP) & inside[:, 1:]).any(1)
        diverged[rows] |= wild | jumped
    return diverged


def harmonised(
    onset: Float64[np.ndarray, "trial 4"],
    length: Int[np.ndarray, " trial"],
    diverged: Bool[np.ndarray, " trial"],
    tilts: Callable[[list[Span]], list[Degrees]],
) -> tuple[Float64[np.ndarray, "trial 4"], Shaped[np.ndarray, " trial"]]:
    """Onsets with the end of a rotation that lasted one sample moved, as in recorded trials; and notes.

    Args:
        onset: starts of the states, s, NaN = never reached.
        length: samples of each trial.
        diverged: trials that are left as they are.
        tilts: angles between hand and vertical in spans of trials.
    """
    better, notes = onset.copy(), [""] * len(onset)
    rows = [
        row for row in np.flatnonzero(~diverged).tolist()
        if onsets.needs_harmonising(onset[row], CONTROL_PERIOD)
    ]  # fmt: skip
    ends = np.where(np.isfinite(onset[:, 3]), np.round(onset[:, 3] / CONTROL_PERIOD), length).astype(np.int64)
    spans = [(row, slice(int(np.round(onset[row, 1] / CONTROL_PERIOD)), int(ends[row]))) for row in rows]
    for (row, span), tilt in zip(spans, tilts(spans), strict=True):
        times = np.arange(span.start, span.stop, dtype=np.float64) * CONTROL_PERIOD
        better[row], notes[row] = onsets.harmonised(onset[row], times, tilt)
    return better, np.array(notes, np.str_)


def tilts(joints: Float32[np.ndarray, "trial time joint"], spans: list[Span]) -> list[Degrees]:
    """Angles between hand and vertical in each span."""
    if not spans:
        return []
    each = [joints[row, span, :6] for row, span in spans]
    flat = np.concatenate(each)
    angles = np.empty(-(-len(flat) // TILTS) * TILTS)
    for start in range(0, len(flat), TILTS):
        block = np.zeros((TILTS, 6), np.float32)  # always full: a compiler may round the last lanes differently
        block[: len(flat) - start] = flat[start : start + TILTS]
        angles[start : start + TILTS] = tilt(block)
    return np.split(np.degrees(angles[: len(flat)]), np.cumsum([len(part) for part in each])[:-1])


@jax.jit
def tilt(joints: Float[Array, "*batch 6"]) -> Float[Array, "*batch"]:
    """Angle between hand and vertical, rad."""
    return kinematics.tilt(kinematics.fk(joints)[1])


def label(out: Rollouts, config: EncoderConfig, limits: Float[Array, "6 4"]) -> LabelTracks:
    """Host arrays of labels [trial * K, 6, slot], the wrists of a trial one after another.

    Labels of a diverged trial are undefined.

    Args:
        out: the trials. config: of the encoder. limits: thresholds, N/s and Nm/s.
    """
    onto = map(jnp.asarray, by_wrist(out.wrench, out.length))  # a GPU's kernels encode only what is on it
    return jax.device_get(encode_on_device(config, limits, *onto))


def by_wrist(wrench: Array, length: Array) -> tuple[Array, Array]:
    """One recording per wrist: wrench [trial, time, 6K] -> [trial * K, time, 6], with its length."""
    trials, samples, columns = wrench.shape
    wrists = columns // 6
    apart = wrench.reshape(trials, samples, wrists, 6).swapaxes(1, 2).reshape(-1, samples, 6)
    return apart, length.__array_namespace__().repeat(length, wrists)
