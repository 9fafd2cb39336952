"""Streaming features: equal to the grammar's features of the recording cut off at that sample, never of its future."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from unittest.mock import patch

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcbht_jax.cli.bench import signal
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, limits_for
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.features import FAMILIES, WHOLE, FeatureSpec, Intervals, interval_features, online_weights
from rcbht_jax.features import signal_families as drawn
from rcbht_jax.features.online import check_online, names
from rcbht_jax.features.online_signal import READINGS, empty, extend, grow, moments, stride_of
from rcbht_jax.features.online_weights import two_sum
from rcbht_jax.features.spans import ClippedSpans
from rcbht_jax.introspection.chain import FeatureView, online_features, online_features_batch
from rcbht_jax.labels import Primitive
from rcbht_jax.types import LabelTrack, LabelTracks

CONFIG, PAPER = EncoderConfig(), preset()
FIT = FitConfig()
By = tuple[AnyConfig, AnyLimits]
ONLINE = tuple(f for f in FAMILIES if f not in WHOLE)
EVERYTHING = FeatureSpec(families=ONLINE)
BEGIN = np.array([0] * 5 + [413] * 6 + [1077] * 3)
NOW = np.array([5, 7, 100, 303, 413, 414, 416, 433, 500, 922, 1077, 1100, 1201, 1333])
# Single precision here, double in the grammar: a level of 100 N is known to 1e-5 N, the unit of features is 0.1 N.
CLOSE = {"rtol": 0.0, "atol": 2e-4}


def nearest_readings(words: ClippedSpans, dt: float) -> drawn.ResampledSignal:
    """The oracle of what a stream reads: moments moved to the nearest multiple of the stride."""
    moments = []
    for length in words.length.tolist():
        stride = 1
        while length > READINGS * stride:
            stride *= 2
        places = [Fraction((2 * k + 1) * length, 2 * drawn.MOMENTS * stride) for k in range(drawn.MOMENTS)]
        moments.append([min(math.floor(x + Fraction(1, 2)), (length - 1) // stride) * stride for x in places])
    return drawn.read_at(words, np.array(moments, float), dt)


def labels_of_copies(wrench: np.ndarray, length: np.ndarray, by: By) -> LabelTracks:
    """A recording, labelled once for each of these lengths."""
    return encode_batch(*by, np.repeat(wrench[None], len(length), 0), length.astype(np.int32))


def cut_off(
    wrench: np.ndarray, begin: np.ndarray, now: np.ndarray, spec: FeatureSpec, by: By = (CONFIG, PAPER)
) -> np.ndarray:
    """The oracle: label each recording as if it had ended at ``now``, then describe."""
    tracks = labels_of_copies(wrench, now, by)
    return described(tracks, Intervals(np.arange(len(now)), begin, now, CONFIG.dt), spec)


def described(tracks: LabelTracks, intervals: Intervals, spec: FeatureSpec) -> np.ndarray:
    with patch.object(drawn, "read_back", nearest_readings):
        return interval_features(tracks, intervals, spec).values


def blanked(
    wrench: np.ndarray, begin: np.ndarray, now: np.ndarray, spec: FeatureSpec, by: By = (CONFIG, PAPER)
) -> np.ndarray:
    """The oracle without provisional labels: those of the whole recording that were published by ``now``."""
    tracks = labels_of_copies(wrench, np.full(len(now), len(wrench)), by)

    def published(track: LabelTrack) -> LabelTrack:
        late = track.emit > now[:, None, None]
        return LabelTrack(**{k: np.where(late, 0, v) for k, v in vars(track).items()})

    tracks = LabelTracks(*(published(t) for t in (tracks.primitive, tracks.mc, tracks.llb)))
    return described(tracks, Intervals(np.arange(len(now)), begin, now, CONFIG.dt), spec)


@pytest.mark.parametrize(
    ("spec", "seed"),
    [
        (EVERYTHING, 0),
        (EVERYTHING, 1),
        (FeatureSpec(families=("ngram", "edges"), layers=("llb",), ngram=3), 6),
        (FeatureSpec(families=("course", "histogram"), layers=("primitive", "llb")), 6),
        (FeatureSpec(families=("ngram",), layers=("mc", "primitive"), ngram=1), 6),
        (FeatureSpec(families=("elapsed", "order", "edges"), layers=("llb", "primitive")), 6),
        (FeatureSpec(families=("ngram", "histogram"), layers=("mc", "llb"), weighing=("change", "count", "time")), 6),
        (FeatureSpec(families=("ngram",), layers=("llb",), ngram=3, weighing=("time",)), 6),
    ],
)
def test_equals_the_grammar_of_the_recording_cut_off(spec, seed):
    wrench = signal(1, 1400, seed)[0]
    said = online_features(CONFIG, preset(), FeatureView(spec), wrench, BEGIN, NOW)
    np.testing.assert_allclose(said, cut_off(wrench, BEGIN, NOW, spec), **CLOSE)
    assert len(names(spec)) == said.shape[1]


def test_without_provisional_labels_only_published_ones_count():
    wrench = signal(1, 1400, 2)[0]
    said = online_features(CONFIG, preset(), FeatureView(EVERYTHING, provisional=False), wrench, BEGIN, NOW)
    np.testing.assert_allclose(said, blanked(wrench, BEGIN, NOW, EVERYTHING), **CLOSE)


@pytest.mark.parametrize("provisional", [True, False])
def test_words_of_the_fit_rule(provisional: bool) -> None:
    """With every weighing, which the published words have in other tests."""
    wrench, length = signal(1, 1400, 8), np.array([1400])
    limits = limits_for(FIT, PAPER, None, wrench, length)
    spec = replace(EVERYTHING, weighing=("time", "change"))
    said = online_features(FIT, limits, FeatureView(spec, provisional), wrench[0], BEGIN, NOW)
    oracle = cut_off if provisional else blanked
    expected = oracle(wrench[0], BEGIN, NOW, spec, (FIT, limits))
    np.testing.assert_allclose(said, expected, **CLOSE)
    assert not np.array_equal(expected, oracle(wrench[0], BEGIN, NOW, spec))
    with pytest.raises(InputError, match="tolerance"):
        online_features(FIT, PAPER, FeatureView(spec), wrench[0], BEGIN, NOW)


def test_recorded_trials(hiro_recordings):
    rows = [int(np.flatnonzero(hiro_recordings.session == s)[0]) for s in ("A", "B", "SIM1", "SIM1F")]
    for row in rows:
        wrench = hiro_recordings.wrench[row, : hiro_recordings.length[row]]
        now = np.linspace(50, len(wrench), 8).astype(int)
        begin = np.repeat([0, now[3]], 4)
        said = online_features(CONFIG, preset(), FeatureView(EVERYTHING), wrench, begin, now)
        off = np.abs(said - cut_off(wrench, begin, now, EVERYTHING))
        # A level within rounding of a mark may fall on either side of it, which moves a share by one moment.
        assert (off > 3e-5).mean() < 5e-4
        assert off.max() < 1 / drawn.MOMENTS + 3e-5


def test_readings_are_near_the_moments(hiro_recordings):
    """Never further than half a stride; a spike may fall between two readings, the rest of a trial hardly changes."""
    for length in (1, 2, 119, 256, 257, 5000, 2**30):
        stride = int(stride_of(jnp.int32(length)))
        read = np.asarray(moments(jnp.int32(length), jnp.int32(stride))).astype(float) * stride
        exact = (np.arange(drawn.MOMENTS) + 0.5) / drawn.MOMENTS * length
        assert length <= READINGS * stride
        assert stride == 1 or length > READINGS * stride / 2
        assert (read < length).all()
        assert np.abs(read - exact).max() <= max(stride / 2 * (1 + 2e-3), 1)
    row = int(np.flatnonzero(hiro_recordings.session == "SIM1")[0])
    wrench = hiro_recordings.wrench[row, : hiro_recordings.length[row]]
    now = np.linspace(200, len(wrench), 6).astype(int)
    spec = FeatureSpec(families=("parts", "levels"))
    read = cut_off(wrench, np.zeros_like(now), now, spec)
    with patch(f"{__name__}.nearest_readings", drawn.read_back):
        exact = cut_off(wrench, np.zeros_like(now), now, spec)
    assert not np.array_equal(read, exact)
    assert np.median(np.abs(read - exact)) < 0.02 * exact.std()


def test_readings_depend_on_the_samples_alone():
    """Whether the stream was asked often or once, also in windows longer than the readings reach."""
    config = EncoderConfig(window=300)
    wrench, view = signal(1, 1400, 7)[0], FeatureView(FeatureSpec(tuple(drawn.FAMILIES), ("primitive",)))
    begin = np.array([0, 7, 7, 7, 7, 7])
    often = online_features(config, preset(), view, wrench, begin, np.array([7, 9, 290, 603, 1205, 1400]))
    once = online_features(config, preset(), view, wrench, begin[-1:], np.array([1400]))
    np.testing.assert_array_equal(often[-1], once[0])


def line(t0: int, t1: int, sign: int = 1) -> LabelTrack:
    """The label of one axis whose level is the sample's number times a sign."""
    code = Primitive.SPOS if sign > 0 else Primitive.SNEG
    ints = (np.full((1, 1), value, np.int32) for value in (code, t0, t1, t1))
    reals = (np.full((1, 1), value, np.float32) for value in (1e6, -1e6, sign * (t0 + t1) / 2, sign / CONFIG.dt))
    return LabelTrack(*ints, *reals)


