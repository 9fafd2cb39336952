"""Descriptions of the past of every sample, against the definition computed sample by sample."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.features.trailing import (
    BELIEF_WINDOWS,
    LatestWords,
    RunningTotals,
    TrailingStatistics,
    latest_words,
    trailing_statistics,
    with_norms,
)
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTracks


@pytest.mark.parametrize("seconds", [0.05, 0.2, 1.0])
def test_windows_end_at_the_sample(seconds):
    dt, signal = 0.025, np.random.default_rng(1).normal(size=(60, 2)).cumsum(0) + 100
    table = trailing_statistics(signal, dt, (seconds,))
    count = round(seconds / dt)
    for now in (0, 1, 5, 59):
        window = signal[max(0, now - count + 1) : now + 1]
        time = np.arange(len(window)) * dt
        slope = np.polyfit(time, window, 1)[0] if len(window) > 1 else np.zeros(2)
        mean = window.mean(0)
        expected = [signal[now], mean, window.std(0), slope, window.min(0) - mean, window.max(0) - mean]
        assert table[now] == pytest.approx(np.concatenate(expected), abs=2e-5)


def test_nothing_depends_on_the_future():
    signal = np.random.default_rng(2).normal(size=(50, 3))
    other = signal.copy()
    other[30:] += 7
    for describe in (lambda x: trailing_statistics(x, 0.1, BELIEF_WINDOWS), lambda x: RunningTotals().push(x)):
        assert np.array_equal(describe(signal)[:30], describe(other)[:30])
        assert not np.array_equal(describe(signal)[30:], describe(other)[30:])


def test_norms_join_axes_of_one_unit():
    wrench = np.random.default_rng(3).normal(size=(4, 6))
    found = with_norms(wrench, ("N", "N", "N", "Nm", "Nm", "Nm"))
    assert found[:, 6] == pytest.approx(np.sqrt((wrench[:, :3] ** 2).sum(1)))
    assert found[:, 7] == pytest.approx(np.sqrt((wrench[:, 3:] ** 2).sum(1)))
    assert with_norms(wrench[:, :1], ("N",)).shape == (4, 1)


def test_a_word_counts_from_its_publication():
    wrench = np.zeros((1, 400, 2), np.float32)
    wrench[0, 150:250, 0] = np.linspace(0, 20, 100)
    wrench[0, 250:, 0] = 20
    tracks = encode_batch(EncoderConfig(), preset(axes=("Fx", "Fy")), wrench, np.array([400], np.int32))
    track = tracks.primitive
    label, t0, t1, emit = (np.asarray(getattr(track, name))[0] for name in ("label", "t0", "t1", "emit"))
    one = type(track)(*(np.asarray(getattr(track, name))[0] for name in track.__dataclass_fields__))
    times = np.arange(1, 401)
    table = latest_words(one, times).reshape(400, 2, 4)
    for now in (1, 40, 160, 200, 261, 400):
        for axis in range(2):
            published = [k for k in np.flatnonzero(label[axis]) if emit[axis, k] <= now]
            row = table[now - 1, axis]
            if not published:
                assert not row.any()
                continue
            last = published[-1]
            assert row[0] == label[axis, last]
            assert row[2] == t1[axis, last] - t0[axis, last]
            assert row[3] == now - t1[axis, last]


def test_a_large_level_hides_nothing():
    level = trailing_statistics(np.full((60_000, 1), 5050.1), 1e-3, (1.0,))
    assert level[:, 2:] == pytest.approx(np.zeros((60_000, 4)), abs=1e-9)
    small = np.random.default_rng(4).normal(size=(500, 1))
    near, far = (trailing_statistics(small + offset, 0.1, (1.0,)) for offset in (0.0, 1e5))
    assert far[:, 2:] == pytest.approx(near[:, 2:], abs=1e-6)


@pytest.mark.parametrize("sizes", [(1,) * 60, (7,) * 8, (0, 60), (59, 0, 1)])
def test_pieces_of_a_stream_give_the_rows_of_the_whole(sizes):
    signal = np.random.default_rng(4).normal(size=(60, 2)).cumsum(0) + 100
    pieces = np.split(signal, np.cumsum(sizes)[:-1])
    for stream, whole in (
        (TrailingStatistics(0.025, (0.05, 0.2, 1.0)), trailing_statistics(signal, 0.025, (0.05, 0.2, 1.0))),
        (RunningTotals(), RunningTotals().push(signal)),
    ):
        rows = np.concatenate([stream.push(piece) for piece in pieces])
        assert np.array_equal(rows, whole[: len(rows)])
        assert len(rows) == sum(map(len, pieces))


def test_slopes_of_a_long_stream_keep_their_digits():
    rng, dt = np.random.default_rng(5), 1e-3
    signal = 10 + 0.02 * rng.normal(size=(300_000, 1))
    signal[0] = 0
    table = trailing_statistics(signal, dt, (0.05,))
    time = (np.arange(50) - 24.5) * dt
    slopes = np.lib.stride_tricks.sliding_window_view(signal[:, 0], 50) @ time / (time @ time)
    assert np.abs(table[49:, 3] - slopes).max() < 2e-5
    for sizes in (70_001, 2**16):  # totals begin anew every 2^16 samples
        stream, ends = TrailingStatistics(dt, (0.05,)), range(sizes, len(signal), sizes)
        assert np.array_equal(np.concatenate([stream.push(piece) for piece in np.split(signal, ends)]), table)
    brief = TrailingStatistics(dt, (0.05, 70.0))  # a window may be longer than that
    rows = np.concatenate([brief.push(piece) for piece in np.split(signal, range(999, len(signal), 50_000))])
    assert np.array_equal(rows, trailing_statistics(signal, dt, (0.05, 70.0)))
    assert rows[-1, 6] == pytest.approx(signal[-70_000:].mean())


def test_words_of_a_stream_are_those_known_at_each_time():
    """Word by word as published, of three axes of which one says nothing."""
    signal = np.random.default_rng(4).normal(size=(400, 3)).cumsum(0) * [1.0, 0.2, 0.0]
    config = EncoderConfig(5, 0.01)
    limits = preset(axes=("Fx", "Mx", "Fz"))
    tracks = jax.tree.map(
        lambda x: np.asarray(x)[0], encode_batch(config, limits, signal[None], np.array([400], np.int32))
    )
    stream, before = LatestWords(3), 0
    for now in (0, 4, 20, 21, 33, 150, 260, 400):

        def new(track, since=before, now=now):
            return replace(track, label=np.where((track.emit > since) & (track.emit <= now), track.label, 0))

        stream.take(LabelTracks(*(new(getattr(tracks, layer)) for layer in LAYERS)))
        expected = [latest_words(getattr(tracks, layer), np.array([now])) for layer in LAYERS]
        np.testing.assert_allclose(stream.row(now), np.concatenate(expected, 1), rtol=1e-6)
        before = now
    assert np.count_nonzero(stream.row(400)) > 20
