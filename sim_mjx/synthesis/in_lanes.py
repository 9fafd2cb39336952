"""Shards of trials on the lanes of a device: simulated, labelled and reduced there to what is stored."""

from __future__ import annotations

import ctypes
import sys
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from threading import Lock
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

from rcbht_jax.encoding.batch import begin_encoding
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.types import Array, LabelTracks
from sim_mjx import engines
from sim_mjx.assembly.rollout import Program, batch_size
from sim_mjx.assembly.scene import Scene
from sim_mjx.engines.device import Outcome
from sim_mjx.engines.lanes import Lanes
from sim_mjx.synthesis import records
from sim_mjx.synthesis.records import Arrays
from sim_mjx.synthesis.regroup import Regroup, Shard, Trial

COPIES = 2  # batches whose copies to the host overlap
LENGTHS = 16  # to which trials are cut before they are copied: each is a program to compile
BLOCK = 4096  # angles: whole blocks, since a compiler may round the last lanes differently


Item = TypeVar("Item")


class Measured(NamedTuple):
    """What the host needs of trials; zero after a trial's end, and where the physics diverged."""

    wrench: Float[Array, "trial time reading"]
    length: Int[Array, " trial"]
    entered: Int[Array, "trial phase"]  # control period in which each began, -1 = never
    seated: Bool[Array, "trial tab"]
    past: UInt8[Array, "trial time byte"]  # tabs past their lips, eight to a byte, the first one in its lowest bit
    diverged: Bool[Array, " trial"]
    tilt: Float[Array, "trial time"] | None  # rad, of the hand from the vertical; None = not needed


def simulate_in_lanes(
    scene: Scene,
    batches: Iterable[tuple[Hashable, Any]],
    engine: str,
    lanes: int,
    at_once: int,
    config: EncoderConfig | None = None,
    limits: Float[Array, "6 4"] | None = None,
    *,
    recorded: bool = True,
    ready: Callable[[], bool] = lambda: True,
    room: Callable[[], bool] = lambda: True,
) -> Iterator[Shard]:
    """Simulate and label batches that share the lanes of a device.

    A batch is yielded once its last trial has ended and the next trials have left the device, because labels are
    fetched that much later. Copies to the host and the work there overlap with the physics.

    Args:
        scene: what is simulated.
        batches: (key, batch of trials of the scene's program).
        engine: "mjx", "warp" or "fused".
        lanes: trials that are stepped together.
        at_once: trials that leave the device together, best those of a batch.
        config: of the encoder; None = no labels. limits: thresholds, N/s and Nm/s.
        recorded: as for :func:`sim_mjx.synthesis.records.of_trials`.
        ready: whether the next batch is available without waiting.
        room: whether the caller takes shards now; otherwise they stay on the device.

    Raises:
        InputError: unknown engine, or what it needs is not installed.
    """
    engines.check(engine)
    group, one_at_a_time = Regroup(), Lock()

    def expected() -> Iterator[tuple[Hashable, Any]]:
        for key, params in batches:
            with one_at_a_time:
                group.expect(key, batch_size(params))
            yield key, params

    def onto_host(trials: list[Trial], there: Measured, tracks: LabelTracks | None) -> list[Shard]:
        rows, labels = to_host(there, scene.program), jax.device_get(tracks)
        with one_at_a_time:
            shards = group.add(trials, rows, labels)
        give_back_memory()
        return shards

    def begun(out: Outcome) -> Callable[[], LabelTracks | None]:
        if config is None or limits is None:
            return lambda: None
        return begin_encoding(config, limits, *records.by_wrist(out.wrench, out.length))

    machine = Lanes(scene, engines.ON_DEVICE[engine], lanes, at_once)
    with ThreadPoolExecutor(COPIES) as host:
        waiting: deque[Future[list[Shard]]] = deque()

        def more() -> bool:
            return room() and sum(not one.done() for one in waiting) < COPIES

        # Labels are requested when trials have ended and fetched when the next ones have, so that the host never waits.
        labelled = (
            (trials, cut(measure(out, recorded), samples), begun(out))
            for trials, out, samples in machine.run(expected(), ready=ready, room=more)
        )
        for trials, there, ended in one_later(labelled):
            waiting.append(host.submit(onto_host, trials, there, ended()))
            while waiting and (waiting[0].done() or len(waiting) > COPIES):  # more would fill the memory
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()