@pytest.mark.parametrize(("before", "window"), [(256, 257), (2, 511), (512, 600), (255, 5)])
def test_readings_are_dropped_as_often_as_one_window_needs(before: int, window: int) -> None:
    begin, after = jnp.int32(20), before + window
    readings = grow(empty(1), CONFIG.dt, begin, begin + before, before)
    turn = 20 + before // 2
    for part in (line(20, turn), line(turn, 20 + before, -1)):
        readings = extend(readings, CONFIG.dt, begin, part)
    readings = grow(readings, CONFIG.dt, begin, begin + after, window)
    stride = next(2**k for k in range(9) if after <= READINGS * 2**k)
    assert int(readings.stride) == stride
    at = np.arange(20, 20 + after, stride)
    sign = np.where(at < turn, 1, -1)
    np.testing.assert_array_equal(readings.value[0, 0, : len(at)], sign)
    np.testing.assert_allclose(readings.value[1, 0, : len(at)], sign * at, rtol=1e-5)


def test_a_label_that_ends_where_the_interval_begins_is_not_read() -> None:
    nothing = empty(1)
    assert not np.any(extend(nothing, CONFIG.dt, jnp.int32(20), line(0, 20)).value)
    assert np.any(extend(nothing, CONFIG.dt, jnp.int32(19), line(0, 20)).value)


