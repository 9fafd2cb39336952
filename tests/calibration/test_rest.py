"""Thresholds of an unknown robot: what they make of rest, and what they must not depend on."""

from __future__ import annotations

import csv
import inspect
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rcbht_jax
from rcbht_jax.calibration.rest import (
    LEAST,
    STEPS,
    RestSlopes,
    auto_thresholds,
    hidden_changes,
    rest_not_constant,
    rest_thresholds,
    window_slopes,
)
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.labels import MC, Primitive
from rcbht_jax.types import LabelTrack, Recordings

RATE = 100.0


def pushes(noise: float = 0.02, count: int = 6, seed: int = 0) -> tuple[Recordings, np.ndarray]:
    """Rest with noise and drift, and pushes of two axes of different size; and which samples are at rest."""
    rng = np.random.default_rng(seed)
    wrench = (
        np.cumsum(rng.normal(size=(count, 1200, 2)) * noise / 20, axis=1) + rng.normal(size=(count, 1200, 2)) * noise
    )
    rest = np.ones((count, 1200), bool)
    for row, start in zip(wrench, rng.integers(300, 700, count), strict=True):
        shape = np.concatenate([np.linspace(0, 1, 30), np.sin(np.arange(200)) * 0.2 + 1, np.linspace(1, 0, 20)])
        row[start : start + 250] += shape[:, None] * [20.0, 2.0]
    rest[wrench[..., 0] > 1] = False
    return Recordings.from_arrays(wrench, RATE, axes=("grip", "twist"), units=("N", "Nm")), rest


@pytest.mark.parametrize("noise", [0.005, 0.05])
@pytest.mark.parametrize("window", [3, 5, 20])
def test_rest_is_constant_and_a_push_is_not(noise: float, window: int) -> None:
    recordings, still = pushes(noise)
    thresholds = rest_thresholds(recordings, window).thresholds
    tracks = encode_batch(EncoderConfig(window, recordings.dt), thresholds, recordings.wrench, recordings.length)
    count = 1200 // window
    windows = still[:, : count * window].reshape(len(still), count, window).all(2)
    rest = np.repeat(windows[..., None], 2, axis=2)
    assert (rest_not_constant(tracks.primitive, rest, window, Primitive.CONS) < 0.2).all()
    if window <= 5:  # a pair of primitives, one at rest and one of a push, swallows more rest the longer the window is
        assert (rest_not_constant(tracks.mc, rest, window, MC.K) < 0.2).all()
    moving = np.asarray(tracks.primitive.label)
    assert all(((row > 0) & (row != Primitive.CONS)).sum() >= 2 for row in moving.reshape(-1, moving.shape[2]))


def test_presets_of_another_robot_fail_where_auto_does_not() -> None:
    recordings, _ = pushes(0.5)  # a noisy sensor
    config = EncoderConfig(5, recordings.dt)
    found = rest_thresholds(recordings)
    shares = [
        rest_not_constant(
            encode_batch(config, limits, recordings.wrench, recordings.length).primitive, found.rest, 5, Primitive.CONS
        )
        for limits in (found.thresholds, preset("hiro", recordings.axes))
    ]
    assert (shares[0] < 0.05).all()
    assert (shares[1] > 0.3).all()


@pytest.mark.parametrize(("step", "constant", "hidden"), [(0.93, 3, True), (0.93, 2, False), (0.4, 4, False)])
def test_changes_are_hidden_where_most_recordings_have_constant_labels_alone(step, constant, hidden) -> None:
    wrench = 0.1 * np.random.default_rng(0).normal(size=(4, 400, 1))
    wrench[:, 200:] += step
    label = np.where(np.arange(4) < constant, Primitive.CONS, Primitive.BPOS)[:, None, None]
    labels = LabelTrack(label, label * 0, label * 0 + 400, label * 0, *[label * 0.0] * 4)
    recordings = Recordings.from_arrays(wrench, RATE, axes=("grip",))
    assert hidden_changes(recordings, labels, 5).tolist() == [hidden]


