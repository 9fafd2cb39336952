"""The encoder against the plain-Python oracle, and streaming against batch."""

from __future__ import annotations

from functools import partial
from inspect import unwrap
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import TypeCheckError

import rcbht_jax as rj
from rcbht_jax.encoding import batch, encoder
from rcbht_jax.encoding.batch import Schedule, encode_batch, plan
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.errors import InputError
from rcbht_jax.types import Segment
from tests.support import oracle
from tests.support.tracks import layers, published
from tests.support.trees import assert_trees_equal

SAMPLES = 231
CONFIGS = {
    "default": (EncoderConfig(), {}),
    "window 2, similar amplitudes": (EncoderConfig(window=2, rule="similar"), {"rule": "similar"}),
    "window 20, 1 kHz": (EncoderConfig(window=20, dt=0.001), {}),
    "ungated, contact first": (EncoderConfig(gate=False, contact_first=True), {"gate": False, "contact_first": True}),
    "one slot": (EncoderConfig(pipe="one-slot"), {"slots": 1}),
    "adjustments merge, capped": (EncoderConfig(adj_exempt=False, latency_cap=0.1), {"adj_exempt": False, "cap": 20}),
    "window 100": (EncoderConfig(window=100), {}),
}
signals = st.tuples(st.integers(0, 2**32 - 1), st.sampled_from(["noise", "steps", "ramps"]), st.integers(0, SAMPLES))
encode = jax.jit(encoder.encode, static_argnums=0)


def wrench_of(seed: int, style: str, samples: int = SAMPLES, axes: int = 6) -> np.ndarray:
    """Random signals; steps and ramps are quantised, so that equal labels, exact ties and impulses are common."""
    rng = np.random.default_rng(seed)
    if style == "noise":
        return np.cumsum(rng.normal(size=(samples, axes)) * rng.choice([0.01, 0.1, 1.0], (1, axes)), 0)
    knots = rng.integers(-8, 9, (samples // 8 + 2, axes)) * 0.25
    if style == "steps":
        return np.repeat(knots, 8, 0)[:samples]
    times = np.arange(samples) / 8  # multiples of 1/32, whose differences are exact: 0.45 x 5 is not 2.25 in binary
    return np.stack([np.interp(times, np.arange(len(knots)), knot) for knot in knots.T], 1)


@pytest.mark.parametrize("name", CONFIGS)
@settings(max_examples=25)
@given(signal=signals)
def test_labels_equal_the_oracle(name: str, signal: tuple[int, str, int]) -> None:
    config, options = CONFIGS[name]
    seed, style, length = signal
    wrench, limits = wrench_of(seed, style), preset().limits
    with jax.enable_x64(True):
        ours = encode(config, jnp.asarray(limits), jnp.asarray(wrench[None]), jnp.asarray([length], jnp.int32))
        ours = jax.tree.map(np.asarray, ours)
    for axis in range(6):
        expected = oracle.encode(
            wrench[:length, axis].tolist(), config.dt, limits[axis].tolist(), config.window, **options
        )
        for track, rows in zip(layers(ours), expected.out, strict=True):
            got = published(track, (0, axis))
            assert [row[:4] for row in got] == [(i.label, i.t0, i.t1, now) for i, now, _ in rows]
            values = [(i.vmax, i.vmin, i.avg, i.grad) for i, _, _ in rows]
            np.testing.assert_allclose([row[4:] for row in got], values, rtol=1e-9, atol=1e-9)


@settings(max_examples=30)
@given(signal=signals, cuts=st.lists(st.integers(0, 40), max_size=30), peeks=st.sets(st.integers(0, 30)))
def test_any_chunking_equals_the_batch_bit_for_bit(
    signal: tuple[int, str, int], cuts: list[int], peeks: set[int]
) -> None:
    seed, style, length = signal
    config, thresholds = EncoderConfig(), preset()
    wrench = wrench_of(seed, style).astype(np.float32)
    batch = encode(config, jnp.asarray(thresholds.limits, jnp.float32), wrench[None], np.array([length], np.int32))
    stream, parts, start = Encoder(config, thresholds), [], 0
    for index, cut in enumerate([*cuts, length]):
        parts += stream.push(wrench[start : min(start + cut, length)])
        start = min(start + cut, length)
        if index in peeks:
            stream.peek()
    assert stream.received == length
    last = stream.peek()
    parts.append(stream.flush())
    assert_trees_equal(last, parts[-1])
    streamed = jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *parts)
    for axis in range(6):
        for whole, track in zip(layers(batch), layers(streamed), strict=True):
            assert published(track, (axis,)) == published(whole, (0, axis))


def test_a_stream_of_one_axis_equals_the_batch_bit_for_bit() -> None:
    """A compiler knew the samples of a whole window of a single lane, and divided by their reciprocal."""
    config, limits = EncoderConfig(), preset("hiro", ["Fz"])
    wrench = wrench_of(1, "noise", axes=1).astype(np.float32) - 300
    stream = Encoder(config, limits)
    parts = [*stream.push(wrench), stream.flush()]
    streamed = jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *parts)
    batch = rj.encode(wrench, 200, config=config, thresholds=limits)
    for whole, track in zip(layers(batch), layers(streamed), strict=True):
        assert published(track, (0,)) == published(whole, (0,))


