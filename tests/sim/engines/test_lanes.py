"""Lanes: what a trial gives does not depend on its lane, its neighbours, or what was in the lane before."""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import signal
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.engines import device, native
from sim_mjx.engines import lanes as lanes_module
from sim_mjx.engines.lanes import Lanes
from sim_mjx.synthesis import records
from sim_mjx.synthesis.in_lanes import simulate_in_lanes
from tests.support.plunger import PlungerParams, plunger, plunger_trials

SCENE = plunger()
TIMEOUT = 0.1 + 0.1 * (np.arange(40) * 7 % 11)


@pytest.fixture(autouse=True)
def _few_lanes(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(device, "LANES", 8)
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):  # MJX is not strict
        yield


def some(params: PlungerParams, rows: range) -> PlungerParams:
    return jax.tree.map(lambda leaf: leaf[list(rows)], params)


def each(out: Rollouts) -> list[tuple[Any, ...]]:
    """Everything about each trial, cut where it ended."""
    cut = [(out.wrench[row, :n], out.joints[row, :n], out.past[row, :n]) for row, n in enumerate(out.length)]
    return [(*logs, out.onset[row], out.seated[row], out.diverged[row]) for row, logs in enumerate(cut)]


def waiting(params: PlungerParams) -> list[tuple[Any, ...]]:
    """The trials by eights, each of which waits for its longest."""
    blocks = (range(start, start + 8) for start in range(0, len(params.timeout), 8))
    return [trial for rows in blocks for trial in each(device.simulate(SCENE, some(params, rows), "jax"))]


def queued(params: PlungerParams, sizes: list[int], lanes: Lanes) -> list[tuple[Any, ...]]:
    """The trials in batches of these sizes through lanes that are refilled."""
    starts = np.cumsum([0, *sizes]).tolist()
    batches = [(start, some(params, range(start, start + size))) for start, size in zip(starts, sizes, strict=False)]
    found = {}
    for trials, out, samples in lanes.run(iter(batches)):
        assert 0 < len(trials) <= lanes.at_once == len(out.length)
        assert 0 <= samples - np.asarray(out.length)[: len(trials)].max() <= 2 * device.STRETCH
        for (start, row), rollout in zip(trials, each(device.to_host(out)), strict=False):
            assert start + row not in found
            found[start + row] = rollout
    assert sorted(found) == list(range(sum(sizes)))
    return [found[index] for index in range(sum(sizes))]


@pytest.mark.parametrize(
    ("sizes", "at_once"), [([40], 3), ([8, 8, 3, 1, 13, 7], 5), ([3, 37], 8), ([2, 5], 1), ([1], 4)]
)
def test_a_trial_does_not_depend_on_its_lane(sizes: list[int], at_once: int) -> None:
    params, lanes = plunger_trials(TIMEOUT), Lanes(SCENE, "jax", 8, at_once)
    found = queued(some(params, range(sum(sizes))), sizes, lanes)
    expected = waiting(params)[: sum(sizes)]
    for one, other in zip(found, expected, strict=True):
        jax.tree.map(np.testing.assert_array_equal, one, other)
    assert 0 < lanes.utilisation <= 1


def test_logs_hold_the_whole_trial_and_the_scene_does_something() -> None:
    found = waiting(plunger_trials(TIMEOUT))
    lengths = [len(wrench) for wrench, *_ in found]
    np.testing.assert_allclose(lengths, np.round(TIMEOUT / 0.005) + 1, atol=1)
    assert len({wrench.tobytes() for wrench, *_ in found}) == len(found)
    assert max(np.abs(wrench[:, 2]).max() for wrench, *_ in found) > 5  # some press the floor
    assert {bool(seated.all()) for *_, seated, _ in found} == {True, False}


def test_they_are_those_of_c_mujoco() -> None:
    """HIRO's scene, which takes long to compile, is compared in test_engines.py."""
    params = plunger_trials(TIMEOUT[:8])
    found, expected = device.simulate(SCENE, params, "jax"), native.simulate(SCENE, params)
    np.testing.assert_array_equal(found.length, expected.length)
    np.testing.assert_array_equal(found.past, expected.past)
    np.testing.assert_allclose(found.joints, expected.joints, rtol=0, atol=1e-4)  # of a tenth of a metre
    np.testing.assert_allclose(found.wrench, expected.wrench, rtol=0, atol=0.3)  # of 100 N


def test_a_program_in_double_precision_gets_the_same_trials() -> None:
    params = plunger_trials(TIMEOUT[:8])
    expected = device.simulate(SCENE, params, "jax")
    with jax.enable_x64(True):
        found = device.simulate(SCENE, params, "jax")
    jax.tree.map(np.testing.assert_array_equal, each(found), each(expected))