def test_units_and_other_axes_do_not_matter() -> None:
    recordings, _ = pushes()
    limits = np.asarray(rest_thresholds(recordings).thresholds.limits)
    scaled = Recordings.from_arrays(recordings.wrench * np.array([1000.0, 1.0]), RATE, axes=("grip", "twist"))
    np.testing.assert_allclose(np.asarray(rest_thresholds(scaled).thresholds.limits)[0], limits[0] * 1000, rtol=1e-5)
    alone = Recordings.from_arrays(recordings.wrench[..., 1:], RATE, axes=("twist",))
    np.testing.assert_array_equal(np.asarray(rest_thresholds(alone).thresholds.limits)[0], limits[1])


def test_empty_recordings_do_not_matter_and_values_that_are_none_are_named() -> None:
    wrench = 0.01 * np.random.default_rng(0).normal(size=(3, 400, 2))
    wrench[:, 200:] += np.linspace(0, 10, 200)[:, None]
    made = Recordings.from_arrays(list(wrench), RATE)
    more = Recordings.from_arrays([*wrench, np.zeros((0, 2))], RATE)
    np.testing.assert_array_equal(rest_thresholds(more).thresholds.limits, rest_thresholds(made).thresholds.limits)
    wrench[1, 100] = np.nan
    with pytest.raises(InputError, match="Recording 1 holds values that are not finite numbers"):
        rest_thresholds(Recordings.from_arrays(list(wrench), RATE))


def test_slopes_are_those_of_a_straight_line_fit() -> None:
    recordings, _ = pushes()
    slope, used = window_slopes(recordings, 7)
    time = np.arange(7) / RATE
    expected = np.polyfit(time, recordings.wrench[2, 14:21].astype(np.float64), 1)[0]
    np.testing.assert_allclose(slope[2, 2], expected, rtol=1e-6, atol=1e-9)
    assert used.all()


def test_share_of_rest_against_sample_by_sample() -> None:
    rng = np.random.default_rng(1)
    edges = np.sort(rng.choice(np.arange(1, 40), (3, 2, 5)), axis=-1) * 4
    label = rng.integers(0, 9, (3, 2, 4))
    zero = np.zeros(label.shape)
    track = LabelTrack(label, edges[..., :-1], edges[..., 1:], edges[..., 1:], zero, zero, zero, zero)
    rest = rng.random((3, 40, 2)) < 0.5
    expected = []
    for axis in range(2):
        other = [
            any(
                label[row, axis, slot] not in (0, Primitive.CONS)
                and edges[row, axis, slot] <= 4 * window < edges[row, axis, slot + 1]
                for slot in range(4)
            )
            for row in range(3)
            for window in range(40)
            if rest[row, window, axis]
        ]
        expected.append(np.mean(other))
    np.testing.assert_allclose(rest_not_constant(track, rest, 4, Primitive.CONS), expected)


def test_what_cannot_be_calibrated() -> None:
    for samples in (8, 3):  # one window, and none
        short = Recordings.from_arrays(np.ones((2, samples, 6)))
        with pytest.raises(InputError, match="two windows"):
            rest_thresholds(short)
        for some in (short, short.take([])):
            assert np.array_equal(auto_thresholds(some).limits, preset().limits)
    volts = Recordings.from_arrays(np.ones((2, 8, 1)), axes=("grip",), units=("V",))
    assert np.array_equal(auto_thresholds(volts).limits, preset(axes=("grip",)).limits)
    for window in (0, -5, 1):
        with pytest.raises(InputError, match=r"The window is (1 sample|(0|-5) samples); a line"):
            auto_thresholds(short, window)
    unchecked = inspect.unwrap(window_slopes)  # the annotations of the tests' run refuse it first
    for recordings, window, sentence in (
        (short.wrench, 5, "The data set is .*, ndarray; expected Recordings"),
        (short, 5.0, r"The window is '5\.0', float; expected int"),
        (short, None, "The window is 'None', NoneType; expected int"),
    ):
        with pytest.raises(InputError, match=sentence):
            unchecked(recordings, window)


