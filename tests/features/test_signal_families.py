"""Families read back from the lines, against a plain loop over moments, and what they must not notice."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.errors import InputError
from rcbht_jax.features import (
    ABSOLUTE,
    WHOLE,
    Features,
    FeatureSpec,
    concatenate_features,
    interval_features,
    signal_families,
)
from rcbht_jax.labels import AXES, PRIMITIVE_GROUP
from rcbht_jax.types import LabelTrack, LabelTracks
from tests.features.test_features import column, intervals, make_tracks, one_lane, spans

FAMILIES = tuple(signal_families.FAMILIES)
SPEC = FeatureSpec(families=FAMILIES)
FREE_OF_OFFSET = ("parts", "spread", "together", "order")
FREE_OF_SCALE = ("together", "order")
SIGNS = {0: 1, 3: 1, 1: -1, 4: -1, 2: 0}


def read(tracks: LabelTracks, axis: int, row: tuple[int, int, int], dt: float) -> list[tuple[int, float, float]]:
    """Sign, level and slope at every moment, one at a time; the tracks may be dense."""
    recording, start, end = row
    words = spans(tracks.primitive, (recording, axis), start, end)
    out = []
    for k in range(signal_families.MOMENTS):
        moment = (k + 0.5) / signal_families.MOMENTS * (end - start)
        if not words:
            out.append((0, 0.0, 0.0))
            continue
        word = ([w for w in words if w["t0"] <= moment] or words[:1])[-1]
        level = word["avg"] + word["grad"] * (moment - word["middle"]) * dt
        level = min(max(level, word["vmin"]), word["vmax"])
        out.append((SIGNS[int(PRIMITIVE_GROUP[int(word["label"])])], level, word["grad"]))
    return out


def log(x: float, unit: float) -> float:
    return float(np.sign(x) * np.log1p(abs(x) / unit))


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(0, 20), st.integers(1, 20))
def test_columns_equal_a_plain_loop(seed, start, length):
    tracks, row = make_tracks(seed), (1, start, start + length)
    made = interval_features(tracks, intervals(row), SPEC)
    drawn = [read(tracks, axis, row, 0.5) for axis in range(6)]
    sign, level, slope = (np.array([[m[i] for m in axis] for axis in drawn]) for i in range(3))
    mean, top, bottom = level[2].mean(), level[2].max(), level[2].min()
    third, eighth = slice(40, 80), slice(15, 30)

    def expect(name, value):
        assert column(made, name)[0] == pytest.approx(value, rel=1e-5, abs=1e-5)

    expect("parts.primitive.Fz.level.1of3", log(level[2, third].mean() - mean, 0.1))
    expect("parts.primitive.Fz.activity.1of8", log(np.abs(slope[2, eighth]).mean(), 0.1))
    expect("parts.primitive.Fz.grad.1of8", log(slope[2, eighth].mean(), 0.1))
    expect("parts.primitive.Fz.range.1of3", log(np.ptp(level[2, third]), 0.1))
    expect("parts.primitive.Mx.rising.1of3", (sign[3, third] > 0).mean())
    expect("parts.primitive.Mx.falling.1of8", (sign[3, eighth] < 0).mean())
    expect("spread.primitive.Fz.level.50%", log(np.median(level[2]) - mean, 0.1))
    expect("spread.primitive.Fz.grad.100%", log(slope[2].max(), 0.1))
    expect("spread.primitive.Fz.deviation.level", log(level[2].std(), 0.1))
    expect("levels.primitive.Fz.mean.1of3", log(level[2, third].mean(), 0.1))
    expect("levels.primitive.Fz.lowest", log(bottom, 0.1))
    expect("together.primitive.Fx-Mz.rising.constant", ((sign[0] > 0) & (sign[5] == 0)).mean())
    if top - bottom > 1e-3:
        expect("parts.primitive.Fz.share.1of3", (level[2, third].mean() - mean) / (top - bottom))
        expect(
            "order.primitive.Fz.highest",
            np.flatnonzero(level[2] >= top - 1e-6 * (top - bottom))[0] / signal_families.MOMENTS,
        )
        if np.ptp(level[0]) > 1e-3:
            expect("together.primitive.Fx-Fz.correlation.level", np.corrcoef(level[0], level[2])[0, 1])
    moments = (np.flatnonzero(sign[3] > 0) + 0.5) / signal_families.MOMENTS
    expect("order.primitive.Mx.mean.rising", moments.mean() if moments.size else 0.5)
    expect("order.primitive.Mx.first.rising", moments.min(initial=1))
    expect("order.primitive.Mx.last.rising", moments.max(initial=0))
    expect("together.primitive.Fx-Mz.falling.rising", ((sign[0] < 0) & (sign[5] > 0)).mean())
    falling = (np.flatnonzero(sign[3] < 0) + 0.5) / signal_families.MOMENTS
    expect("order.primitive.Mx.mean.falling", falling.mean() if falling.size else 0.5)
    for name, values in (("rise", slope[2]), ("fall", -slope[2]), ("steepest", np.abs(slope[2]))):
        near = values >= values.max() - 1e-6 * np.ptp(values)
        expect(f"order.primitive.Fz.{name}", np.flatnonzero(near)[0] / signal_families.MOMENTS)
    root = np.sign(slope) * np.sqrt(np.abs(slope))
    if np.ptp(root[0]) > 1e-3 and np.ptp(root[2]) > 1e-3:
        expect("together.primitive.Fx-Fz.correlation.slope", np.corrcoef(root[0], root[2])[0, 1])
    quarter, change = (top - bottom) / 4, level[2] - mean
    bounds = mean + quarter * np.array([[-1], [0], [1]])
    if quarter > 1e-3 and (np.abs(level[2] - bounds) > 1e-4).all():  # rounding decides nothing
        expect("order.primitive.Fz.above.mean", (change > 0).mean())
        expect("order.primitive.Fz.above.first", (level[2] > level[2, 0] + 1e-6 * quarter).mean())
        expect("order.primitive.Fz.high", (change > quarter).mean())
        expect("order.primitive.Fz.low", (change < -quarter).mean())
        expect("spread.primitive.Fz.share.10%", np.quantile(change, 0.1) / (top - bottom))


def changed(tracks: LabelTracks, factor: float, bias: float) -> LabelTracks:
    """What the encoder says when wrench and thresholds are multiplied and a constant is added to the wrench."""

    def one(track: LabelTrack) -> LabelTrack:
        moved = {name: getattr(track, name) * factor + bias for name in ("avg", "vmax", "vmin")}
        return replace(track, grad=track.grad * factor, **moved)

    return LabelTracks(one(tracks.primitive), one(tracks.mc), one(tracks.llb))


def tied(tracks: LabelTracks, row: tuple[int, int, int]) -> bool:
    """Whether rounding decides which moment of an axis is an extreme, or lies beyond a quarter of the range."""
    for axis in range(6):
        level = np.array([level for _, level, _ in read(tracks, axis, row, 0.005)])
        gaps = np.concatenate([level - level.min(), level.max() - level])
        limits = level.mean() + np.ptp(level) / 4 * np.array([[-1], [0], [1]])
        if ((gaps > 0) & (gaps < 1e-4)).any() or (np.ptp(level) and (abs(level - limits) < 1e-4).any()):
            return True
    return False


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(-50, 50))
def test_a_constant_bias_changes_levels_only(seed, bias):
    tracks, rows = make_tracks(seed), intervals((0, 0, 40), (1, 3, 29))
    assume(not tied(tracks, (0, 0, 40)) and not tied(tracks, (1, 3, 29)))
    plain, moved = (interval_features(t, rows, SPEC) for t in (tracks, changed(tracks, 1, bias)))
    for family in FREE_OF_OFFSET:
        a, b = (x.select([family]).values for x in (plain, moved))
        np.testing.assert_allclose(a, b, atol=1e-4, err_msg=family)
    if abs(bias) > 1:
        assert not np.allclose(plain.select(["levels"]).values, moved.select(["levels"]).values, atol=1e-2)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(-7, 7).map(lambda power: 2.0**power))  # exact: no tie is broken
def test_scaling_wrench_and_thresholds_changes_no_order_and_nothing_between_axes(seed, factor):
    tracks, rows = make_tracks(seed), intervals((0, 0, 40), (1, 3, 29))
    plain, scaled = (interval_features(t, rows, SPEC) for t in (tracks, changed(tracks, factor, 0)))
    free = [i for i, name in enumerate(plain.names) if ".share." in name or plain.families[i] in FREE_OF_SCALE]
    np.testing.assert_allclose(plain.values[:, free], scaled.values[:, free], atol=1e-5)
    assert sum(".share." in plain.names[i] for i in free) == 6 * (3 + 8 + 11)


def test_the_encoder_itself_scales_with_its_thresholds():
    wrench = np.cumsum(np.random.default_rng(0).normal(size=(2, 400, 6)), axis=1).astype(np.float32)
    length, limits = np.array([400, 333], np.int32), np.asarray(preset().limits)
    rows = intervals((0, 0, 400), (1, 17, 300))
    made = [
        interval_features(
            encode_batch(EncoderConfig(5, 0.005), GradientThresholds(limits * factor), wrench * factor, length),
            rows,
            SPEC,
        ).select(FREE_OF_SCALE)
        for factor in (1, np.float32(8))
    ]
    np.testing.assert_array_equal(made[0].values, made[1].values)
    assert len(np.unique(made[0].values)) > 100


def test_a_word_that_is_cut_keeps_its_line():
    tracks = one_lane((1, 0, 40))
    track = replace(tracks.primitive, avg=np.full((1, 6, 1), 10.0), grad=np.full((1, 6, 1), 0.5))
    track = replace(track, vmax=np.full((1, 6, 1), 15.0), vmin=np.full((1, 6, 1), 5.0))
    made = interval_features(LabelTracks(track, track, track), intervals((0, 20, 40)), SPEC)
    # 0.5 N/s and 0.5 s a sample: from 10 N at sample 20 to 15 N at sample 40.
    assert column(made, "levels.primitive.Fx.mean.0of3")[0] == pytest.approx(log(10 + 5 / 6, 0.1), rel=1e-5)
    assert column(made, "levels.primitive.Fx.highest")[0] == pytest.approx(log(15, 0.1), rel=1e-3)
    assert column(made, "order.primitive.Fx.highest")[0] == 119 / 120
    assert column(made, "together.primitive.Fx-Fy.correlation.level")[0] == pytest.approx(1)


def test_silence_is_described_by_finite_numbers():
    tracks = one_lane((0, 0, 0))
    made = interval_features(tracks, intervals((0, 0, 1), (0, 3, 9)), SPEC)
    assert np.isfinite(made.values).all()
    assert not made.select(["parts", "spread", "levels"]).values.any()


def test_names_are_unique_and_cover_axes_or_pairs():
    made = interval_features(make_tracks(0), intervals((0, 0, 40)), SPEC)
    assert len(set(made.names)) == len(made.names) == made.values.shape[1]
    assert {name.split(".")[2] for name in made.select(["together"]).names} == set(signal_families.axis_pairs(AXES))
    assert {name.split(".")[2] for name in made.select(FAMILIES[:2]).names} == set(AXES)
    assert all(name.startswith(f"{family}.primitive.") for name, family in zip(made.names, made.families, strict=True))
    assert not set(FAMILIES) & set(WHOLE)


@pytest.mark.parametrize("family", FAMILIES)
def test_numpy_and_jax_agree(family):
    rng = np.random.default_rng(0)
    level = rng.normal(size=(6, signal_families.MOMENTS)).cumsum(-1)
    level[4] = 3.0
    arrays = rng.integers(-1, 2, level.shape).astype(float), level, rng.normal(size=level.shape)
    host, stream = (
        signal_families.FAMILIES[family](signal_families.ResampledSignal.of(*(xp.asarray(x, dtype) for x in arrays)))
        for xp, dtype in ((np, np.float64), (jnp, np.float32))
    )
    assert (host.dtype, stream.dtype, type(host)) == (np.float64, np.float32, np.ndarray)
    assert host.shape == stream.shape == (15 if family == "together" else 6, len(signal_families.COLUMNS[family]))
    np.testing.assert_allclose(host, stream, rtol=0, atol=1e-5)


def test_absolute_families_weigh_as_much_as_the_others():
    spec = FeatureSpec(families=("histogram", "parts", "levels", "edges"), balance=True)
    made = interval_features(make_tracks(0), intervals((0, 0, 40)), spec)
    weight = made.weights(spec)
    absolute = np.isin(made.families, ABSOLUTE)
    assert np.sum(weight[absolute] ** 2) == pytest.approx(np.sum(weight[~absolute] ** 2))
    assert np.mean(weight**2) == pytest.approx(1)
    assert made.weights(replace(spec, balance=False)) is None
    assert made.select(["levels", "edges"]).weights(spec) is None
    assert made.select(["parts"]).weights(spec) is None


def test_elapsed_time_weighs_as_much_as_where_the_force_is_and_how_it_moves():
    spec = FeatureSpec(families=("histogram", "parts", "levels", "elapsed"), balance=True)
    made = interval_features(make_tracks(0), intervals((0, 5, 40)), spec)
    assert made.names[-1] == "elapsed"
    assert made.values[0, -1] == pytest.approx(35 * 0.5)
    weight = made.weights(spec)
    kinds = [made.select([f]).names for f in ("levels", "elapsed")]
    shares = [sum(weight[made.names.index(n)] ** 2 for n in kind) for kind in kinds]
    assert shares == pytest.approx([len(weight) / 3] * 2)
    assert np.mean(weight**2) == pytest.approx(1)


def test_lines_need_primitives():
    with pytest.raises(InputError, match="describe primitives"):
        FeatureSpec(families=("parts",), layers=("mc", "llb"))


def test_grammars_stand_side_by_side():
    rows = intervals((0, 0, 40), (1, 0, 30))
    coarse, fine = (interval_features(make_tracks(seed), rows, FeatureSpec(("histogram",))) for seed in (0, 1))
    both = concatenate_features({"W5": coarse, "fine": fine})
    np.testing.assert_array_equal(both.values, np.concatenate([coarse.values, fine.values], 1))
    assert both.names[0] == "W5." + coarse.names[0]
    assert both.meanings[len(coarse.names)] == "fine, " + fine.meanings[0]
    assert concatenate_features({"W5": coarse}).names == coarse.names
    short = Features(fine.values[:1], fine.names, fine.families, fine.meanings)
    for bad in ({"W5": coarse, "fine": short}, {}):
        with pytest.raises(InputError, match="cannot be concatenated"):
            concatenate_features(bad)
