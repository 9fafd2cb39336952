"""Monitors of nominal recordings: causal, the same in a stream, few false alarms, against a plain reference."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.typing import NDArray
from sklearn.base import clone

from rcbht_jax._util.signals import check_axes
from rcbht_jax.errors import InputError
from rcbht_jax.introspection import nominal_file
from rcbht_jax.introspection.neighbours import AROUND, OFFSET, make_bank, unbiased
from rcbht_jax.introspection.nominal import FREEDOM, Monitor, NominalMonitor
from rcbht_jax.introspection.nominal_evaluation import Watched, hold_out, judge, thresholds
from rcbht_jax.introspection.nominal_peers import GaussianProcessBand, IsolationForestMonitor, QuantileBand
from rcbht_jax.learning.model_io import reading, write_archive

MONITORS = [
    NominalMonitor(rate=20, score_rate=10, memory=0.5, levels=(1,)),
    QuantileBand(rate=20, score_rate=20),
    QuantileBand(rate=20, score_rate=20, normal=True),
    GaussianProcessBand(rate=20, score_rate=20, points=40, folds=3),
    IsolationForestMonitor(rate=20, score_rate=10, trees=5, folds=3),
]
every_monitor = pytest.mark.parametrize("monitor", MONITORS, ids=lambda one: type(one).__name__)


def pushes(count: int, seed: int, shift: float = 0.0) -> list[NDArray[np.float64]]:
    """Recordings of different lengths: a push in the middle, noise, the bias ``shift``."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(30, 45, count)
    return [
        shift + np.clip(np.arange(n) - 12, 0, 10)[:, None] * [1.0, 0.1] + 0.3 * rng.normal(size=(n, 2)) for n in lengths
    ]


@every_monitor
def test_a_stream_in_any_pieces_gives_the_scores_of_the_whole(monitor: Monitor) -> None:
    fitted, series = clone(monitor).fit(pushes(8, 0)), pushes(1, 1)[0]
    whole = fitted.scores(series)
    assert whole.shape == (len(series),)
    assert whole.std() > 0
    for sizes in ([1] * len(series), [3, 0, 8, 1, 1], [13, 2]):
        stream, cuts = fitted.stream(), np.cumsum(sizes)
        pieces = [stream.push(piece) for piece in np.split(series, cuts[cuts < len(series)])]
        np.testing.assert_array_equal(np.concatenate(pieces), whole)


@every_monitor
def test_no_score_knows_later_samples(monitor: Monitor) -> None:
    fitted, series = clone(monitor).fit(pushes(8, 0)), pushes(1, 1)[0]
    changed = series.copy()
    changed[20:] += 50
    scores, others = fitted.scores(series), fitted.scores(changed)
    np.testing.assert_array_equal(scores[:20], others[:20])
    assert others[20:].max() > scores[20:].max()


def test_what_is_usual_is_measured_between_groups() -> None:
    """Scales and usual distances against loops: a recording is not near to itself, nor to those of its day."""
    days = np.array([0, 0, 1, 1, 2])
    rng = np.random.default_rng(0)
    parts = [rng.normal(size=(30, 1, 1)) * 0.2 + 4.0 * day for day in days]
    bank = make_bank(parts, days, slack=1.0, drift=0.0, neighbours=1)
    flat = np.array(parts)[..., 0, 0]
    squares = [np.mean((flat[days == day] - np.median(flat[days != day], 0)) ** 2) for day in range(3)]
    assert bank.scale[0, 0] == pytest.approx(np.sqrt(np.mean(squares)))
    usual = np.empty((5, 30))
    for row, now in np.ndindex(5, 30):
        at = [moment for moment in (now - 1, now, now + 1) if moment >= 0]
        others = flat[days != days[row]][:, np.minimum(at, 29)]
        usual[row, now] = np.abs(others - flat[row, now]).min() / bank.scale[0, 0]
    around = [np.median(usual[:, max(now - AROUND, 0) : now + AROUND + 1]) for now in range(30)]
    np.testing.assert_allclose(bank.reference[:, 0], around, rtol=1e-5)