def test_rest_of_human_demonstrations(external_dir: Path) -> None:
    """Screwing caps, with free motion and rest annotated by hand: nothing of it was used to make the thresholds."""
    columns = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
    parts, free = [], []
    for path in sorted((external_dir / "caps" / "runs_40hz").glob("run*.csv")):
        with path.open() as file:
            rows = list(csv.DictReader(file))
        parts.append(np.array([[float(row[name]) for name in columns] for row in rows]))
        free.append(np.array([int(float(row["label"])) <= 1 for row in rows]))
    recordings = Recordings.from_arrays(parts, 1 / 0.0245, axes=columns)
    calibrated = rest_thresholds(recordings)
    rest = np.zeros(calibrated.rest.shape, bool)
    for row, still in zip(rest, free, strict=True):
        count = len(still) // 5
        row[:count] = still[: count * 5].reshape(count, 5).all(1)[:, None]
    config = EncoderConfig(5, recordings.dt)
    tracks = encode_batch(config, calibrated.thresholds, recordings.wrench, recordings.length)
    assert (rest_not_constant(tracks.primitive, rest, 5, Primitive.CONS) < 0.2).all()
    assert (rest_not_constant(tracks.mc, rest, 5, MC.K) < 0.2).all()


def test_calibration_penalises_a_rest_that_is_not_constant():
    """A rest of strong noise, on which the objective alone would choose a constant limit below the noise."""
    rng = np.random.default_rng(5)
    slopes = RestSlopes(np.sort(np.abs(rng.normal(size=(6, 200))), axis=1), weight=3.0)
    limits = np.geomspace(8, 0.01, 30)[:, None, None] * np.array([8.0, 4.0, 2.0, 1.0]) * np.ones((30, 6, 1))
    share = (slopes.steep[None] > limits[:, :, 3, None]).mean((1, 2))
    assert slopes.penalty(limits) == pytest.approx(3 * share)
    assert (np.diff(slopes.penalty(limits)) >= 0).all()
    soft = np.array([float(slopes.soft_penalty(jnp.asarray(one))) for one in limits])
    excess = np.log(slopes.steep[None] / limits[:, :, 3, None]).clip(0).mean((1, 2))
    assert np.abs(soft / 3 - excess).max() < 0.2
    gradient = jax.grad(slopes.soft_penalty)(jnp.asarray(limits[10]))
    assert (np.asarray(gradient)[:, 3] < 0).all()  # a higher constant limit lowers the penalty
    assert not np.asarray(gradient)[:, :3].any()


def test_limits_scale_with_the_unit_exactly() -> None:
    for seed in range(20):  # a border that is rounded moves a block to the other group in about a third of them
        recordings, _ = pushes(seed=seed)
        limits = np.asarray(rest_thresholds(recordings).thresholds.limits, np.float64)
        small = Recordings.from_arrays(recordings.wrench * 2.0**-10, RATE, axes=("grip", "twist"))
        tiny = Recordings.from_arrays(recordings.wrench * np.float32(1e-3), RATE, axes=("grip", "twist"))
        assert np.array_equal(np.asarray(rest_thresholds(small).thresholds.limits, np.float64), limits * 2.0**-10)
        np.testing.assert_allclose(np.asarray(rest_thresholds(tiny).thresholds.limits), limits * 1e-3, rtol=1e-4)


@pytest.mark.parametrize(("held", "trials"), [(0.0, 1), (0.0, 4), (1e-7, 1)])
def test_held_blocks_are_not_the_whole_of_rest(held: float, trials: int) -> None:
    recordings, _ = pushes()
    wrench = recordings.wrench.copy()
    noise = held * np.random.default_rng(0).normal(size=(trials, 150, 2))
    wrench[:trials, :150] = wrench[:trials, :1] + noise  # 2 or 8 % of the time
    found = rest_thresholds(Recordings.from_arrays(wrench, RATE, axes=("grip", "twist")))
    limits = np.asarray(rest_thresholds(recordings).thresholds.limits)
    assert (found.rest.mean((0, 1)) > 0.6).all()
    np.testing.assert_allclose(np.asarray(found.thresholds.limits), limits, rtol=0.15)  # they dilute the quantile


