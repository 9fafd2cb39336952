"""The fit rule against the NumPy oracle of its specification, streaming against batch, and what it promises."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import TypeCheckError

import rcbht_jax as rj
from rcbht_jax.encoding import fit
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import SHORTEST, FitConfig
from rcbht_jax.encoding.fit_line import Line, best_break, join, residuals_after, span_line
from rcbht_jax.encoding.rules import config_fields, config_from
from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance, noise_of
from rcbht_jax.errors import InputError
from rcbht_jax.labels import LLB, Primitive
from rcbht_jax.types import LabelTracks, Recordings
from tests.support.fit_oracle import FitOracle, least_squares, near
from tests.support.tracks import layers, published
from tests.support.trees import assert_trees_equal

SAMPLES, AXES = 333, ("Fx", "Fz", "My")
TOLERANCE = np.array([0.137, 0.41, 0.0523])
LIMITS = FitLimits(preset("hiro", AXES).limits, TOLERANCE)
CONFIGS = {
    "default": (FitConfig(), {}),
    "window 2, short leads": (FitConfig(window=2, lead_below=0.02), {"window": 2, "kept": 8, "lead": 4}),
    "window 20, 1 kHz": (
        FitConfig(window=20, dt=0.001),
        {"window": 20, "dt": 0.001, "cap": 200, "lead": 200, "impulse": 200, "needed": 25, "kept": 40},
    ),
    "never late, long leads": (FitConfig(latency_cap=None, lead_below=None), {"cap": None, "lead": None}),
    "other pairs": (
        FitConfig(gate=False, adj_exempt=False, contact_first=True, impulse_below=0.05, lookback=0.1, evidence=0.05),
        {"needed": 10, "kept": 15, "gate": False, "adj_exempt": False, "contact_first": True, "impulse": 10},
    ),
}
STYLES = ["noise", "steps", "ramps", "triangles"]
signals = st.tuples(st.integers(0, 2**32 - 1), st.sampled_from(STYLES), st.integers(0, SAMPLES))


def wrench_of(seed: int, style: str) -> np.ndarray:
    """Random walks, or steps, ramps and triangles with a little noise, which keeps comparisons from being ties."""
    rng = np.random.default_rng(seed)
    if style == "noise":
        return np.cumsum(rng.normal(size=(SAMPLES, 3)) * [0.02, 0.3, 0.05], 0)
    knots = rng.integers(-4, 5, (SAMPLES // 10 + 2, 3)) * rng.choice([0.0, 0.1, 1.0], (SAMPLES // 10 + 2, 1))
    if style == "triangles":  # adjustments, one after another
        knots = rng.uniform(0.5, 2.0, 3) * (-1) ** np.arange(SAMPLES // 10 + 2)[:, None]
    times = np.arange(SAMPLES) / 10
    where = np.floor(times) if style == "steps" else times
    clean = np.stack([np.interp(where, np.arange(len(knots)), knot) for knot in knots.cumsum(0).T], 1)
    return clean + rng.normal(size=clean.shape) * 0.003


def batch(config: FitConfig, wrench: np.ndarray, length: int, limits: FitLimits = LIMITS) -> LabelTracks:
    return encode_batch(config, limits, wrench[None], np.array([length], np.int32))


@pytest.mark.parametrize("dt", [0.0001, 0.001, 0.002, 0.004, 0.005, 0.01])
def test_whole_windows_are_kept_and_at_least_one_before_the_present(dt: float) -> None:
    """Whatever the quotients of the seconds are rounded to."""
    for window in range(2, 60):
        for windows in range(2, 10):
            assert FitConfig(window, dt, lookback=windows * window * dt).kept == window * (windows - 1)
        assert FitConfig(window, dt, lookback=2.5 * window * dt).kept == 2 * window
        assert FitConfig(window, dt, lookback=dt).kept == window
    assert FitConfig(dt=dt, evidence=dt).needed == SHORTEST


def name_of(count: int, slope: float, tolerance: float) -> Primitive:
    """The label of a run of so many samples, whose line rises by ``slope`` in each."""
    line = Line(jnp.array([count], jnp.int32), jnp.zeros(1), jnp.array([slope], jnp.float32))
    limits = jnp.array([[64.0], [32.0], [16.0], [8.0], [tolerance]])
    end = jnp.array([count], jnp.int32)
    found = fit.primitive_of(FitConfig(impulse_below=0.05), limits, jnp.zeros_like(end), end, line)
    return Primitive(int(found.label[0]))


def test_names_at_the_limits_are_those_of_the_specification() -> None:
    """A run is steep too long from 11 samples on, and level while 12 T^2 is not exceeded: here by 48 slope^2."""
    assert [name_of(count, 1.0, 0.1) for count in (10, 11)] == [Primitive.PIMP, Primitive.BPOS]
    assert [name_of(count, -1.0, 0.1) for count in (10, 11)] == [Primitive.NIMP, Primitive.BNEG]
    assert [name_of(7, 0.5, tolerance) for tolerance in (1.0, 0.999)] == [Primitive.CONS, Primitive.PIMP]


@pytest.mark.parametrize("name", CONFIGS)
@settings(max_examples=12)
@given(signal=signals)
def test_labels_equal_the_oracle(name: str, signal: tuple[int, str, int]) -> None:
    config, options = CONFIGS[name]
    seed, style, length = signal
    wrench = wrench_of(seed, style)
    with jax.enable_x64(True):
        ours = batch(config, wrench, length)
    for axis in range(3):
        expected = FitOracle(tuple(LIMITS.gradients[axis].tolist()), float(TOLERANCE[axis]), **options)
        expected.encode(wrench[:length, axis])
        if near(expected):
            continue
        for track, rows in zip(layers(ours), expected.out, strict=True):
            got = published(track, (0, axis))
            assert [row[:4] for row in got] == [(i.label, i.t0, i.t1, now) for i, now in rows]
            values = [(i.vmax, i.vmin, i.avg, i.grad) for i, _ in rows]
            np.testing.assert_allclose([row[4:] for row in got], values, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(("window", "cap"), [(5, 0.2), (5, 0.02), (50, 0.2)])
def test_no_word_is_published_later_than_the_page_says(window: int, cap: float) -> None:
    config = FitConfig(window, latency_cap=cap)
    lookback = config.kept + window
    after_pairs = max(config.cap or 0, lookback)
    latest = lookback, after_pairs + 2 * window, after_pairs + 4 * window
    waited = np.zeros(3, int)
    for seed in range(6):
        tracks = batch(config, wrench_of(seed, ("noise", "steps", "ramps")[seed % 3]), SAMPLES)
        waited = np.maximum(waited, [int((track.emit - track.t1).max()) for track in layers(tracks)])
    assert (waited <= latest).all()
    assert (waited > np.array(latest) // 2).all()  # words do wait


def test_the_oracle_is_rarely_undecided_and_sees_every_primitive() -> None:
    seen, undecided = set(), 0
    for seed in range(30):
        for axis in range(3):
            oracle = FitOracle(tuple(LIMITS.gradients[axis].tolist()), float(TOLERANCE[axis]))
            oracle.encode(wrench_of(seed, ("noise", "steps", "ramps")[seed % 3])[:, axis])
            undecided += near(oracle)
            seen |= {item.label for item, _ in oracle.out[0]}
    assert undecided < 10
    assert seen == set(map(int, Primitive))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@settings(max_examples=8)
@given(signal=signals, cuts=st.lists(st.integers(0, 40), max_size=15), peeks=st.sets(st.integers(0, 30)))
def test_any_chunking_equals_the_batch_bit_for_bit(
    dtype: type, signal: tuple[int, str, int], cuts: list[int], peeks: set[int]
) -> None:
    seed, style, length = signal
    wrench = wrench_of(seed, style).astype(dtype)
    with jax.enable_x64(dtype == np.float64):
        whole = batch(FitConfig(), wrench, length)
        stream, parts, start = Encoder(FitConfig(), LIMITS, dtype), [], 0
        for index, cut in enumerate([*cuts, length]):
            parts += stream.push(wrench[start : min(start + cut, length)])
            start = min(start + cut, length)
            if index in peeks:
                stream.peek()
        last = stream.ending()
        parts.append(stream.flush())
    assert_trees_equal(last, parts[-1])
    streamed = jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *parts)
    for axis in range(3):
        for one, other in zip(layers(whole), layers(streamed), strict=True):
            assert published(other, (axis,)) == published(one, (0, axis))


@settings(max_examples=5)
@given(seed=st.integers(0, 5), cuts=st.lists(st.integers(0, 700), max_size=4))
def test_lines_are_those_of_the_words_and_of_what_would_end_now(seed: int, cuts: list[int]) -> None:
    wrench, start, blocks = wrench_of(seed, "rough"), 0, []
    by_lines, by_window = (Encoder(FitConfig(), LIMITS) for _ in range(2))
    for stop in [*sorted(cuts), len(wrench)]:
        blocks += list(by_lines.lines(wrench[start:stop]))
        start = max(start, stop)
    words, runs = jax.tree.map(lambda *rows: np.concatenate(rows), *blocks)
    for number, tracks in enumerate(by_window.windows(wrench)):
        for (t0, t1, mean, slope), p, at in ((words, tracks.primitive, 0), (runs, by_window.peek().primitive, 1)):
            assert_trees_equal((t0[number], t1[number]), (p.t0[:, at], p.t1[:, at]))
            np.testing.assert_allclose(mean[number], p.avg[:, at], rtol=1e-6)
            np.testing.assert_allclose(slope[number], p.grad[:, at] * np.float32(0.005), rtol=1e-5, atol=1e-7)
    assert number + 1 == len(words[0]) == len(wrench) // 5
    with pytest.raises(InputError, match="rule"):
        Encoder(EncoderConfig(), preset()).lines(wrench)


def test_a_step_maps_over_arms() -> None:
    windows = jnp.asarray(wrench_of(0, "ramps")[:300], jnp.float32).reshape(60, 5, 3)
    limits = jnp.asarray(LIMITS.stacked(), jnp.float32)
    states = jax.vmap(lambda _: fit.init(FitConfig(), (3,)))(jnp.arange(2))
    one, many = fit.init(FitConfig(), (3,)), jax.jit(jax.vmap(fit.step, (None, None, 0, 0)), static_argnums=0)
    single = jax.jit(fit.step, static_argnums=0)
    for window in windows[:12]:
        states, both = many(FitConfig(), limits, states, jnp.stack([window * 0, window]))
        one, out = single(FitConfig(), limits, one, window)
        assert_trees_equal(jax.tree.map(lambda leaf: leaf[1], both), out)


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), cuts=st.tuples(st.integers(2, 40), st.integers(2, 40)))
def test_joined_lines_are_those_of_all_samples(seed: int, cuts: tuple[int, int]) -> None:
    y = np.random.default_rng(seed).normal(size=sum(cuts)) + 50
    parts = y[: cuts[0]], y[cuts[0] :]
    (ma, sa, _), (mb, sb, _) = map(least_squares, parts)
    with jax.enable_x64(True):
        lines = [Line(jnp.int32(len(p)), jnp.float64(m), jnp.float64(s)) for p, m, s in
                 zip(parts, (ma, mb), (sa, sb), strict=True)]  # fmt: skip
        line = jax.device_get(jax.jit(join)(*lines))
    np.testing.assert_allclose([line.mean, line.slope], least_squares(y)[:2], atol=1e-9)


@jax.jit
def broken(line: Line, samples: jax.Array, start: jax.Array, stop: jax.Array) -> tuple[jax.Array, jax.Array]:
    found, saved = best_break(line, samples, residuals_after(samples, stop), start, stop, SHORTEST)
    return found[0], saved[0]


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.integers(0, 6), st.integers(0, 4), st.integers(5, 9), st.sampled_from([0.0, 1.0]))
def test_a_break_is_the_best_of_all_pairs_of_lines(seed: int, held: int, start: int, stop: int, size: float) -> None:
    """Also where all are equally good, of which it is the first, and beside samples that are not of the run."""
    rng = np.random.default_rng(seed)
    past, samples = size * rng.normal(size=held), size * rng.normal(size=9)
    mean, slope, _ = least_squares(past) if held else (0.0, 0.0, 0.0)
    with jax.enable_x64(True):
        line = Line(jnp.full(1, held, jnp.int32), jnp.full(1, mean), jnp.full(1, slope))
        ends = (jnp.full(1, end, jnp.int32) for end in (start, stop))
        found, saved = jax.device_get(broken(line, jnp.asarray(samples[:, None]), *ends))
    run = np.concatenate([past, samples[start:stop]])
    apart = {
        place: least_squares(run[: held + place - start])[2] + least_squares(samples[place:stop])[2]
        for place in range(start, stop - 1) if held + place - start >= 2
    }  # fmt: skip
    np.testing.assert_allclose(saved, max([0.0, *(least_squares(run)[2] - rest for rest in apart.values())]), atol=1e-9)
    if apart:
        assert found == min(apart, key=apart.__getitem__)


def test_single_precision_suffices_for_an_hour_beside_a_large_constant() -> None:
    rng = np.random.default_rng(0)
    y = (1000 + rng.normal(size=(720_000, 1)) * 0.1).astype(np.float32)
    track = encode_batch(FitConfig(), FitLimits(preset("hiro", ["Fz"]).limits, np.array([0.5])), y[None],
                         np.array([720_000], np.int32)).primitive  # fmt: skip
    assert published(track, (0, 0))[0][:3] == (Primitive.CONS, 0, 720_000)
    mean, slope, _ = least_squares(y[:, 0].astype(float))
    assert abs(track.avg[0, 0, 0] - mean) < 5e-3
    assert abs(track.grad[0, 0, 0] - slope / 0.005) < 1e-4
    ramp = jnp.float32(1000) + jnp.arange(4, dtype=jnp.float32)[:, None]
    line = span_line(ramp, jnp.array([0]), jnp.array([4]))
    assert (float(line.mean[0]), float(line.slope[0])) == (1001.5, 1.0)


def test_rest_is_constant_and_a_contact_is_not() -> None:
    rng = np.random.default_rng(1)
    drift = np.linspace(0, 1.5, 4000)[:, None] * [0.3, 0.5, 0.05]
    wrench = rng.normal(size=(4000, 3)) * [0.1, 0.2, 0.01] + drift
    wrench[3000:] += np.clip(np.arange(1000) / 40, 0, 1)[:, None] * [5.0, 20.0, 2.0]
    tracks = rj.encode(Recordings.from_arrays([wrench], axes=AXES).wrench[0], rule="fit")
    for axis in range(3):
        rows = published(tracks.primitive, (axis,))
        constant = sum(min(row[2], 3000) - row[1] for row in rows if row[0] == Primitive.CONS and row[1] < 3000)
        assert constant >= 0.95 * 3000
        assert any(row[0] != Primitive.CONS and 2990 <= row[1] <= 3010 for row in rows)


def test_rest_before_a_contact_that_begins_with_an_impulse_stays_fixed() -> None:
    wrench = np.zeros((900, 3), np.float32)
    wrench[600:] = 20 * TOLERANCE + np.minimum(np.arange(300)[:, None], 10) * [1.0, 1.0, 0.3]
    behaviours = [published(batch(FitConfig(lead_below=lead), wrench, 900).llb, (0, 1)) for lead in (0.2, None)]
    assert behaviours[0][0][:3] == (LLB.FX, 0, 600)
    assert behaviours[0][1][:2] == (LLB.CT, 600)
    assert behaviours[1][0][:2] == (LLB.CT, 0)  # as by the published table


def test_files_from_before_the_choice_of_leads_keep_their_words() -> None:
    fields = {name: value for name, value in config_fields(FitConfig()).items() if name != "lead_below"}
    assert config_from(fields) == FitConfig(lead_below=None)
    assert config_from(config_fields(FitConfig())) == FitConfig()


def test_words_come_in_time() -> None:
    wrench = wrench_of(3, "noise")
    tracks = batch(FitConfig(), wrench.astype(np.float32), SAMPLES)
    for track, most in zip(layers(tracks), (10, 40 + 10, 40 + 20), strict=True):
        for row in published(track, (0, 1)):
            assert row[3] - row[2] <= most


@pytest.mark.parametrize(
    "options",
    [
        {"window": 1},
        {"dt": 0.0},
        {"latency_cap": 0.0},
        {"impulse_below": 0.0},
        {"noise_below": -1.0},
        {"lead_below": -1.0},
        {"impulse_below": float("inf")},
        {"evidence": 0.0},
        {"lookback": 0.0},
        {"dt": 1e-6},  # 10,000 windows of a lookback took hours
    ],
)
def test_configurations_that_make_no_sense_are_refused(options: dict) -> None:
    with pytest.raises((InputError, TypeCheckError)):
        FitConfig(**options)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_recording_of_one_axis_equals_itself_beside_another_bit_for_bit(dtype: type) -> None:
    """In a drain of a single lane a compiler's quotient was a digit off."""
    limits = FitLimits(preset("hiro", ["Fz"]).limits, np.array([0.2]))
    walk = np.cumsum(np.random.default_rng(0).normal(size=(300, 1)) * 0.5, 0).astype(dtype) + 100_000
    with jax.enable_x64(dtype == np.float64):
        for samples in range(100, 300, 10):
            alone = batch(FitConfig(), walk, samples, limits)
            beside = encode_batch(FitConfig(), limits, np.stack([walk, walk]), np.array([samples, samples], np.int32))
            for one, two in zip(layers(alone), layers(beside), strict=True):
                assert published(one, (0, 0)) == published(two, (0, 0))


