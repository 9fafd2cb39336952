"""Arrays that are stored of a batch of trials: diverged trials marked, onsets as in recorded trials; and labels."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import fields
from threading import Lock
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Shaped
from numpy.typing import NDArray

from rcbht_jax.encoding.batch import encode_on_device
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.io.hiro import onsets
from rcbht_jax.labels import LAYERS
from rcbht_jax.robots import kinematics
from rcbht_jax.types import Array, LabelTrack, LabelTracks
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts, batch_size
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines.common import blocks
from sim_mjx.synthesis.regroup import Regroup, Shard, Trial

Arrays = dict[str, Shaped[np.ndarray, "_row ..."]]  # by name
LABEL_FIELDS = tuple(field.name for field in fields(LabelTrack))
COPIES = 2  # batches that are copied to the host at the same time
TILTS = 2**16  # angles that are computed at once
# No robot of this kind measures or moves so much: beyond, the physics has diverged, finite or not.
MOST_WRENCH, MOST_STEP = 2000.0, 0.1  # N or Nm; rad per control period


def of_trials(out: Rollouts, recorded: bool = True) -> Arrays:
    """Stored arrays of a batch of trials; a diverged trial has only its mark.

    Args:
        out: of the engine.
        recorded: whether it is the recorded assembly, whose ends of rotation are moved as in recorded trials.
    """
    diverged = _diverged(out)
    # a trial that was stopped has "entered" all later states with its last sample
    last = (out.length - 1)[:, None] * CONTROL_PERIOD
    onset = np.where((out.onset < last - CONTROL_PERIOD / 2) | (np.arange(out.onset.shape[1]) == 0), out.onset, np.nan)
    if recorded:
        better, notes = _harmonised(onset, out, diverged)
    else:
        better, notes = onset, np.full(len(onset), "")
    wrench = out.wrench[:, : out.length.max()]
    if (diverged & ~out.diverged).any():  # whose wrench an engine has not emptied
        wrench = np.where(diverged[:, None, None], np.float32(0), wrench)
    return {
        "wrench": wrench, "length": out.length,
        "onset": onset, "onset_harmonised": better, "note": notes, "seated": out.seated,
        "diverged": diverged,
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
    """Trials [trial] that are not data: marked by the engine, or with a wrench or a motion that cannot be.

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


def _harmonised(
    onset: NDArray[np.float64], out: Rollouts, diverged: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.str_]]:
    """Onsets [trial, 4] with the end of a rotation that lasted one sample moved, as in recorded trials; and notes."""
    better, notes = onset.copy(), [""] * len(onset)
    rows = [
        row for row in np.flatnonzero(~diverged).tolist()
        if onsets.needs_harmonising(onset[row], CONTROL_PERIOD)
    ]  # fmt: skip
    ends = np.where(np.isfinite(onset[:, 3]), np.round(onset[:, 3] / CONTROL_PERIOD), out.length).astype(np.int64)
    spans = [slice(int(np.round(onset[row, 1] / CONTROL_PERIOD)), int(ends[row])) for row in rows]
    tilts = _tilts([out.joints[row, span, :6] for row, span in zip(rows, spans, strict=True)])
    for row, span, tilt in zip(rows, spans, tilts, strict=True):
        times = np.arange(span.start, span.stop, dtype=np.float64) * CONTROL_PERIOD
        better[row], notes[row] = onsets.harmonised(onset[row], times, tilt)
    return better, np.array(notes, np.str_)