def give_back_memory() -> None:
    """Return freed memory to the system: the C library keeps a gigabyte that compilers used."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None  # of glibc only
    if trim is not None:
        trim(0)


def one_later(items: Iterable[Item]) -> Iterator[Item]:
    """The items, each once the next one is available.

    >>> list(one_later("abc"))
    ['a', 'b', 'c']
    """
    held = deque[Item]()
    for item in items:
        held.append(item)
        if len(held) > 1:
            yield held.popleft()
    yield from held


@partial(jax.jit, static_argnums=1)
def measure(out: Outcome, recorded: bool) -> Measured:
    """Reduce trials to the stored quantities: the logs of all joints would be three quarters of the copied bytes.

    Args:
        out: the trials.
        recorded: whether the tilt of the hand is needed.
    """
    at = out.phase[:, :, None] == jnp.arange(out.program.ended)[None, None]
    entered = jnp.where(at.any(1), jnp.maximum(jnp.argmax(at, 1) - 1, 0), -1)
    length = out.length
    inside = jnp.arange(out.phase.shape[1])[None] < length[:, None]
    wild = ~(jnp.abs(out.wrench) <= records.MOST_WRENCH).all(2) | ~jnp.isfinite(out.joints).all(2)
    step = jnp.abs(jnp.diff(out.joints, axis=1)).max(2)
    jumped = ~(step <= records.MOST_STEP) & inside[:, 1:]
    diverged = (wild & inside).any(1) | jumped.any(1)
    wrench = jnp.where((inside & ~diverged[:, None])[..., None], out.wrench, 0.0)
    past = jnp.packbits(out.past, axis=2, bitorder="little")
    tilt = _tilt(out.joints) if recorded else None
    return Measured(wrench, length, entered, out.seated & ~diverged[:, None], past, diverged, tilt)


def cut(there: Measured, samples: int) -> Measured:
    """The trials without what is beyond all of them, which may be most: a few trials last to the limit.

    Args:
        there: the trials. samples: that the longest of them may have.
    """
    whole = there.wrench.shape[1]
    step = -(-whole // LENGTHS)
    return _first(there, min(-(-samples // step) * step, whole))


@partial(jax.jit, static_argnums=1)
def _first(there: Measured, samples: int) -> Measured:
    tilt = None if there.tilt is None else there.tilt[:, :samples]
    return there._replace(wrench=there.wrench[:, :samples], past=there.past[:, :samples], tilt=tilt)


def _tilt(joints: Float[Array, "trial time joint"]) -> Float[Array, "trial time"]:
    flat = joints[..., :6].reshape(-1, 6)
    whole = jnp.pad(flat, ((0, -len(flat) % BLOCK), (0, 0)))
    return records.tilt(whole)[: len(flat)].reshape(joints.shape[:2])


def to_host(there: Measured, program: Program) -> Arrays:
    """Stored arrays of trials, as of :func:`sim_mjx.synthesis.records.of_trials`, copied from the device."""
    here = jax.device_get(there)
    samples, tabs = here.length.max(), here.seated.shape[1]
    past = np.unpackbits(here.past[:, :samples], axis=2, count=tabs, bitorder="little").astype(np.bool_)
    wrench, onset = here.wrench[:, :samples], program.onsets(here.entered)
    angles = None if here.tilt is None else partial(_degrees, here.tilt)
    return records.stored(wrench, here.length, onset, here.seated, past, here.diverged, angles)


def _degrees(tilt: Float32[np.ndarray, "trial time"], spans: list[records.Span]) -> list[records.Degrees]:
    return [np.degrees(tilt[row, span].astype(np.float64)) for row, span in spans]