def by_hand(train: list[NDArray[np.float64]], test: NDArray[np.float64], monitor: NominalMonitor) -> list[float]:
    """Distances of the first definition, moment by moment; one sample per score, no memory."""
    lags, first, reach = (4, 8), 5, 4.0

    def features(part: NDArray[np.float64], t: int, channel: int) -> NDArray[np.float64]:
        x = part[:, channel]
        return np.array([x[t] - x[: min(t + 1, first)].mean()] + [x[t] - x[max(t - lag, 0)] for lag in lags])

    bank = monitor.bank_
    longest = max(map(len, train))
    out = []
    for t in range(len(test)):
        surprise = []
        for channel in range(2):
            here = features(test, t, channel) / bank.scale[channel]
            now = min(t, longest - 1)
            near = [
                np.sqrt(np.mean((here - features(part, min(u, len(part) - 1), channel) / bank.scale[channel]) ** 2))
                for part in train
                for u in range(now - 60, now + 61)
                if u >= 0 and abs(u - now) <= min(reach + 0.1 * t, np.ceil(reach + 0.1 * longest))
            ]
            surprise.append(np.log1p((min(near) / bank.reference[now, channel]) ** 2 / FREEDOM))
        out.append(float(np.mean(surprise)))
    return out


def test_scores_are_those_of_the_definition() -> None:
    train, test = pushes(4, 0), pushes(1, 3)[0]
    test = np.concatenate([test, test[-20:]])  # longer than all of them
    monitor = NominalMonitor(rate=20, score_rate=20, memory=0.05).fit(train)
    np.testing.assert_allclose(monitor.scores(test), by_hand(train, test, monitor), rtol=2e-4, atol=1e-6)


def test_the_bias_of_a_day_is_no_anomaly_but_a_level_is_where_it_counts() -> None:
    groups, biased = np.arange(12) % 3, pushes(1, 1, shift=30.0)[0]
    days = [part + np.array([0.0, 5.0 * group]) for part, group in zip(pushes(12, 0), groups, strict=True)]
    for levels, compared, seen in (((), (), False), ((0,), (0,), True), (None, (0,), True)):
        monitor = NominalMonitor(levels=levels).fit(days, groups=groups)
        assert monitor.levels_ == compared
        assert (monitor.detect(biased, 0.1) < 1) == seen
    too_few = (np.arange(12) % 2, np.append(np.zeros(10, int), [1, 2]), None)  # to know what differs between days
    for few in too_few:
        assert NominalMonitor().fit(days, groups=few).levels_ == ()


def test_axes_without_a_bias_are_those_of_the_definition() -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        groups = rng.permutation(np.repeat(np.arange(4), [3, 4, 2, 1]))
        shift = 0.5 * rng.normal(size=(4, 3))
        parts = [rng.normal(size=(rng.integers(5, 9), 3)) + shift[group] for group in groups]
        longest, found = max(map(len, parts)), []
        held = [[part[min(t, len(part) - 1)] for t in range(longest)] for part in parts]
        for axis in range(3):
            squares, rest = [], []
            for group in range(4):
                own = [
                    [row[t][axis] for t in range(longest)]
                    for row, name in zip(held, groups, strict=True)
                    if name == group
                ]
                other = [
                    [row[t][axis] for t in range(longest)]
                    for row, name in zip(held, groups, strict=True)
                    if name != group
                ]
                middle = np.median(own, 0)
                squares.append((middle - np.median(other, 0)).mean() ** 2)
                rest += [(np.array(row) - middle) ** 2 for row in own if len(own) > 1]
            if np.sqrt(np.mean(squares)) < OFFSET * np.sqrt(np.mean(rest)):
                found.append(axis)
        assert unbiased(parts, groups) == tuple(found)


def test_lasting_long_is_no_anomaly() -> None:
    monitor = NominalMonitor().fit(pushes(20, 0))
    rng, series = np.random.default_rng(5), pushes(1, 1)[0]
    longer = np.concatenate([series, [10.0, 1.0] + 0.3 * rng.normal(size=(100, 2))])
    assert monitor.scores(longer)[-1] < 1.5 * monitor.peaks_.max()


def test_the_promise_covers_recordings_as_long_as_those_that_set_the_threshold() -> None:
    """docs/howto/monitor.md states what longer ones do."""
    rng, push = np.random.default_rng(0), np.clip(np.arange(80) - 30, 0, 20)[:, None] * [0.5, 0.02]

    def successes(count: int, hold: int) -> list[NDArray[np.float64]]:
        ideal = np.concatenate([push, np.tile(push[-1], (hold, 1))])
        return [ideal + rng.normal(size=ideal.shape) * [0.1, 0.005] for _ in range(count)]

    def alarms(trained: int, hold: int) -> int:
        monitor = NominalMonitor(rate=20).fit(successes(40, trained))
        return sum(np.isfinite(monitor.detect(one)) for one in successes(60, hold))

    assert alarms(0, 0) <= 7
    assert alarms(200, 200) <= 7
    assert alarms(0, 1200) > 9