def _tilts(joints: list[NDArray[np.float32]]) -> list[NDArray[np.float64]]:
    """Angles [n] in degrees between hand and vertical, for each array of joint angles [n, 6]."""
    if not joints:
        return []
    flat = np.concatenate(joints)
    angles = np.empty(-(-len(flat) // TILTS) * TILTS)
    for start in range(0, len(flat), TILTS):
        block = np.zeros((TILTS, 6), np.float32)  # always full: a compiler may round the last lanes differently
        block[: len(flat) - start] = flat[start : start + TILTS]
        angles[start : start + TILTS] = _tilt(block)
    return np.split(np.degrees(angles[: len(flat)]), np.cumsum([len(part) for part in joints])[:-1])


@jax.jit
def _tilt(joints: jax.Array) -> jax.Array:
    return kinematics.tilt(kinematics.fk(joints)[1])


def simulate_labelled(
    scene: Scene,
    params: Any,
    engine: str,
    config: EncoderConfig,
    limits: Float[Array, "6 4"],
    *,
    progress: Callable[[int], None] | None = None,
) -> tuple[Rollouts, LabelTracks]:
    """Simulate a batch of trials and label their wrenches.

    Args:
        scene: what is simulated.
        params: batch of trials of the scene's program.
        engine: one of ``engines.ENGINES``.
        config: of the encoder.
        limits: thresholds, N/s and Nm/s.
        progress: called with the number of control periods done since the last call, summed over trials.

    Returns:
        the trials, and host arrays of labels [trial * K, 6, slot], the wrists of a trial one after another. Labels of
        a diverged trial mean nothing.

    Raises:
        InputError: unknown engine, or what it needs is not installed.
    """
    engines.check(engine)
    if engine == "native":
        out = engines.simulate(scene, params, engine, progress=progress)
        return out, label(out, config, limits)
    from sim_mjx.engines import device  # MJX takes seconds to import

    there = device.run(scene, params, engines.IMPLEMENTATIONS[engine], progress=progress)
    tracks = encode_on_device(config, limits, *_by_wrist(there.wrench, there.length))
    return device.to_host(there), jax.device_get(tracks)


def simulate_in_lanes(
    scene: Scene,
    batches: Iterable[tuple[Hashable, Any]],
    engine: str,
    lanes: int,
    at_once: int,
    config: EncoderConfig | None = None,
    limits: Float[Array, "6 4"] | None = None,
) -> Iterator[Shard]:
    """Simulate and label batches that share the lanes of a device; each comes when its last trial has ended.

    Copies to the host and what is done there overlap with the physics.

    Args:
        scene: what is simulated.
        batches: (key, batch of trials of the scene's program).
        engine: "mjx" or "warp".
        lanes: trials that are stepped together.
        at_once: trials that leave the device together, best those of a batch.
        config: of the encoder; None = no labels. limits: thresholds, N/s and Nm/s.

    Raises:
        InputError: unknown engine, or what it needs is not installed.
    """
    engines.check(engine)
    from sim_mjx.engines import device  # MJX takes seconds to import
    from sim_mjx.engines.lanes import Lanes

    group, one_at_a_time = Regroup(), Lock()

    def expected() -> Iterator[tuple[Hashable, Any]]:
        for key, params in batches:
            with one_at_a_time:
                group.expect(key, batch_size(params))
            yield key, params

    def onto_host(trials: list[Trial], out: device.Outcome, tracks: LabelTracks | None) -> list[Shard]:
        rollouts, labels = device.to_host(out), jax.device_get(tracks)
        with one_at_a_time:
            return group.add(trials, rollouts, labels)

    machine = Lanes(scene, engines.IMPLEMENTATIONS[engine], lanes, at_once)
    with ThreadPoolExecutor(COPIES) as host:
        waiting: deque[Future[list[Shard]]] = deque()
        for trials, out in machine.run(expected()):
            tracks = None
            if config is not None and limits is not None:
                tracks = encode_on_device(config, limits, *_by_wrist(out.wrench, out.length))
            waiting.append(host.submit(onto_host, trials, out, tracks))
            while waiting and (waiting[0].done() or len(waiting) > COPIES):  # more would fill the memory
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()


def label(out: Rollouts, config: EncoderConfig, limits: Float[Array, "6 4"]) -> LabelTracks:
    """Labels of trials on the host; see :func:`simulate_labelled`."""
    return jax.device_get(
        encode_on_device(config, limits, *_by_wrist(jnp.asarray(out.wrench), jnp.asarray(out.length)))
    )


def _by_wrist(wrench: Array, length: Array) -> tuple[Array, Array]:
    """One recording per wrist: wrench [trial, time, 6K] -> [trial * K, time, 6]."""
    trials, samples, columns = wrench.shape
    wrists = columns // 6
    apart = wrench.reshape(trials, samples, wrists, 6).swapaxes(1, 2).reshape(-1, samples, 6)
    return apart, jnp.repeat(length, wrists, total_repeat_length=trials * wrists)