@pytest.mark.parametrize("tolerance", [np.zeros(3), np.full(3, np.nan), np.ones(4)])
def test_tolerances_that_make_no_sense_are_refused(tolerance: np.ndarray) -> None:
    with pytest.raises((InputError, TypeCheckError)):
        rj.encode(np.zeros((50, 3)), rule="fit", tolerance=tolerance)


def test_limits_belong_to_their_rule() -> None:
    wrench, length = np.zeros((1, 10, 3), np.float32), np.array([10], np.int32)
    with pytest.raises(InputError, match="tolerance"):
        encode_batch(FitConfig(), preset("hiro", AXES), wrench, length)
    with pytest.raises(InputError, match="tolerance"):
        encode_batch(EncoderConfig(), LIMITS, wrench, length)
    with pytest.raises(InputError, match="belongs to the fit rule"):
        rj.encode(wrench, tolerance=1.0)
    with pytest.raises((InputError, TypeCheckError)):
        rj.encode(wrench, rule="best")


def test_the_tolerance_is_a_share_of_the_range_unless_noise_asks_for_more() -> None:
    rng = np.random.default_rng(0)
    wave = np.sin(np.arange(2000) / 50)[:, None] * [10.0, 10.0, 0.0]
    noise = rng.normal(size=(2000, 3)) * [0.01, 1.0, 0.0]
    for needed, least in ((5, 2.0), (20, 1.0), (80, 0.5)):  # a break saves needed tolerances squared, 20 variances
        found = auto_tolerance((wave + noise)[None], np.array([2000]), needed)
        np.testing.assert_allclose(found, [0.3, least, 1.0], rtol=0.05)