@pytest.mark.parametrize("calibration", ["split", "cross"])
def test_false_alarms_of_new_recordings_are_as_promised(calibration: str) -> None:
    """Exchangeable recordings: over many fits, the share of alarms is at most alpha, and not far below."""
    alpha, fits, tests, count = 0.2, 30, 10, 24
    alarms = []
    for seed in range(fits):
        series = np.random.default_rng(seed).standard_t(3, size=(count + tests, 8, 2)) * [1.0, 2.0]
        monitor = NominalMonitor(rate=10, score_rate=10, calibration=calibration, folds=3, random_state=seed)
        monitor.fit(series[:count])
        level = monitor.threshold(alpha)
        alarms += [monitor.scores(part).max() > level for part in series[count:]]
    error = np.sqrt(alpha * (1 - alpha) * (1 / (fits * tests) + 1 / (fits * 12)))  # of recordings and of thresholds
    assert alpha - 0.08 - 3 * error < np.mean(alarms) < alpha + 3 * error


def test_few_groups_keep_the_promise() -> None:
    """Of three groups, a fifth of these new recordings exceeded the threshold for a tenth."""
    alpha, fits, tests, count, alarms = 0.1, 30, 10, 30, []
    for seed in range(fits):
        series = np.cumsum(np.random.default_rng(seed).normal(size=(count + tests, 12, 2)), 1)
        monitor = NominalMonitor(rate=10, score_rate=10, memory=0.5, levels=())
        level = monitor.fit(series[:count], groups=np.arange(count) % 3).threshold(alpha)
        alarms += [monitor.scores(part).max() > level for part in series[count:]]
    error = np.sqrt(alpha * (1 - alpha) * (1 / (fits * tests) + 1 / (fits * count)))  # of recordings and of thresholds
    assert 0.02 < np.mean(alarms) < alpha + 3 * error


def test_what_sets_an_exact_threshold_has_no_part_in_the_monitor() -> None:
    """The axes whose values are compared are chosen on the training half, as all else is."""
    rng, days = np.random.default_rng(0), np.repeat(np.arange(3), 8)
    series = rng.normal(size=(24, 30, 2))
    monitor = NominalMonitor(calibration="split").fit(series, groups=days)
    held = np.setdiff1d(np.arange(24), np.random.default_rng(0).permutation(24)[:12])
    biased = series.copy()
    biased[held] += 50.0 * days[held, None, None]
    again = NominalMonitor(calibration="split").fit(biased, groups=days)
    assert monitor.levels_ == again.levels_ == (0, 1)
    assert np.array_equal(monitor.bank_.described, again.bank_.described)


def test_a_threshold_that_cannot_be_promised_is_refused() -> None:
    monitor = NominalMonitor().fit(pushes(8, 0))
    assert len(monitor.peaks_) == 8
    assert monitor.threshold(1 / 9) == monitor.peaks_.max()
    with pytest.raises(InputError, match="it takes 19"):
        monitor.threshold(0.05)


def test_a_file_gives_the_same_scores(tmp_path: Path) -> None:
    monitor, series = NominalMonitor().fit(pushes(9, 0), groups=np.arange(9) % 3), pushes(1, 1)[0]
    assert monitor.levels_ == (0, 1)
    path = tmp_path / "nominal.monitor"
    nominal_file.save(path, nominal_file.MonitorFile(monitor, ("Fz", "Mx"), ("skill=7",), ("N", "Nm")))
    again = nominal_file.load(path)
    assert (again.axes, again.where) == (("Fz", "Mx"), ("skill=7",))
    np.testing.assert_array_equal(again.monitor.scores(series), monitor.scores(series))
    assert again.monitor.threshold(0.2) == monitor.threshold(0.2)
    assert again.units == ("N", "Nm")
    with reading(path, nominal_file.FORMAT, gaps=("described",)) as (meta, arrays):
        del meta["units"], meta["levels"]  # as files were written before
        meta["parameters"]["levels"] = [0, 1]
        write_archive(path, meta, arrays)
    old = nominal_file.load(path)
    np.testing.assert_array_equal(old.monitor.scores(series), monitor.scores(series))
    assert old.units == ()
    check_axes(("Fz", "Mx"), ("mN", "Nm"), old.axes, old.units, "a store")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match="not a readable"):
        nominal_file.load(path)