def test_the_first_line_goes_on_back_to_the_beginning_and_others_do_not() -> None:
    readings = extend(empty(1), CONFIG.dt, jnp.int32(0), line(5, 20))
    readings = extend(readings, CONFIG.dt, jnp.int32(0), line(25, 30, -1))
    expected = np.where(np.arange(30) < 25, 1, -1) * np.arange(30)
    np.testing.assert_allclose(readings.value[1, 0, :30], expected, rtol=1e-5, atol=1e-5)


@settings(max_examples=10)
@given(st.data())
def test_the_future_changes_nothing(data):
    wrench = signal(1, 600, 3)[0]
    now = np.array(sorted(data.draw(st.sets(st.integers(20, 400), min_size=3, max_size=3))))
    begin = np.array([0, 0, data.draw(st.integers(now[1], now[2] - 1))])
    other = wrench.copy()
    other[now[-1] :] = 1e3
    view = FeatureView(EVERYTHING)
    np.testing.assert_array_equal(
        online_features(CONFIG, preset(), view, wrench, begin, now),
        online_features(CONFIG, preset(), view, other, begin, now),
    )


def test_looks_do_not_disturb_each_other():
    wrench = signal(1, 1400, 4)[0]
    view = FeatureView(EVERYTHING)
    together = online_features(CONFIG, preset(), view, wrench, BEGIN, NOW)
    for k in (0, 2, 4, 5, 7, 10, 11, 13):  # of each beginning the first and the last look, and one between
        alone = online_features(CONFIG, preset(), view, wrench, BEGIN[k : k + 1], NOW[k : k + 1])
        np.testing.assert_array_equal(alone[0], together[k])


def test_many_recordings_in_any_order():
    wrench = signal(3, 500, 5)
    recording, begin, now = np.array([2, 0, 2, 1]), np.array([100, 0, 0, 7]), np.array([200, 499, 90, 311])
    done = []
    said = online_features_batch(CONFIG, preset(), FeatureView(EVERYTHING), wrench, recording, begin, now, done.append)
    assert sum(done) == 4
    for k in range(4):
        one = online_features(
            CONFIG, preset(), FeatureView(EVERYTHING), wrench[recording[k]], begin[k : k + 1], now[k : k + 1]
        )
        np.testing.assert_array_equal(one[0], said[k])


def test_sums_stay_exact_over_ten_million_words():
    rng = np.random.default_rng(0)
    values = rng.normal(12.0, 3.0, 1000).astype(np.float32)
    total, lost = np.float32(0), np.float32(0)
    for _ in range(20):  # the sum is grown to where single precision alone has lost three digits
        total, lost = total + np.float32(values.sum() * 500), lost
    start = float(total)
    for value in values:
        total, lost = two_sum(total, lost, value)
    assert float(total) + float(lost) == pytest.approx(start + float(values.astype(np.float64).sum()), rel=1e-9)
    assert jnp.float32(start) + jnp.float32(1e-3) == jnp.float32(start)


def test_weights_that_vanish_beside_their_sum_are_not_lost() -> None:
    """100 million and a thousand times 1, which single precision alone would round away."""
    sums = online_weights.empty((1, 1), 2, 0, 2)
    sums = replace(sums, words=sums.words.at[0].set(1e8))
    one, hot = jnp.ones((1, 1, 1)), jnp.array([[[[True, False]]]])
    none = jnp.zeros((1, 1, 1, 0), bool)
    sums = jax.lax.fori_loop(0, 1000, lambda _, sums: online_weights.add(sums, one, hot, none), sums)
    shares = np.array([1e8 + 1000, 1e8]) / (2e8 + 1000)
    np.testing.assert_allclose(online_weights.share(sums.words)[0, 0], shares, rtol=2e-7)


def test_errors():
    with pytest.raises(InputError, match="family sentence needs the whole interval"):
        check_online(FeatureSpec(families=("sentence",)))
    wrench = np.zeros((100, 6), np.float32)
    for begin, now in [([0, 0], [10, 10]), ([5], [5]), ([0], [101]), ([0, 9], [10, 20]), ([-1], [3])]:
        with pytest.raises(InputError, match="in order"):
            online_features(CONFIG, preset(), FeatureView(EVERYTHING), wrench, np.array(begin), np.array(now))
