"""Trials in lanes: a lane whose trial has ended takes the next one, so that none waits for the longest.

A lane is a place in the batch that the device steps together. After each stretch of control periods the host learns
which trials have ended; new ones begin in their lanes. What a lane logs in a stretch goes to a free page of a buffer on
the device, so that a trial takes as much room as it lasts; finished trials are taken out together. What becomes of a
trial does not depend on its lane or its neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int32
from numpy.typing import NDArray

from rcbht_jax._util.atomic import uninterrupted
from rcbht_jax._util.compiling import compiler_options
from rcbht_jax.types import Array
from sim_mjx.assembly.rollout import Program, as_float32, batch_size
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import device
from sim_mjx.engines.common import SETTLING, select_lanes, single
from sim_mjx.engines.device import Fixed, Layout, Log, Outcome, State

Trial = tuple[Hashable, int]  # key of its batch, and number in it
NOWHERE = np.iinfo(np.int32).max  # the page of what is discarded


@dataclass
class Lanes:
    """Lanes of one scene on JAX's default device.

    Attributes:
        scene: what is simulated.
        impl: "jax", "warp" or "fused".
        count: lanes; rounded up to full vectors.
        at_once: finished trials that are taken out together.
        spare: room for finished trials, in the longest ones that there can be, in addition to what all lanes may need;
            default ``at_once``.
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
        """Share of the control periods of all lanes in which a trial was still running."""
        return self._busy / max(self._offered, 1)

    def run(
        self,
        batches: Iterable[tuple[Hashable, Any]],
        *,
        progress: Callable[[int], None] | None = None,
        ready: Callable[[], bool] = lambda: True,
        room: Callable[[], bool] = lambda: True,
    ) -> Iterator[tuple[list[Trial], Outcome, int]]:
        """Simulate batches of trials; yields finished ones, at most ``at_once`` at a time, and a bound of their length.

        Finished trials stay on the device until all trials of their batch have ended and ``at_once`` trials can be
        yielded, unless lanes wait for their room. Each outcome has ``at_once`` rows, so that the functions that read
        it are compiled once; rows beyond the listed trials are undefined.

        Args:
            batches: (key, parameters of the scene's program); asked for when lanes are free.
            progress: called with the number of control periods done since the last call, summed over trials.
            ready: whether the next batch is available without waiting; busy lanes do not wait for it.
            room: whether the caller takes finished trials now; otherwise they stay on the device while it has room.
        """
        layout, programs = device.layout_of(self.scene), _programs(jax.default_backend())
        lanes = -(-self.count // device.LANES) * device.LANES
        queue = _Queue(self.scene, iter(batches), ready, self.at_once)
        if not queue.fill(lanes, lambda: True):  # the first pool has a trial for each lane
            return
        most = lanes + (self.at_once if self.spare is None else self.spare)  # trials that there is room for at least
        pages, table, done = _Pages(), _Table(lanes), _Done(self.at_once)
        model, empty = device.put_scene(self.scene, lanes, self.impl)
        fields, params = queue.pool
        fixed = Fixed(model, fields, params, empty)  # lanes begin with the first trials; a spare one repeats the last
        state = programs.start(layout, fixed)
        table.begin(*queue.take(queue.left))
        logs: Log | None = None  # [page, time ...]
        while True:
            while len(idle := table.idle()) and (free := most * queue.blocks - pages.used - table.running) > 0:
                if not queue.refilled(wait=len(idle) == lanes):
                    break
                rows, trials = queue.take(min(len(idle), free, queue.left))
                chosen, begin = idle[: len(rows)], np.full(lanes, -1, np.int32)
                begin[chosen] = rows
                table.begin(chosen, trials)
                fixed, state = programs.refill(layout, fixed, state, queue.pool, begin)
            if not table.running:
                break
            # An exception in a callback of Warp's would end the process; compiling takes a minute and may be stopped.
            with uninterrupted() if logs is not None else nullcontext():
                state, log = programs.stretch(layout, fixed, state)
                if pages.count < most * queue.blocks:
                    pages.grow(most * queue.blocks)
                    logs = _with_room(logs, log, pages.count)
                assert logs is not None
                logs = programs.write(logs, log, table.turn(pages, queue.blocks))
                # explicit: the only copy to the host
                ended, running = jax.device_get(programs.ended(layout.program, log))
            moved = int(running[table.busy].sum())
            self._busy += moved
            self._offered += lanes * device.STRETCH
            if progress is not None:
                progress(moved)
            for one in table.end(ended):
                done.add(one)
            waiting = len(table.idle())
            more = waiting > 0 and queue.refilled(wait=False)  # asks for trials only when lanes wait for them
            while True:
                wanted = table.running + (waiting if more else 0)  # pages of the next stretch
                short, last = most * queue.blocks - pages.used < wanted, not table.running
                takes = short or last or room()
                if not takes or not (whole := done.take(queue.sizes, short, last and not more)):
                    break
                yield self._taken_out(whole, logs, table.blocks)
                for one in whole:
                    pages.give(one.pages)

    def _taken_out(self, whole: list[_Ended], logs: Log, blocks: int) -> tuple[list[Trial], Outcome, int]:
        ages = np.array([len(one.pages) for one in whole])
        if self.spare == 0:  # else always the longest: every other length compiles one more program in what reads it
            blocks = int(ages.max())
        pages = np.zeros((self.at_once, blocks), np.int32)
        for row, one in enumerate(whole):
            pages[row, : len(one.pages)] = one.pages
        pages[len(whole) :] = pages[len(whole) - 1]
        settling = -(-SETTLING // self.scene.substeps)
        padded = np.pad(ages, (0, self.at_once - len(ages)), mode="edge")
        out = _outcome(settling, self.scene.program, logs, pages, padded)
        return [one.trial for one in whole], out, int(ages.max()) * device.STRETCH - settling


class _Ended(NamedTuple):
    trial: Trial
    pages: Int32[np.ndarray, " block"]  # that it has written


class _Pages:
    """The pages of the logs, each of which holds a stretch of one lane."""

    def __init__(self) -> None:
        self.count, self._free = 0, list[Int32[np.ndarray, " page"]]()
        self.used = 0

    def grow(self, count: int) -> None:
        """There are ``count`` pages from now on."""
        self._free.append(np.arange(self.count, count, dtype=np.int32))
        self.count = count

    def take(self, count: int) -> Int32[np.ndarray, " page"]:
        """Free pages; there are enough."""
        free = np.concatenate(self._free)
        assert len(free) >= count
        self._free, self.used = [free[count:]], self.used + count
        return free[:count]

    def give(self, pages: Int32[np.ndarray, " page"]) -> None:
        """These are free again."""
        self._free.append(pages)
        self.used -= len(pages)


class _Table:
    """The host's record of the lanes."""

    def __init__(self, lanes: int) -> None:
        self.busy = np.zeros(lanes, np.bool_)
        self._age = np.zeros(lanes, np.int64)  # pages that it has written
        self._pages = np.zeros((lanes, 0), np.int32)  # which
        self._trial = list[Trial | None]([None] * lanes)

    @property
    def blocks(self) -> int:
        """Pages that a trial can write."""
        return self._pages.shape[1]

    @property
    def running(self) -> int:
        """Lanes with a trial."""
        return int(self.busy.sum())

    def idle(self) -> NDArray[np.intp]:
        """Lanes without a trial."""
        return np.flatnonzero(~self.busy)

    def begin(self, lanes: NDArray[np.integer], trials: list[Trial]) -> None:
        """Trials begin in these lanes."""
        for lane, trial in zip(lanes.tolist(), trials, strict=True):
            self._trial[lane] = trial
        self.busy[lanes], self._age[lanes] = True, 0

    def turn(self, pages: _Pages, blocks: int) -> Int32[np.ndarray, " lane"]:
        """A page for each lane's stretch; trials can write ``blocks`` of them."""
        self._pages = np.pad(self._pages, ((0, 0), (0, blocks - self.blocks)))
        where, lanes = np.full(len(self.busy), NOWHERE, np.int32), np.flatnonzero(self.busy)
        where[lanes] = self._pages[lanes, self._age[lanes]] = pages.take(len(lanes))
        self._age += 1
        return where

    def end(self, ended: Bool[np.ndarray, " lane"]) -> Iterator[_Ended]:
        """The trials that have ended, or written all pages, leave their lanes."""
        for lane in np.flatnonzero(self.busy & (ended | (self._age >= self.blocks))).tolist():
            trial = self._trial[lane]
            assert trial is not None
            yield _Ended(trial, self._pages[lane, : self._age[lane]].copy())
            self._trial[lane], self.busy[lane] = None, False


class _Done:
    """Trials that have ended and are still on the device."""

    def __init__(self, at_once: int) -> None:
        self._at_once, self._ended = at_once, dict[Hashable, list[_Ended]]()  # by batch

    def add(self, one: _Ended) -> None:
        self._ended.setdefault(one.trial[0], []).append(one)

    def take(self, sizes: dict[Hashable, int], short: bool, last: bool) -> list[_Ended]:
        """Up to ``at_once`` trials to take out, of complete batches, or if room is short of the fullest one."""
        complete = [key for key, ended in self._ended.items() if len(ended) == sizes[key]]
        if not complete and short and self._ended:
            complete = [max(self._ended, key=lambda key: len(self._ended[key]))]
        # none while fewer than ``at_once`` are complete
        if not short and not last and sum(len(self._ended[key]) for key in complete) < self._at_once:
            return []
        ready = list[_Ended]()
        for key in complete:
            ended = sorted(self._ended.pop(key), key=lambda one: one.trial[1])
            taken, rest = ended[: self._at_once - len(ready)], ended[self._at_once - len(ready) :]
            ready += taken
            sizes[key] -= len(taken)
            if rest:
                self._ended[key] = rest
        return ready


class _Queue:
    """The trials that have not begun, some of them on the device."""

    def __init__(
        self, scene: Scene, batches: Iterator[tuple[Hashable, Any]], ready: Callable[[], bool], size: int
    ) -> None:
        self._scene, self._batches, self._ready, self._size = scene, batches, ready, size
        self._trials, self._next = list[Trial](), 0
        self._rest: tuple[Hashable, int, Any] | None = None  # a batch, and how many trials of it are in the pool
        self.sizes = dict[Hashable, int]()  # trials of each batch that are not taken out
        self.pool: Any = None  # model fields and parameters of trials [trial, ...]
        self.blocks = 0  # stretches that the longest trial can take

    @property
    def left(self) -> int:
        """Trials of the pool that have not begun."""
        return len(self._trials) - self._next

    def refilled(self, wait: bool) -> bool:
        """Refill the pool if it is empty, waiting for a batch or not; whether a trial is left in it."""
        if self.left:
            return True
        # always of the same size, so that one program is compiled
        return (wait or self._rest is not None or self._ready()) and self.fill(self._size, self._ready)

    def fill(self, size: int, ready: Callable[[], bool]) -> bool:
        """Make a pool of up to ``size`` trials, of one batch and of others that are ready; whether there is any."""
        pieces, self._trials, self._next = list[Any](), [], 0
        while len(self._trials) < size and (not pieces or self._rest or ready()):
            piece = self._piece(size)
            if piece is None:
                break
            pieces.append(piece)
        if not pieces:
            return False
        rows = np.minimum(np.arange(size), len(self._trials) - 1)
        params = jax.tree.map(lambda *leaves: np.concatenate(leaves)[rows], *pieces)
        self.pool = jax.device_put((device.fields_of(self._scene, params), as_float32(params)))
        # the last two rows: the one in which it times out, and the one in which it has ended and shows what is seated
        longest = int(np.ceil(np.max(self._scene.program.timeout(params)) / CONTROL_PERIOD)) + 2
        settling = -(-SETTLING // self._scene.substeps)
        self.blocks = max(self.blocks, -(-(settling + longest) // device.STRETCH))
        return True

    def _piece(self, size: int) -> Any:
        """Parameters of trials of one batch, as many as the pool has room for; None after the last batch."""
        if self._rest is None:
            drawn = next(self._batches, None)
            if drawn is None:
                return None
            self._rest = drawn[0], 0, drawn[1]
            self.sizes[drawn[0]] = batch_size(drawn[1])
        key, start, params = self._rest
        stop = min(batch_size(params), start + size - len(self._trials))
        self._rest = None if stop == batch_size(params) else (key, stop, params)
        self._trials += [(key, row) for row in range(start, stop)]
        return jax.tree.map(lambda leaf: np.asarray(leaf)[start:stop], params)

    def take(self, count: int) -> tuple[NDArray[np.integer], list[Trial]]:
        """The next trials to begin: their rows in the pool, and their keys and numbers."""
        first, self._next = self._next, self._next + count
        return np.arange(first, self._next), self._trials[first : self._next]


@dataclass(frozen=True)
class _Programs:
    start: Callable[..., Any]
    stretch: Callable[..., Any]
    refill: Callable[..., Any]
    write: Callable[..., Any]
    ended: Callable[..., Any]


@lru_cache
def _programs(backend: str) -> _Programs:
    """Compiled functions of a backend, in single precision."""
    jit = partial(jax.jit, static_argnums=0, compiler_options=compiler_options(backend))
    return _Programs(
        jit(single(device.start)),
        jit(single(device.stretch), donate_argnums=2),
        jit(single(_refill), donate_argnums=2),
        jax.jit(_write, donate_argnums=0),
        jax.jit(_ended, static_argnums=0),
    )


def _refill(layout: Layout, fixed: Fixed, state: State, pool: Any, rows: Array) -> tuple[Fixed, State]:
    """Begin new trials in the lanes whose row of the pool is not negative."""
    new, taken = rows >= 0, jnp.maximum(rows, 0)
    drawn = jax.tree.map(lambda leaf: leaf[taken], pool)
    fields, params = select_lanes(new, drawn, (fixed.fields, fixed.params))
    fixed = Fixed(fixed.model, fields, params, fixed.empty)
    fresh = device.start(layout, fixed)
    body = device.kept(fresh.body, state.body, new)
    loop, tick = select_lanes(new, (fresh.loop, fresh.tick), (state.loop, state.tick))
    return fixed, State(body, loop, tick)


def _write(logs: Log, log: Log, page: Array) -> Log:
    """The logs with one more stretch of every lane."""
    return jax.tree.map(lambda old, rows: old.at[page].set(jnp.swapaxes(rows, 0, 1), mode="drop"), logs, log)


def _ended(program: Program, log: Log) -> tuple[Array, Array]:
    """Which lanes' trials have ended, and for how many control periods of the stretch each was running."""
    return log.phase[-1] == program.ended, (log.phase < program.ended).sum(0, dtype=jnp.int32)


def _with_room(logs: Log | None, log: Log, pages: int) -> Log:
    """The logs, none before the first stretch, with room for so many pages like those of a stretch."""
    if logs is None:
        logs = jax.tree.map(lambda leaf: jnp.zeros((0, device.STRETCH, *leaf.shape[2:]), leaf.dtype), log)
    return jax.tree.map(lambda leaf: jnp.pad(leaf, [(0, pages - len(leaf)), *[(0, 0)] * (leaf.ndim - 1)]), logs)


@partial(jax.jit, static_argnums=(0, 1))
def _outcome(settling: int, program: Program, logs: Log, pages: Array, ages: Array) -> Outcome:
    """The outcome of some trials, from time zero on, by their pages; ``ages`` says how many each has written."""

    def whole(leaf: Array) -> Array:
        return leaf[pages].reshape(len(pages), -1, *leaf.shape[2:])[:, settling:]

    there = jnp.repeat(jnp.arange(pages.shape[1])[None] < ages[:, None], device.STRETCH, axis=1)[:, settling:]
    phase = jnp.where(there, whole(logs.phase), program.ended)
    return Outcome(whole(logs.wrench), whole(logs.joints), phase, whole(logs.past), program)