@pytest.mark.parametrize(
    "kinds",
    [
        {"levels": np.array([0]), "lags": np.array([0.2, 0.4]), "folds": np.int64(5)},
        {"levels": (1.0,), "neighbours": 2.0, "rate": np.float32(20), "drift": np.float32(0.25)},
        {"levels": (np.int64(1),), "neighbours": np.int32(2), "slack": np.float64(0.1)},
    ],
)
def test_numbers_of_any_type_are_parameters_and_are_kept_in_a_file(kinds: dict[str, Any], tmp_path: Path) -> None:
    monitor, series = NominalMonitor(**kinds).fit(pushes(9, 0)), pushes(1, 1)[0]
    nominal_file.save(tmp_path / "m", nominal_file.MonitorFile(monitor, ("Fz", "Mx"), ()))
    again = nominal_file.load(tmp_path / "m").monitor
    np.testing.assert_array_equal(again.scores(series), monitor.scores(series))
    assert again.threshold(0.2) == monitor.threshold(0.2)


def test_every_group_is_scored_without_itself() -> None:
    series, groups = pushes(12, 0), np.arange(12) % 3
    nominal = np.arange(12) < 9
    watched = hold_out(NominalMonitor(), series, nominal, groups)
    teach = np.flatnonzero(nominal & (groups != 1))
    alone = NominalMonitor().fit([series[row] for row in teach], groups=groups[teach])
    np.testing.assert_array_equal(watched.scores[10], alone.scores(series[10]))
    np.testing.assert_array_equal(watched.calibration["1"], alone.peaks_)
    assert thresholds(watched, 0.05) == {}
    assert set(thresholds(watched, 0.2)) == {"0", "1", "2"}
    with pytest.raises(InputError, match=r"the 9 nominal recordings are of 1 group\. Choose other groups"):
        hold_out(NominalMonitor(), series, nominal, np.zeros(12))


def test_many_groups_are_held_out_several_at_a_time() -> None:
    series, groups, nominal = pushes(12, 0), np.arange(12) // 2, np.ones(12, bool)
    watched = hold_out(NominalMonitor(), series, nominal, groups, folds=2)
    teach = np.flatnonzero(groups % 2 == 1)
    alone = NominalMonitor().fit([series[row] for row in teach], groups=groups[teach])
    for row in np.flatnonzero(groups % 2 == 0):  # groups 0, 2 and 4
        np.testing.assert_array_equal(watched.scores[row], alone.scores(series[row]))
        np.testing.assert_array_equal(watched.calibration[str(groups[row])], alone.peaks_)
    with pytest.raises(InputError, match="-1 folds; expected 0 or more"):
        hold_out(NominalMonitor(), series, nominal, groups, folds=-1)


def test_a_fit_that_fails_changes_no_score() -> None:
    monitor, new = NominalMonitor(rate=20).fit(pushes(6, 0)), pushes(1, 1)[0]
    before = monitor.scores(new)
    with pytest.raises(InputError, match="Without group 0 a single recording remains"):
        monitor.fit([one[:, :1] for one in pushes(3, 2)], groups=[0, 0, 1])
    np.testing.assert_array_equal(monitor.scores(new), before)
    with pytest.raises(InputError, match="numbers of axes, 0 to"):
        monitor.set_params(levels=(9,)).fit(pushes(6, 0))
    np.testing.assert_array_equal(monitor.scores(new), before)


def test_recordings_of_xarray_may_have_their_dimensions_in_any_order() -> None:
    series = np.stack([one[:30] for one in pushes(6, 0)])
    turned = xr.DataArray(series, dims=("trial", "time", "axis")).transpose("time", "axis", "trial")
    np.testing.assert_array_equal(NominalMonitor().fit(turned).peaks_, NominalMonitor().fit(series).peaks_)


def test_alarms_are_judged_by_the_onset() -> None:
    peaks = [[0, 0, 0, 0], [0, 9, 0, 0], [0, 0, 9, 9], [9, 9, 9, 9], [0, 0, 0, 1]]
    watched = Watched(
        tuple(np.array(row, float) for row in peaks),
        np.array([True, True, False, False, False]),
        np.array(list("aaaab")),
        np.array([2.0, 2, 2, 2, 2]),
        {},
        rate=2.0,
    )
    found = judge(watched, {"a": 5.0}, np.array([np.nan, np.nan, 1.0, 1.5, 1.0]))
    assert found["false_alarms_of"] == [1, 2]
    assert found["detected"] == 0.5  # the alarm after 0.5 s comes a second before the onset; group b is not counted
    assert (found["early"], found["delay_median"]) == (1, 0.5)
    assert found["auroc"] == (1.5 + 1.5 + 1) / 6
    assert found["groups"]["b"]["detected"] is None