@settings(max_examples=6)
@given(seed=st.integers(0, 1000), lengths=st.lists(st.integers(0, 700), min_size=1, max_size=12))
def test_data_set_equals_its_recordings_one_by_one(seed: int, lengths: list[int]) -> None:
    config, length = EncoderConfig(), np.array(lengths, np.int32)
    rng = np.random.default_rng(seed)
    wrench = np.cumsum(rng.normal(size=(len(lengths), 700, 6)) * 0.2, 1).astype(np.float32)
    limits = preset().limits * rng.uniform(0.5, 2, (len(lengths), 6, 1))
    together = encode_batch(config, GradientThresholds(limits), wrench, length)
    for index in range(len(lengths)):
        alone = encode(
            config, jnp.asarray(limits[index], jnp.float32), wrench[index : index + 1], length[index : index + 1]
        )
        for axis in range(6):
            for ours, track in zip(layers(together), layers(alone), strict=True):
                assert published(ours, (index, axis)) == published(track, (0, axis))
                count = np.count_nonzero(ours.label[index, axis])
                assert not ours.label[index, axis, count:].any()


@given(
    lengths=st.lists(st.integers(0, 20_000), min_size=1, max_size=200), samples=st.integers(2, 2000),
    axes=st.integers(1, 60),
)  # fmt: skip
def test_every_sample_is_scheduled_once_in_order(lengths: list[int], samples: int, axes: int) -> None:
    length = np.array(lengths, np.int32)
    schedule = plan(length, samples, axes)
    assert schedule.recording.shape[1] in (1, 4, 16, 64, 128)  # a program each
    for index, size in enumerate(lengths):
        piece, slot = np.nonzero(schedule.recording == index)
        assert len(set(slot)) == 1
        assert (np.diff(piece) == 1).all()
        assert schedule.offset[piece, slot].tolist() == list(range(0, max(size, 1), samples))
    assert 0 <= padding(schedule, length) <= 1


def padding(schedule: Schedule, length: np.ndarray) -> float:
    """Share of the steps that encode no sample."""
    return 1 - length.sum() / (schedule.recording.size * schedule.samples)


def test_padding_of_the_recorded_data_costs_less_than_a_quarter(hiro_recordings) -> None:
    length = hiro_recordings.length
    assert padding(plan(length, 64 * 5, 6), length) < 0.25
    real = np.char.startswith(hiro_recordings.source, "REAL")
    assert padding(plan(length[real], 64 * 5, 6), length[real]) < 0.25