def test_lanes_that_wait_for_nobody_are_busy() -> None:
    """Forty trials through eight lanes; by eights the lanes would be idle for half the time."""
    params = plunger_trials(np.where(np.arange(40) % 8 == 0, 4.0, 0.45))
    lanes = Lanes(SCENE, "jax", 8, 8)
    queued(params, [40], lanes)
    longest = 5 * (4.0 + 0.5)  # settling and the longest of each eight, s
    assert lanes.utilisation > 2.0 * (params.timeout + 0.5).sum() / (8 * longest)


def test_nobody_asks_for_trials_while_all_lanes_are_busy() -> None:
    """What is asked for is claimed, and another device could have begun it."""
    params, done, asked = plunger_trials(np.full(16, 1.0)), [0], list[int]()
    lanes = Lanes(SCENE, "jax", 8, 8)

    def ready() -> bool:
        asked.append(done[0])
        return True

    batches = [(start, some(params, range(start, start + 8))) for start in (0, 8)]
    for _ in lanes.run(iter(batches), progress=lambda periods: done.append(done.pop() + periods), ready=ready):
        pass
    assert asked
    assert min(asked) >= 8 * 200  # control periods of the first eight


def test_trials_longer_than_all_before_fit() -> None:
    params = plunger_trials(np.array([0.1] * 8 + [3.0] * 8))
    found = queued(params, [8, 8], Lanes(SCENE, "jax", 8, 2))
    for one, other in zip(found, waiting(params), strict=True):
        jax.tree.map(np.testing.assert_array_equal, one, other)


def test_the_last_period_of_a_trial_that_times_out_decides_what_is_seated() -> None:
    """Its log ends with a page; the tips pass at many times, some of them in that very period."""
    count, timeout = 64, 99 * 0.005
    params = dataclasses.replace(
        plunger_trials(np.full(count, timeout)),
        home=np.linspace(0.01, 0.03, count)[:, None], speed=np.full(count, 0.1), parts=np.full(count, 5.0),
    )  # fmt: skip
    longer = dataclasses.replace(params, timeout=np.where(np.arange(count) < count - 1, timeout, 1.2 * timeout))
    found, expected = (device.simulate(SCENE, each, "jax") for each in (params, longer))
    assert found.length[:-1].tolist() == expected.length[:-1].tolist() == [100] * (count - 1)
    np.testing.assert_array_equal(found.seated[:-1], expected.seated[:-1])
    assert (found.seated != found.past[:, 99])[:-1].any()


def test_a_trial_takes_as_much_room_as_it_lasts() -> None:
    """There is room for nine of the longest trial, hence for all 24, most of which are short."""
    params = plunger_trials(np.array([4.0, *[0.2] * 23]))
    lanes, begun = Lanes(SCENE, "jax", 8, 8, spare=1), list[int]()

    def batches() -> Iterator[tuple[int, PlungerParams]]:
        for start in range(0, 24, 8):
            begun.append(start)
            yield start, some(params, range(start, start + 8))

    for _ in lanes.run(batches(), room=lambda: False):
        assert begun == [0, 8, 16]  # none had to leave before the last one had begun
    found = queued(params, [8, 8, 8], Lanes(SCENE, "jax", 8, 8, spare=1))
    for one, other in zip(found, waiting(params), strict=True):
        jax.tree.map(np.testing.assert_array_equal, one, other)


def test_shards_that_share_lanes_are_those_that_have_them_alone() -> None:
    """Trials, labels and the order of the trials within a shard."""
    params, config, limits = plunger_trials(TIMEOUT[:20]), EncoderConfig(window=5), np.asarray(preset().limits)
    sizes = {"a": range(8), "b": range(8, 15), "c": range(15, 20)}
    batches = ((key, some(params, rows)) for key, rows in sizes.items())
    made = simulate_in_lanes(SCENE, batches, "mjx", 8, 3, config, limits, recorded=False)
    found = {shard.key: shard for shard in made}
    assert set(found) == set(sizes)
    for key, rows in sizes.items():
        out = device.simulate(SCENE, some(params, rows), "jax")
        tracks = records.label(out, config, limits)
        for name, expected in records.of_trials(out, recorded=False).items():
            np.testing.assert_array_equal(found[key].rows[name], expected)
        again = records.of_labels(found[key].tracks, len(rows))
        for name, values in records.of_labels(tracks, len(rows)).items():
            np.testing.assert_array_equal(again[name], values)
        assert again["llb.label"].any()


