"""Trials in lanes: a lane whose trial has ended takes the next one, so that none waits for the longest.

A lane is a place in the batch that the device steps together. After each stretch of control periods the host learns
which trials have ended; new ones begin in their lanes. What a lane logs goes to its trial's slot of a buffer on the
device, from where finished trials are taken out together. What becomes of a trial does not depend on its lane or its
neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from rcbht_jax.types import Array
from sim_mjx.assembly.rollout import LogRow, Program, as_float32, batch_size
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import device
from sim_mjx.engines.common import SETTLING, compiler_options
from sim_mjx.engines.device import Fixed, Layout, Outcome, State

Trial = tuple[Hashable, int]  # key of its batch, and number in it


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Logs:
    """What trials logged, each in a slot: blocks of one stretch; the last slot takes what nobody wants."""

    wrench: Float[Array, "slot block time reading"]
    joints: Float[Array, "slot block time joint"]
    phase: Int[Array, "slot block time"]
    seated: Bool[Array, "slot tab"]


@dataclass
class Lanes:
    """Lanes of one scene on JAX's default device.

    Attributes:
        scene: what is simulated.
        impl: "jax" or "warp".
        count: lanes; rounded up to full vectors.
        at_once: finished trials that are taken out together.
        spare: slots for finished trials, beside one of each lane; default as many as lanes, or ``at_once``. With 0
            none is refilled early.
    """

    scene: Scene
    impl: str
    count: int
    at_once: int
    spare: int | None = None
    _busy: int = field(default=0, init=False)
    _offered: int = field(default=0, init=False)

    @property
    def utilisation(self) -> float:
        """Share of the control periods of all lanes that moved a trial which had not ended."""
        return self._busy / max(self._offered, 1)

    def run(
        self,
        batches: Iterable[tuple[Hashable, Any]],
        *,
        progress: Callable[[int], None] | None = None,
        ready: Callable[[], bool] = lambda: True,
        room: Callable[[], bool] = lambda: True,
    ) -> Iterator[tuple[list[Trial], Outcome]]:
        """Simulate batches of trials; yields finished trials, of which no more than ``at_once`` at a time.

        A batch stays on the device until all its trials have ended, unless lanes wait for its slots. What is yielded
        always has ``at_once`` rows, so that what follows is compiled once: those behind the trials mean nothing.

        Args:
            batches: (key, parameters of the scene's program), best none larger than the first; one is asked for when
                lanes are free.
            progress: called with the number of control periods done since the last call, summed over trials.
            ready: whether the next batch is there without waiting; lanes that are busy do not wait for it.
            room: whether what is yielded is wanted now; else it waits on the device while there are slots for others.
        """
        layout, programs = device.layout_of(self.scene), _programs(jax.default_backend())
        queue = _Queue(self.scene, iter(batches), ready)
        if not queue.refilled():
            return
        lanes = -(-self.count // device.LANES) * device.LANES
        slots = lanes + (max(self.at_once, lanes) if self.spare is None else self.spare)
        fixed = self._fixed(queue, lanes)
        state = programs.start(layout, fixed)
        free, done = list(range(slots))[::-1], _Done(self.at_once)
        trial: list[Trial | None] = [None] * lanes
        slot, age = np.full(lanes, slots), np.zeros(lanes, np.int64)
        logs: Logs | None = None
        fresh = True  # lanes begin with the first trials: nothing to copy
        while True:
            while (
                (idle := [lane for lane in range(lanes) if trial[lane] is None])
                and free
                and queue.refilled(wait=len(idle) == lanes)
            ):
                rows = queue.take(min(len(idle), len(free)))
                chosen = idle[: len(rows)]
                for lane, row in zip(chosen, rows, strict=True):
                    trial[lane], slot[lane], age[lane] = (queue.key, row), free.pop(), 0
                if not fresh:
                    begin = np.full(lanes, -1, np.int32)
                    begin[chosen] = rows
                    fixed, state = programs.refill(layout, fixed, state, queue.pool, begin)
                fresh = False
            working = np.array([one is not None for one in trial])
            if not working.any():
                break
            state, log = programs.stretch(layout, fixed, state)
            if logs is None:
                logs = _empty(log, slots + 1, queue.blocks, len(layout.tips))
            elif logs.phase.shape[1] < queue.blocks:
                logs = _longer(logs, queue.blocks)
            seated = programs.seated(layout, fixed, state)
            logs = programs.write(logs, log, seated, slot, np.minimum(age, logs.phase.shape[1] - 1))
            ended, running = jax.device_get(programs.ended(layout.program, log))  # explicit: all that goes to the host
            age += 1
            self._busy += int(running[working].sum())
            self._offered += lanes * device.STRETCH
            if progress is not None:
                progress(int(running[working].sum()))
            for lane in np.flatnonzero(working & (ended | (age >= queue.blocks))).tolist():
                done.add(_Ended(trial[lane], int(slot[lane]), int(age[lane])))  # type: ignore[arg-type]
                trial[lane], slot[lane] = None, slots
            more = queue.refilled(wait=False)
            while True:
                short = more and len(free) < trial.count(None)
                wanted = short or room() or trial.count(None) == lanes
                if not wanted or not (whole := done.take(queue.sizes, short)):
                    break
                yield self._taken_out(whole, logs)
                free += [one.slot for one in whole]

    def _fixed(self, queue: _Queue, lanes: int) -> Fixed:
        """The lanes with the first trials of the queue; a spare lane repeats the last of them."""
        model, empty = device.put_scene(self.scene, lanes, self.impl)
        fields, params = _rows(queue.pool, np.minimum(np.arange(lanes), queue.left - 1))
        return Fixed(model, fields, params, empty)

    def _taken_out(self, ready: list[_Ended], logs: Logs) -> tuple[list[Trial], Outcome]:
        trials, slots, ages = zip(*ready, strict=True)
        spare = self.at_once - len(ready)
        padded = (np.array([*values, *[values[-1]] * spare]) for values in (slots, ages))
        settling = -(-SETTLING // self.scene.substeps)
        # of a queue always as long as can be: each length is a program more to compile for what comes after
        blocks = max(ages) if self.spare == 0 else logs.phase.shape[1]
        return list(trials), _outcome(settling, blocks, self.scene.program, logs, *padded)


class _Ended(NamedTuple):
    trial: Trial
    slot: int
    blocks: int  # that it has written


class _Done:
    """Trials that have ended and are still on the device."""

    def __init__(self, at_once: int) -> None:
        self._at_once, self._ended = at_once, dict[Hashable, list[_Ended]]()  # by batch

    def add(self, one: _Ended) -> None:
        self._ended.setdefault(one.trial[0], []).append(one)

    def take(self, sizes: dict[Hashable, int], short: bool) -> list[_Ended]:
        """Up to ``at_once`` trials to take out: of a batch that is complete, or if slots are short of the fullest."""
        key = next((key for key, ended in self._ended.items() if len(ended) == sizes[key]), None)
        if key is None and short and self._ended:
            key = max(self._ended, key=lambda key: len(self._ended[key]))
        if key is None:
            return []
        ready = sorted(self._ended.pop(key), key=lambda one: one.trial[1])
        ready, rest = ready[: self._at_once], ready[self._at_once :]
        sizes[key] -= len(ready)
        if rest:
            self._ended[key] = rest
        return ready


class _Queue:
    """The trials that have not begun, a batch at a time on the device."""

    def __init__(self, scene: Scene, batches: Iterator[tuple[Hashable, Any]], ready: Callable[[], bool]) -> None:
        self._scene, self._batches, self._ready, self._size = scene, batches, ready, 0
        self._next = self._stop = 0
        self.key: Hashable = None
        self.sizes = dict[Hashable, int]()  # trials of each batch that are not taken out
        self.pool: Any = None  # model fields and parameters of the batch [trial, ...]
        self.blocks = 0  # stretches that the longest trial can take

    @property
    def left(self) -> int:
        """Trials of the present batch that have not begun."""
        return self._stop - self._next

    def refilled(self, wait: bool = True) -> bool:
        """Whether a trial is left, if need be of the next batch, unless that is not there and nobody waits for it."""
        if self.left:
            return True
        if not wait and not self._ready():
            return False
        drawn = next(self._batches, None)
        if drawn is None:
            return False
        self.key, params = drawn
        self._next, self._stop = 0, batch_size(params)
        self.sizes[self.key] = self._stop
        self._size = max(self._size, self._stop)
        rows = np.minimum(np.arange(self._size), self._stop - 1)  # always as many: one compiled program
        params = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], params)
        self.pool = jax.device_put((device.fields_of(self._scene, params), as_float32(params)))
        longest = int(np.ceil(np.max(self._scene.program.timeout(params)) / CONTROL_PERIOD)) + 1
        settling = -(-SETTLING // self._scene.substeps)
        self.blocks = max(self.blocks, -(-(settling + longest) // device.STRETCH))
        return True

    def take(self, count: int) -> list[int]:
        """The next trials' numbers in the batch, at most ``count``."""
        rows = list(range(self._next, min(self._next + count, self._stop)))
        self._next += len(rows)
        return rows


@dataclass(frozen=True)
class _Programs:
    start: Callable[..., Any]
    stretch: Callable[..., Any]
    seated: Callable[..., Any]
    refill: Callable[..., Any]
    write: Callable[..., Any]
    ended: Callable[..., Any]


@lru_cache
def _programs(backend: str) -> _Programs:
    """Compiled functions of a backend."""
    jit = partial(jax.jit, static_argnums=0, compiler_options=compiler_options(backend))
    return _Programs(
        jit(device.start), jit(device.stretch, donate_argnums=2), jit(device.seated),
        jit(_refill, donate_argnums=2), jax.jit(_write, donate_argnums=0), jax.jit(_ended, static_argnums=0),
    )  # fmt: skip


@jax.jit  # leaf by leaf it would wait for the thread that draws trials a hundred times
def _rows(tree: Any, rows: Array) -> Any:
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def _refill(layout: Layout, fixed: Fixed, state: State, pool: Any, rows: Array) -> tuple[Fixed, State]:
    """New trials in the lanes whose row of the pool is not negative."""
    new, taken = rows >= 0, jnp.maximum(rows, 0)

    def chosen(first: Array, second: Array) -> Array:
        return jnp.where(new.reshape(-1, *[1] * (first.ndim - 1)), first, second)

    fields, params = jax.tree.map(lambda leaf, old: chosen(leaf[taken], old), pool, (fixed.fields, fixed.params))
    fixed = Fixed(fixed.model, fields, params, fixed.empty)
    fresh = device.start(layout, fixed)
    body = device.kept(fresh.body, state.body, new)
    loop, tick = jax.tree.map(chosen, (fresh.loop, fresh.tick), (state.loop, state.tick))
    return fixed, State(body, loop, tick)


def _write(logs: Logs, log: LogRow, seated: Array, slot: Array, block: Array) -> Logs:
    """The logs with one more stretch of every lane."""

    def written(old: Array, rows: Array) -> Array:
        return old.at[slot, block].set(jnp.swapaxes(rows, 0, 1))

    wrench, joints = written(logs.wrench, log.wrench), written(logs.joints, log.joints)
    return Logs(wrench, joints, written(logs.phase, log.phase), logs.seated.at[slot].set(seated))


def _ended(program: Program, log: LogRow) -> tuple[Array, Array]:
    """Which lanes' trials have ended, and for how many control periods of the stretch they had not."""
    return log.phase[-1] == program.ended, (log.phase < program.ended).sum(0, dtype=jnp.int32)


def _empty(log: LogRow, slots: int, blocks: int, tabs: int) -> Logs:

    def zeros(leaf: Array) -> Array:
        return jnp.zeros((slots, blocks, device.STRETCH, *leaf.shape[2:]), leaf.dtype)

    return Logs(zeros(log.wrench), zeros(log.joints), zeros(log.phase), jnp.zeros((slots, tabs), jnp.bool_))


def _longer(logs: Logs, blocks: int) -> Logs:
    """The logs with room for longer trials."""

    def grown(leaf: Array) -> Array:
        return jnp.pad(leaf, [(0, 0), (0, blocks - leaf.shape[1]), *[(0, 0)] * (leaf.ndim - 2)])

    return Logs(grown(logs.wrench), grown(logs.joints), grown(logs.phase), logs.seated)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _outcome(settling: int, blocks: int, program: Program, logs: Logs, slots: Array, ages: Array) -> Outcome:
    """Some slots from time zero; ``ages`` are the blocks that each has written."""

    def whole(leaf: Array) -> Array:
        there = leaf[slots, :blocks]
        return there.reshape(len(slots), -1, *leaf.shape[3:])[:, settling:]

    there = jnp.repeat(jnp.arange(blocks)[None] < ages[:, None], device.STRETCH, axis=1)[:, settling:]
    phase = jnp.where(there, whole(logs.phase), program.ended)
    return Outcome(whole(logs.wrench), whole(logs.joints), phase, logs.seated[slots], program)