def test_recordings_of_two_samples_tell_a_range_and_no_noise() -> None:
    parts = np.array([[[0.0, 1.0], [100.0, 1.0]], [[0.0, 1.0], [100.0, 1.0]]])
    assert noise_of(list(parts)).tolist() == [0.0, 0.0]
    np.testing.assert_allclose(auto_tolerance(parts, np.array([2, 2]), needed=5), [1.5, 1.0])


def test_an_axis_that_rarely_changes_has_a_share_of_its_whole_range() -> None:
    wrench = np.zeros((1, 2000, 1))
    wrench[0, 1000] = 100.0  # outside the usual range, and no noise
    np.testing.assert_allclose(auto_tolerance(wrench, np.array([2000]), needed=5), [1.5])


def test_one_tolerance_serves_all_axes_and_a_larger_one_gives_fewer_words() -> None:
    wrench = wrench_of(5, "noise")
    fine, coarse = (rj.encode(wrench, rule="fit", tolerance=tolerance) for tolerance in (0.05, 0.8))
    assert (fine.primitive.label > 0).sum() > 2 * (coarse.primitive.label > 0).sum()
    each = rj.encode(wrench, rule="fit", tolerance=[0.05, 0.05, 0.05])
    assert_trees_equal(layers(each), layers(fine))


def test_lines_of_recorded_trials_explain_nearly_all_with_half_of_the_words(hiro_recordings: Recordings) -> None:
    rows = np.flatnonzero((hiro_recordings.source == "REAL_HIRO_ONE_SA_SUCCESS") & (hiro_recordings.session == "A"))
    few = hiro_recordings.take(rows[:4])
    signals = [wrench[:samples] for wrench, samples in zip(few.wrench, few.length, strict=True)]
    fitted, paper = rj.encode(signals, rule="fit"), rj.encode(signals)
    assert (fitted.primitive.label > 0).sum() <= 0.5 * (paper.primitive.label > 0).sum()
    missed, total = np.zeros(6), np.zeros(6)
    for recording, signal in enumerate(signals):
        total += ((signal - signal.mean(0)) ** 2).sum(0)
        for axis in range(6):
            for _, t0, t1, _, _, _, mean, slope in published(fitted.primitive, (recording, axis)):
                line = mean + slope * few.dt * (np.arange(t0, t1) - (t0 + t1 - 1) / 2)
                missed[axis] += ((signal[t0:t1, axis] - line) ** 2).sum()
    assert (1 - missed / total >= 0.999).all()