def test_lanes_do_not_wait_for_those_who_take_what_has_ended() -> None:
    """Nobody has room until the last trial has begun: until then trials stay on the device, none is lost."""
    params, sizes = plunger_trials(TIMEOUT[:24]), [8, 8, 8]
    lanes, seen, begun = Lanes(SCENE, "jax", 8, 8, spare=16), list[int](), list[int]()

    def batches() -> Iterator[tuple[int, PlungerParams]]:
        for start in range(0, sum(sizes), 8):
            begun.append(start)
            yield start, some(params, range(start, start + 8))

    for trials, _, _ in lanes.run(batches(), room=lambda: False):
        assert begun == [0, 8, 16]
        seen += [key + row for key, row in trials]
    assert sorted(seen) == list(range(24))
    expected = waiting(params)
    found = queued(params, sizes, Lanes(SCENE, "jax", 8, 8, spare=16))
    for one, other in zip(found, expected, strict=True):
        jax.tree.map(np.testing.assert_array_equal, one, other)


def test_a_signal_waits_for_the_stretch_to_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Raised within a callback of Warp's kernels, an exception would end the process."""
    programs, done = lanes_module._programs("cpu"), list[int]()

    def stretch(*args: Any) -> Any:
        if done:
            signal.raise_signal(signal.SIGINT)
        done.append(len(done))
        return programs.stretch(*args)

    monkeypatch.setattr(lanes_module, "_programs", lambda _: dataclasses.replace(programs, stretch=stretch))
    former = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            queued(plunger_trials(TIMEOUT[:8]), [8], Lanes(SCENE, "jax", 8, 8))
    finally:
        signal.signal(signal.SIGINT, former)
    assert done == [0, 1]