def test_the_number_of_slots_follows_recordings_and_axes() -> None:
    for count, axes, slots in ((1, 6, 1), (2, 6, 4), (8, 6, 16), (47, 6, 64), (2, 60, 1), (300, 6, 128)):
        assert plan(np.full(count, 3200, np.int32), 320, axes).recording.shape[1] == slots


def test_recordings_before_and_after_each_other_do_not_mix() -> None:
    # more recordings than slots, so that slots are reused
    length = np.full(300, 50, np.int32)
    wrench = np.random.default_rng(0).normal(size=(300, 50, 6)).astype(np.float32)
    tracks = encode_batch(EncoderConfig(), preset(), wrench, length)
    single = encode_batch(EncoderConfig(), preset(), wrench[299:], length[299:])
    for axis in range(6):
        assert published(tracks.primitive, (299, axis)) == published(single.primitive, (0, axis))


@pytest.mark.parametrize(
    "options",
    [{"window": 1}, {"dt": 0.0}, {"dt": float("nan")}, {"pipe": "three"}, {"rule": "old"}, {"latency_cap": 0.0}],
)
def test_configurations_that_make_no_sense_are_refused(options: dict) -> None:
    with pytest.raises((InputError, TypeCheckError)):
        EncoderConfig(**options)


def test_bad_samples_are_refused_and_nothing_is_consumed() -> None:
    stream = Encoder(EncoderConfig(), preset())
    stream.push(np.ones((3, 6)))
    for bad in (np.ones((4, 5)), np.ones(6), np.full((4, 6), np.nan)):
        with pytest.raises(InputError):
            stream.push(bad)
    assert stream.received == 3


@pytest.mark.parametrize(
    ("wrench", "length"),
    [
        (np.zeros((2, 10, 5), np.float32), np.array([1, 2], np.int32)),
        (np.zeros((2, 10, 6), np.float32), np.array([1], np.int32)),
        (np.zeros((2, 10, 6), np.float32), np.array([1, 11], np.int32)),
        (np.full((1, 10, 6), np.inf, np.float32), np.array([10], np.int32)),
    ],
)
def test_bad_data_sets_are_refused(wrench: np.ndarray, length: np.ndarray) -> None:
    with pytest.raises(InputError):
        encode_batch(EncoderConfig(), preset(), wrench, length)


@pytest.mark.parametrize(("wrench", "length"), [((10, 6), (10,)), ((2, 10, 6), (1,)), ((2, 10, 6), (2, 6))])
def test_shapes_that_do_not_belong_together_are_refused(wrench: tuple[int, ...], length: tuple[int, ...]) -> None:
    bare = unwrap(encoder.encode)  # without the checks of types, which users do not have
    with pytest.raises(InputError, match=r"expected \[trial, time, axis\] and \[trial\]"):
        bare(EncoderConfig(), preset(), jnp.zeros(wrench), jnp.full(length, 10, jnp.int32))


def test_what_lies_beyond_the_length_does_not_matter() -> None:
    wrench = wrench_of(1, "noise").astype(np.float32)
    padded = wrench.copy()
    padded[100:] = 1e6
    length, limits = np.array([100], np.int32), jnp.asarray(preset().limits, jnp.float32)
    a, b = (encode(EncoderConfig(), limits, w[None], length) for w in (wrench, padded))
    assert_trees_equal(a, b)


def test_recordings_of_one_call_have_their_own_lengths_and_limits() -> None:
    config, length, factor = EncoderConfig(), np.array([231, 102], np.int32), np.array([1.0, 0.3])[:, None, None]
    wrench, limits = np.stack([wrench_of(seed, "noise") for seed in range(2)]), preset().limits * factor
    with jax.enable_x64(True):
        ours = jax.tree.map(np.asarray, encode(config, jnp.asarray(limits), jnp.asarray(wrench), length))
    for trial, axis in np.ndindex(2, 6):
        signal = wrench[trial, : length[trial], axis].tolist()
        expected = oracle.encode(signal, config.dt, limits[trial, axis].tolist(), config.window)
        for track, rows in zip(layers(ours), expected.out, strict=True):
            words = [row[:4] for row in published(track, (trial, axis))]
            assert words == [(item.label, item.t0, item.t1, now) for item, now, _ in rows]