def test_the_steepness_of_contacts_is_the_median_of_the_steepest_windows_of_their_spells() -> None:
    """Spells are those of each recording; their sizes differ from recording to recording."""
    recordings, _ = pushes(0.002)
    sizes = np.array([1.0, 5.0, 2.0, 7.0, 3.0, 1.5])
    recordings = Recordings.from_arrays(recordings.wrench * sizes[:, None, None], RATE, axes=("grip", "twist"))
    found = rest_thresholds(recordings)
    steep = np.abs(window_slopes(recordings, 5)[0])
    for axis, limits in enumerate(np.asarray(found.thresholds.limits)):
        peaks: list[float] = []
        for moving, values in zip(~found.rest[..., axis], steep[..., axis], strict=True):
            before = False
            for now, value in zip(moving.tolist(), values.tolist(), strict=True):
                if now:
                    peaks[len(peaks) - before :] = [max(value, peaks[-1])] if before else [value]
                before = now
        np.testing.assert_allclose(limits[:3], np.maximum(np.median(peaks) * STEPS, limits[3] * LEAST), rtol=1e-5)
        assert np.median(peaks) * STEPS[0] > limits[3] * LEAST[0]


@pytest.mark.parametrize(("noise", "rate"), [(0.02, 500), (0.1, 500), (0.3, 500), (0.3, 125)])
def test_limits_of_the_fit_rule_name_slow_changes_in_noise(noise: float, rate: int) -> None:
    """A contact, a push and a release, each far above the noise but slower than noise tilts windows of five samples."""
    time = np.arange(12 * rate) / rate
    force = np.interp(time, [2, 2.05, 3, 5, 6, 6.5, 8, 10], [0, 8, 8, 8, 30, 30, 5, 5])
    wrench = force + noise * np.random.default_rng(0).normal(size=len(time))
    recordings = Recordings.from_arrays([wrench[:, None]], rate, axes=("Fz",), units=("N",))
    limits = {rule: auto_thresholds(recordings, 5, rule) for rule in ("paper", "fit")}
    tracks = rcbht_jax.encode(recordings.wrench, rate=rate, rule="fit", thresholds=limits["fit"])
    assert tracks.words(0) == ["FX", "CT", "FX", "PS", "FX", "PL", "FX"]
    if noise * rate > 100:
        assert limits["paper"].limits[0, 3] > 150 > 10 > limits["fit"].limits[0, 3]


@pytest.mark.parametrize(("rule", "logarithms"), [("paper", 37.16070331517703), ("fit", 25.43551118797501)])
def test_there_are_two_rules_whose_limits_are_those_of_this_version(rule: str, logarithms: float) -> None:
    limits = rest_thresholds(pushes(0.1)[0], 3, rule).thresholds.limits
    assert np.log(limits).sum() == pytest.approx(logarithms, rel=1e-6)
    with pytest.raises(InputError, match="no rule 'sax'; there are paper and fit"):
        rest_thresholds(pushes(0.005)[0], 5, "sax")


def test_limits_of_the_fit_rule_need_no_whole_line() -> None:
    """Recordings shorter than a line, rest of one window, a spike after the last line, an axis that never changes."""
    wrench = np.random.default_rng(1).normal(size=(5, 13, 2)) * 0.1
    short = Recordings.from_arrays([*wrench[:4], wrench[4, :6]], rate=50, axes=("a", "b"))
    brief = Recordings.from_arrays([wrench[0], wrench[1, :4] * 0.01], rate=50, axes=("a", "b"))
    spike = np.zeros((2, 111, 2))
    spike[:, 110, 0] = 5.0
    for recordings in (short, brief, Recordings.from_arrays(spike, rate=50, axes=("a", "b"))):
        limits = np.asarray(rest_thresholds(recordings, 3, "fit").thresholds.limits)
        assert (np.diff(limits) < 0).all()
        assert (limits > 0).all()