@pytest.mark.parametrize(
    ("monitor", "series", "words"),
    [
        (NominalMonitor(), pushes(2, 0), "three or more"),
        (NominalMonitor(), [np.zeros((5, 2)), np.zeros((5, 3)), np.zeros((5, 2))], "same axes"),
        (NominalMonitor(), [np.full((5, 2), np.nan)] * 3, "not finite"),
        (NominalMonitor(), [1e200 * part for part in pushes(3, 0)], "not finite numbers, or huge"),  # all scores were 0
        (NominalMonitor(calibration="none"), pushes(3, 0), "cross, split"),
        (NominalMonitor(neighbours=0), pushes(3, 0), "neighbours is 0"),
        (NominalMonitor(lags=(0.2, -0.4)), pushes(3, 0), r"lags \(0.2, -0.4\)"),
        (NominalMonitor(lags=((0.2, 0.4),)), pushes(3, 0), r"lags \(\(0.2, 0.4\),\)"),
        (NominalMonitor(levels=(0.5,)), pushes(3, 0), r"levels \(0.5,\)"),
        (NominalMonitor(neighbours=1.5), pushes(3, 0), "neighbours 1.5"),
        (NominalMonitor(memory=0), pushes(3, 0), "memory is 0"),
        (NominalMonitor(folds=1), pushes(3, 0), "folds is 1; expected 2"),
        (NominalMonitor(score_rate=1e-300), pushes(3, 0), "score_rate is 1e-300"),
        (QuantileBand(share=2), pushes(3, 0), "share is 2"),
        (GaussianProcessBand(points=1), pushes(3, 0), "points is 1"),
    ],
)
def test_bad_input_is_one_sentence(monitor: Monitor, series: list[NDArray[np.float64]], words: str) -> None:
    with pytest.raises(InputError, match=words):
        monitor.fit(series)


@every_monitor
def test_a_time_is_no_axis_and_names_of_axes_are_compared(monitor: Monitor) -> None:
    plain = pushes(8, 0)
    frames = [pd.DataFrame(part, columns=["Fz", "My"]).assign(time=np.arange(len(part)) / 20) for part in plain]
    fitted = clone(monitor).fit(frames)
    assert fitted.feature_names_in_.tolist() == ["Fz", "My"]
    expected = clone(monitor).fit(plain).scores(plain[0])
    for form in (frames[0], plain[0], xr.DataArray(plain[0].T, {"axis": ["Fz", "My"]}, ("axis", "time"))):
        np.testing.assert_array_equal(fitted.scores(form), expected)
    with pytest.raises(InputError, match="axes My, Fz; fit had Fz, My"):
        fitted.scores(frames[0][["My", "Fz"]])
    with pytest.raises(InputError, match="40 samples per second"):
        fitted.scores(frames[0].assign(time=np.arange(len(plain[0])) / 40))
    assert not hasattr(fitted.fit(plain), "feature_names_in_")


def test_a_gaussian_process_finds_course_and_noise() -> None:
    """A sine with noise of .1 around it: mean and width of the band are those, in every channel's own unit."""
    rng = np.random.default_rng(0)
    course = np.sin(np.arange(60) / 8)
    series = [np.stack([course, 100 * course], 1) + rng.normal(size=(60, 2)) * [0.1, 10] for _ in range(12)]
    band = GaussianProcessBand(rate=20, folds=2).fit(series)
    model = band._learn(series, np.zeros(12, np.int64))
    assert (np.abs(model.middle - np.stack([course, 100 * course], 1)) < [0.1, 10]).all()
    np.testing.assert_allclose(model.half, np.full((60, 2), [0.1, 10]), rtol=0.25)
    late = np.stack([course, 100 * course], 1)
    late[40:, 1] += 80  # eight deviations
    scores = band.scores(late)
    assert scores[:40].max() < 3
    assert scores[40:].min() > 5


def test_samples_of_other_axes_are_refused() -> None:
    monitor = NominalMonitor().fit(pushes(4, 0))
    for axes, words in ((3, "3 axes"), (1, "1 axis")):
        with pytest.raises(InputError, match=f"The samples have {words}; the monitor learned 2"):
            monitor.scores(np.zeros((5, axes)))