@partial(jax.jit, static_argnums=0)
def streamed(config: EncoderConfig, limits: jax.Array, windows: jax.Array, count: jax.Array) -> tuple[Any, Any]:
    """The windows of a stream but for the last one, of which only some samples are there."""
    state = encoder.init(windows.shape[2:], windows.dtype)
    state, out = jax.lax.scan(lambda state, window: encoder.step(config, limits, state, window), state, windows[:-1])
    return jax.vmap(encoder.unpack)(out), encoder.flush(config, limits, state, windows[-1], count)


def test_the_lanes_of_a_stream_may_be_trials_and_axes() -> None:
    config, limits = EncoderConfig(), jnp.asarray(preset().limits * np.array([1.0, 0.3])[:, None, None], jnp.float32)
    wrench = np.stack([wrench_of(seed, "ramps", 45) for seed in range(2)]).astype(np.float32)
    windows, count = jnp.asarray(wrench.swapaxes(0, 1).reshape(9, 5, 2, 6)), np.array([4, 2], np.int32)
    steps, last = streamed(config, limits, windows, jnp.repeat(count[:, None], 6, 1))
    whole = encode(config, limits, wrench, 40 + count)
    for trial, axis in np.ndindex(2, 6):
        for one, end, expected in zip(layers(steps), layers(last), layers(whole), strict=True):
            one = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), one)
            said = published(one, (trial, axis)) + published(end, (trial, axis))
            assert said == published(expected, (trial, axis))


@pytest.mark.parametrize("dt", [0.001, 0.005, 0.1, 1 / 30])
def test_durations_are_rounded_to_whole_samples(dt: float) -> None:
    """Whatever the quotients of the seconds are rounded to: 0.3 / 0.1 is less than 3."""
    for samples in range(1, 100):
        config = EncoderConfig(dt=dt, noise_below=samples * dt, latency_cap=samples * dt)
        assert config.short == config.rules(0).cap == config.rules(2).cap == samples
    assert EncoderConfig(dt=0.1, noise_below=0.3).short == EncoderConfig(dt=0.1, latency_cap=0.3).rules(1).cap == 3


def test_the_latency_cap_limits_the_wait_of_primitives_only() -> None:
    """As its descriptions say: a composition also waits for the next primitive, here to the end."""
    push = np.interp(np.arange(2000) / 200, [1.0, 1.5], [0.0, 12.0])[:, None]
    for cap, soon in ((None, False), (0.2, True)):
        tracks = rj.encode(push, config=EncoderConfig(latency_cap=cap), thresholds=[[70.0, 46.0, 23.0, 1.0]])
        first, *rest = ((one.emit - one.t1)[one.t1 == 300].tolist() for one in layers(tracks))
        assert (first[0] <= 45, rest) == (soon, [[1700], [1700]])


@pytest.mark.parametrize("window", [5, 20, 50])
def test_a_primitive_waits_for_the_cap_and_the_end_of_a_window(window: int) -> None:
    rng = np.random.default_rng(0)
    jumps = 2 * rng.normal(size=(4, 3000, 3)) * (rng.random((4, 3000, 3)) < 0.02)
    signal = jumps.cumsum(1) + 0.02 * rng.normal(size=jumps.shape)
    config = EncoderConfig(window, latency_cap=0.2)
    words = rj.encode(signal, config=config, thresholds=preset("hiro", ["Fx", "Fy", "Fz"])).primitive
    waited = (words.emit - words.t1)[(words.label > 0) & (words.emit < 3000)]
    assert waited.max() == max(40 // window + 1, 2) * window


def test_labels_take_less_than_32_bytes_a_window() -> None:
    wrench = np.zeros((4, 2000, 6), np.float32)
    limits, length = jnp.asarray(preset().limits, jnp.float32), np.full(4, 2000, np.int32)
    for track in layers(jax.eval_shape(partial(encoder.encode, EncoderConfig()), limits, wrench, length)):
        slots = track.label.size
        assert slots >= 4 * 6 * 400
        assert sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(track)) < 32 * slots