class Clockwork:
    """Lanes without physics: trials log their number and the time, so that every page can be told from all others."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.stretches, self.ended, self.pages = 0, set[int](), 0
        monkeypatch.setattr(device, "STRETCH", 4)
        monkeypatch.setattr(lanes_module, "SETTLING", 3)
        monkeypatch.setattr(device, "put_scene", lambda *_: (None, None))
        monkeypatch.setattr(device, "fields_of", lambda *_: {})
        monkeypatch.setattr(lanes_module, "Fixed", lambda *parts: parts)
        programs = lanes_module._Programs(self.start, self.stretch, self.refill, self.write, lanes_module._ended)
        monkeypatch.setattr(lanes_module, "_programs", lambda _: programs)

    def start(self, _: Any, fixed: Any) -> np.ndarray:
        """Number, length and time of the trials ``[3, lane]``."""
        params = jax.tree.map(np.asarray, fixed[2])
        return np.stack([params.speed, np.rint(params.timeout / 0.005) + 1, np.full_like(params.speed, -3)]).astype(int)

    def refill(self, _: Any, fixed: Any, state: np.ndarray, pool: Any, begin: np.ndarray) -> tuple[Any, np.ndarray]:
        return fixed, np.where(begin >= 0, self.start(None, (None, *pool))[:, begin], state)

    def stretch(self, _: Any, fixed: Any, state: np.ndarray) -> tuple[np.ndarray, device.Log]:
        number, length, tick = state
        self.stretches += 1
        ticks = tick + np.arange(4)[:, None]
        wrench = np.stack([np.broadcast_to(number, ticks.shape), ticks], -1).astype(np.float32)
        phase = np.where(ticks < length, 0, SCENE.program.ended)
        self.ended |= set(number[tick + 4 >= length].tolist())
        log = device.Log(*map(jnp.asarray, (wrench, wrench, phase, wrench > 0)))
        return np.stack([number, length, tick + 4]), log

    def write(self, logs: device.Log, log: device.Log, page: np.ndarray) -> device.Log:
        used = page[page != lanes_module.NOWHERE]
        assert len(set(used.tolist())) == len(used)
        self.pages = len(logs.phase)
        return lanes_module._write(logs, log, page)


def numbered(timeouts: np.ndarray) -> PlungerParams:
    return dataclasses.replace(plunger_trials(timeouts), speed=np.arange(len(timeouts)).astype(float))


@pytest.mark.parametrize(("seed", "crowded"), [*((seed, False) for seed in range(4)), (4, True)])
def test_every_trial_keeps_its_own_pages_whatever_waits_for_what(
    seed: int, crowded: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Batches come late, nobody takes what has ended, there is little room; trials also end with their last page."""
    rng, clock = np.random.default_rng(seed), Clockwork(monkeypatch)
    sizes, spare = rng.integers(1, 14, 5).tolist(), int(rng.integers(0, 3))
    steps = rng.choice([1, 3, 4, 8, 11, 12, 32 - 4], sum(sizes))  # with settling and its first period: whole pages too
    if crowded:  # the first trial makes the room, and short ones fill it again and again
        sizes, spare, steps = [8] * 12, 0, np.array([28] + [1] * 95)
    params, starts = numbered(steps * 0.005), np.cumsum([0, *sizes]).tolist()
    lanes = Lanes(SCENE, "jax", 8, 8 if crowded else int(rng.integers(1, 9)), spare)
    available, periods, found = [True], list[int](), dict[int, np.ndarray]()

    def ready() -> bool:
        available.append(bool(rng.random() < 0.5))
        return available[-1]

    def batches() -> Iterator[tuple[int, PlungerParams]]:
        for index, (start, size) in enumerate(zip(starts, sizes, strict=False)):
            # the first pool waits; later ones only if nothing else could be done
            assert index == 0 or start < 8 or available[-1] or clock.ended >= set(range(start))
            yield start, some(params, range(start, start + size))

    made = lanes.run(
        batches(), progress=periods.append, ready=ready, room=lambda: not crowded and bool(rng.random() < 0.3)
    )
    for trials, out, samples in made:
        assert 0 < len(trials) <= lanes.at_once
        assert all(one < other for one, other in itertools.pairwise(trials) if one[0] == other[0])
        for (start, row), length, wrench in zip(trials, np.asarray(out.length), np.asarray(out.wrench), strict=False):
            assert start + row not in found
            found[start + row] = wrench[:length]
            assert samples >= length
    for number, step in enumerate(steps.tolist()):
        expected = np.stack([np.full(step + 1, number), np.arange(step + 1)], 1)
        np.testing.assert_array_equal(found.pop(number), expected)
    assert not found
    assert clock.pages <= (8 + spare) * -(-(3 + steps.max() + 2) // 4)
    assert sum(periods) == (3 + steps + 1).sum()  # settling counts, lanes without a trial do not
    assert lanes.utilisation == pytest.approx(sum(periods) / (clock.stretches * 8 * 4))


def test_no_lane_waits_while_a_batch_has_trials_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also when no other batch is ready: as many stretches as when each lane takes the next trial at once."""
    steps, clock = np.random.default_rng(0).integers(1, 40, 50), Clockwork(monkeypatch)
    lanes = Lanes(SCENE, "jax", 8, 3, spare=50)
    taken = [len(trials) for trials, *_ in lanes.run(iter([(0, numbered(steps * 0.005))]), ready=lambda: False)]
    assert sum(taken) == 50
    free = [0] * 8
    for step in steps.tolist():
        heapq.heappush(free, heapq.heappop(free) + -(-(3 + step + 2) // 4))  # ended in its last row
    assert clock.stretches == max(free)


def test_complete_batches_leave_together_and_the_fullest_one_if_room_is_short() -> None:
    def ended(*trials: tuple[str, int]) -> Any:
        done = lanes_module._Done(3)
        for trial in trials:
            done.add(lanes_module._Ended(trial, np.zeros(1, np.int32)))
        return lambda sizes, short=False, last=False: [one.trial for one in done.take(sizes, short, last)]

    two, three = [("a", 1), ("b", 4), ("a", 0)], [("b", 2), ("a", 1), ("b", 0), ("a", 2), ("a", 0)]
    assert ended(*two)({"a": 2, "b": 5}) == []  # of fewer than three
    assert ended(*two)({"a": 2, "b": 5}, last=True) == [("a", 0), ("a", 1)]
    assert ended(*two)({"a": 2, "b": 5}, short=True) == [("a", 0), ("a", 1)]
    assert ended(*three)({"a": 3, "b": 3}) == [("a", 0), ("a", 1), ("a", 2)]
    assert ended(*three)({"a": 4, "b": 3}) == []
    assert ended(*three)({"a": 4, "b": 3}, short=True) == [("a", 0), ("a", 1), ("a", 2)]


def test_a_trial_that_does_not_end_leaves_with_its_last_page() -> None:
    table, pages, never = lanes_module._Table(2), lanes_module._Pages(), np.zeros(2, np.bool_)
    pages.grow(5)
    table.begin(np.array([1]), [("a", 0)])
    np.testing.assert_array_equal(table.turn(pages, 2), [lanes_module.NOWHERE, 0])
    assert not list(table.end(never))
    table.turn(pages, 2)
    (one,) = table.end(never)
    np.testing.assert_array_equal(one.pages, [0, 1])
    assert (table.running, pages.used) == (0, 2)