def test_working_memory_is_at_most_six_times_the_wrench() -> None:
    shape, length = jax.ShapeDtypeStruct((100, 2000, 6), jnp.float32), jax.ShapeDtypeStruct((100,), jnp.int32)
    limits = jax.ShapeDtypeStruct((6, 4), jnp.float32)
    memory = encode.lower(EncoderConfig(), limits, shape, length).compile().memory_analysis()
    assert memory.temp_size_in_bytes <= 6 * 100 * 2000 * 6 * 4


def test_what_is_empty_is_published_as_zeros_without_derivatives() -> None:
    """An empty segment holds any values; divided by its no samples they would make NaN of all derivatives."""

    def track(values: jax.Array) -> Any:
        labels, starts, ends = (jnp.array(x, jnp.int32) for x in ([0, 0, 3], [4, 2, 0], [4, 9, 5]))
        return encoder.track_of(Segment(labels, starts, ends, *values), jnp.full(3, 9, jnp.int32))

    values = jnp.array([[7.0, 7.0, 7.0], [1.0, 1.0, 1.0], [30.0, 30.0, 30.0], [10.0, 10.0, 10.0]])
    rows = [leaf.tolist() for leaf in jax.tree.leaves(track(values))]
    assert rows == [[0, 0, last] for last in (3, 0, 5, 9, 7, 1, 6, 2)]
    found = jax.grad(lambda values: sum(jnp.sum(leaf) for leaf in jax.tree.leaves(track(values))[4:]))(values)
    np.testing.assert_allclose(found, [[0, 0, 1], [0, 0, 1], [0, 0, 0.2], [0, 0, 0.2]], rtol=1e-6)


@pytest.mark.parametrize("value", [25.3, -25.3])
def test_the_mean_of_a_word_of_days_stays_between_its_extremes(value: float) -> None:
    """Where a sum in single precision hardly grows any more: 24.9 N were published after a day at 1 kHz, then less."""
    windows = np.array([10**6, 17_280_000, 25_000_000], np.int32)
    sums = np.cumsum(np.full(windows[-1], 5 * value, np.float32), dtype=np.float32)[windows - 1]
    extremes = np.full((2, 3), value, np.float32) + np.array([[0.1], [-0.1]], np.float32)
    label, start = np.full(3, 7, np.int32), np.zeros(3, np.int32)
    word = encoder.track_of(Segment(label, start, 5 * windows, *extremes, sums, 0 * sums), 5 * windows)
    assert np.abs(sums / (5 * windows) - value)[1:].min() > 0.3  # what was published
    assert ((word.avg >= word.vmin) & (word.avg <= word.vmax)).all()


@pytest.mark.parametrize("rule", ["paper", "fit"])
@pytest.mark.parametrize(
    ("window", "name", "value", "expected"),
    [(1000, "_PIECE_SAMPLES", 64000, [16000, 64000]), (2, "_LONG_PIECE", 64, [512, 128])],
    ids=["windows", "recordings"],
)
def test_pieces_are_sized_by_the_data_and_keep_their_labels(
    rule: str, window: int, name: str, value: int, expected: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = []

    def noted(length: np.ndarray, samples: int, axes: int) -> batch.Schedule:
        sizes.append(samples)
        return plan(length, samples, axes)

    monkeypatch.setattr(batch, "plan", noted)
    wrench = np.random.default_rng(0).normal(size=(2, 9000, 1)).cumsum(1).astype(np.float32)
    few = rj.encode(wrench, 200, window=window, rule=rule)
    monkeypatch.setattr(batch, name, value)
    assert few == rj.encode(wrench, 200, window=window, rule=rule)
    assert sizes == expected
