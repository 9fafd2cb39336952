"""Segmentation of recordings whose intervals are unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rcbht_jax.annotations import Annotations
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.tolerance import auto_tolerance
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.segmentation import UNKNOWN, Protocol, segment
from rcbht_jax.introspection.segmenter import WrenchSegmenter, _completed
from rcbht_jax.learning.segment_metrics import score_and_interval
from rcbht_jax.types import Recordings
from tests.support.snaps import with_columns

RATE, SHIFT = 40.0, 0.1
FIELDS = ("recording", "track", "code", "start", "end")
TREES = {"trees": 8}


def made(count: int = 6, seed: int = 0, shuffled: bool = False) -> Recordings:
    """Rest, a rising force and a held force of random lengths, or the same labels in a wrong order of time."""
    rng = np.random.default_rng(seed)
    parts, starts, ends = [], [], []
    for _ in range(count):
        lengths = rng.integers(30, 60, 3)
        force = np.concatenate([np.zeros(lengths[0]), np.linspace(0, 10, lengths[1]), np.full(lengths[2], 10.0)])
        force = rng.permutation(force) if shuffled else force
        parts.append(np.stack([force, -force / 2], 1) + rng.normal(size=(len(force), 2)) * 0.05)
        starts.append(np.cumsum([0, *lengths[:2]]) / RATE)
        ends.append(len(force) / RATE)
    recordings = Recordings.from_arrays(parts, rate=RATE, axes=["Fz", "Fx"], units=["N", "N"])
    return replace(recordings, annotations=Annotations.from_starts("phase", ["rest", "push", "hold"], starts, ends))


def test_phases_are_found_causally():
    result = segment(made(), WrenchSegmenter(**TREES), Protocol(folds=0))
    assert result.score.accuracy > 0.93
    assert result.score.f1[1] > 0.9
    assert result.score.delay < 0.2
    assert result.classes == ("rest", "push", "hold")
    rows = result.rows()
    assert [row[4] for row in rows if row[0] == 0] == ["rest", "push", "hold"]
    assert rows[0][5] == 0


@pytest.mark.parametrize("folds", [1, -1])
def test_one_fold_is_refused(folds: int):
    with pytest.raises(InputError, match=f"number of folds is {folds}; expected 2 or more"):
        segment(made(4), WrenchSegmenter(trees=2), Protocol(folds=folds))


@pytest.mark.parametrize(
    ("folds", "said"), [(5, "one group held out at a time"), (3, "3 folds"), (0, "one group held")]
)
def test_the_protocol_is_that_which_was_used(folds: int, said: str):
    result = segment(made(4), WrenchSegmenter(trees=2), Protocol(folds=folds))
    assert result.to_json()["protocol"].startswith(said)  # four recordings cannot make five folds


def test_scores_have_intervals_by_group():
    data = with_columns(made(6), operator=np.array(["Ann", "Bob", "Ann", "Bob", "Cy", "Cy"]))
    result = segment(data, WrenchSegmenter(trees=2, words=False), Protocol(group="operator", folds=0))
    by_group = score_and_interval(result.truth, result.predicted, data.dt, data.column("operator"))[1]
    assert result.to_json()["interval"]["accuracy"] == list(by_group["accuracy"])
    low, high = by_group["accuracy"]
    assert low < result.score.accuracy < high


def test_no_group_is_on_both_sides(monkeypatch: pytest.MonkeyPatch):
    operator, badge = np.array(["Ann", "Bob", "Ann", "Bob", "Cy", "Cy"]), np.array([1, 2, 1, 2, np.nan, np.nan])
    data = with_columns(made(6), operator=operator, badge=badge)
    taught: list[set[str]] = []
    fit, predict = WrenchSegmenter.fit, WrenchSegmenter.predict

    def noting(self, recordings, y):
        taught.append(set(recordings.column("operator").tolist()))
        return fit(self, recordings, y)

    def checking(self, recordings):
        assert not taught[-1] & set(recordings.column("operator").tolist())
        return predict(self, recordings)

    monkeypatch.setattr(WrenchSegmenter, "fit", noting)
    monkeypatch.setattr(WrenchSegmenter, "predict", checking)
    segment(data, WrenchSegmenter(trees=2, words=False), Protocol(group="operator", folds=2))
    for group in ("operator", "badge"):
        segment(data, WrenchSegmenter(trees=2, words=False), Protocol(group=group, one_shot=True))
    assert len(taught) == 2 + 6 + 6


def test_trials_of_two_sources_are_different_groups():
    data = replace(made(4), trial=np.array(["t0", "t1"] * 2), source=np.array(["one", "one", "two", "two"]))
    result = segment(data, WrenchSegmenter(trees=2, words=False), Protocol(folds=3))
    assert result.to_json()["protocol"] == "3 folds, grouped by trial"  # two groups cannot make three folds


def test_the_tolerance_of_the_fit_rule_comes_from_the_training_recordings():
    data = made()
    y = [data.annotations.of_samples(i, "phase", n, data.dt) for i, n in enumerate(data.length.tolist())]
    train, test = data.take(np.arange(5)), data.take(np.array([5]))
    fitted = WrenchSegmenter(rule="fit", **TREES).fit(train, y[:5])
    needed = FitConfig(dt=data.dt).needed
    np.testing.assert_array_equal(fitted.tolerance_, auto_tolerance(train.wrench, train.length, needed))
    assert (fitted.predict(test)[0] == y[5]).mean() > 0.9
    coarse = WrenchSegmenter(rule="fit", tolerance=(3.0, 3.0), **TREES).fit(train, y[:5])
    assert coarse.tolerance_.tolist() == [3.0, 3.0]
    assert not np.array_equal(coarse.predict_proba(test)[0], fitted.predict_proba(test)[0])
    with pytest.raises(InputError, match="belongs to the fit rule"):
        WrenchSegmenter(tolerance=1.0).fit(train, y[:5])


def test_few_recordings_are_completed_by_copies_that_no_fold_parts_from_them():
    data = made(2)
    y = [data.annotations.of_samples(i, "phase", n, data.dt) for i, n in enumerate(data.length.tolist())]
    completed, labels, group = _completed(data, y, np.random.default_rng(0))
    assert np.bincount(group).tolist() == [4, 4]
    assert group[:2].tolist() == [0, 1]
    for row in range(2, 8):
        force = completed.wrench[row, : completed.length[row], 0]
        assert abs(force[labels[row] == 2].mean() / 10 - 1) < np.exp(0.3) - 1  # labels are as fast as the copy
        assert force[labels[row] == 0].max() < 0.3
    peaks, lengths = completed.wrench[2:, :, 0].max(1), completed.length[2:]
    assert min(np.ptp(peaks) / 10, np.ptp(lengths) / lengths.min()) > 0.1
    single = _completed(data.take(np.array([0])), y[:1], np.random.default_rng(0))
    assert single[2].tolist() == list(range(8))  # of which some have to be held out


def test_nonsense_is_not_learnt():
    result = segment(made(shuffled=True), WrenchSegmenter(**TREES), Protocol(folds=0))
    assert result.score.f1[1] < 0.7
    assert result.score.accuracy < 0.85


def test_recordings_of_another_sensor_are_refused():
    recordings = made(3)
    segmenter = WrenchSegmenter(**TREES).fit(recordings, [np.arange(n) // 20 % 2 for n in recordings.length.tolist()])
    for other in ({"axes": ("Fx", "Fz")}, {"units": ("N", "mN")}, {"dt": 1 / 20}):
        with pytest.raises(InputError, match="learned Fz, Fx in N, N at 40 Hz"):
            segmenter.predict(replace(recordings, **other))


def test_a_label_does_not_depend_on_later_samples():
    data = made()
    y = [data.annotations.of_samples(i, "phase", n, data.dt) for i, n in enumerate(data.length.tolist())]
    test = data.take(np.array([5]))
    changed = test.wrench.copy()
    changed[:, 60:] = 3
    other = replace(test, wrench=changed)
    train = data.take(np.arange(5))
    causal = WrenchSegmenter(**TREES).fit(train, y[:5])
    assert np.array_equal(causal.predict_proba(test)[0][:60], causal.predict_proba(other)[0][:60])
    offline = WrenchSegmenter(offline=True, **TREES).fit(train, y[:5])
    assert not np.array_equal(offline.predict_proba(test)[0][:60], offline.predict_proba(other)[0][:60])


def test_one_recording_teaches():
    result = segment(made(3), WrenchSegmenter(**TREES), Protocol(one_shot=True))
    assert result.score.accuracy > 0.9


def test_a_recording_of_a_single_class_teaches_nothing_alone():
    data = made(4)
    rows = data.annotations
    kept = (rows.recording != 1) | (rows.code == 0)
    one = replace(data, annotations=replace(rows, **{f: getattr(rows, f)[kept] for f in FIELDS}))
    result = segment(one, WrenchSegmenter(**TREES), Protocol(one_shot=True))
    protocol = result.to_json()["protocol"]
    assert protocol.startswith(
        "trained on one recording at a time, but not on 1 of a single class, tested on all others"
    )
    assert result.score.accuracy > 0.8
    rest = replace(data, annotations=replace(rows, **{f: getattr(rows, f)[rows.code == 0] for f in FIELDS}))
    with pytest.raises(InputError, match="two classes of phase at decisions, so none can be trained on alone"):
        segment(rest, WrenchSegmenter(**TREES), Protocol(one_shot=True))
    with pytest.raises(InputError, match="is held out, the labels of the others, 3 recordings, have 1 class at"):
        segment(rest, WrenchSegmenter(**TREES), Protocol(folds=0))


def test_a_class_between_two_decisions_teaches_nothing():
    """The error of the fit named neither the turn nor a remedy, and one shot stopped where others could be learned."""
    data = Recordings.from_arrays(np.random.default_rng(0).normal(size=(3, 200, 1)), rate=1000)
    ends = (0.111, 0.111, 0.2)
    rows = [row for k, end in enumerate(ends) for row in ((k, "phase", "a", 0, 0.101), (k, "phase", "b", 0.101, end))]
    data = replace(data, annotations=Annotations.from_rows(rows))
    with pytest.raises(InputError, match=r"^While trial trial-2 .* 2 recordings, have 1 class at the decisions"):
        segment(data, WrenchSegmenter(**TREES), Protocol(folds=0))
    result = segment(data, WrenchSegmenter(**TREES), Protocol(one_shot=True))
    assert "but not on 2 of a single class" in result.to_json()["protocol"]


def test_the_turn_that_trains_on_a_single_class_is_named(monkeypatch: pytest.MonkeyPatch):
    """The error of the fit named neither the turn nor a remedy, and came after the models of other turns."""
    data = with_columns(made(4), operator=np.array(["ann", "ann", "ann", "bob"]))
    rows = data.annotations
    kept = (rows.recording != 3) | (rows.code == 0)
    one = replace(data, annotations=replace(rows, **{f: getattr(rows, f)[kept] for f in FIELDS}))
    monkeypatch.setattr(WrenchSegmenter, "fit", lambda *_: pytest.fail("a model was trained"))
    with pytest.raises(InputError, match=r"^While operator ann is held out, the labels of the others, 1 recording,"):
        segment(one, WrenchSegmenter(**TREES), Protocol(group="operator", folds=0))


def test_recordings_without_annotation_are_labelled():
    data = made()
    marks = data.annotations
    kept = Annotations.from_table(
        {"recording": marks.recording[3:], "track": np.full(15, "phase"), "label": marks.names()[3:],
         "start": marks.start[3:], "end": marks.end[3:]},
        marks.labels,
    )  # fmt: skip
    result = segment(replace(data, annotations=kept), WrenchSegmenter(**TREES), Protocol(folds=2))
    assert result.annotated.tolist() == [False, *[True] * 5]
    truth = marks.of_samples(0, "phase", int(data.length[0]), data.dt)
    assert (result.predicted[0] == truth).mean() > 0.9
    annotated = np.concatenate(result.truth[1:])
    assert result.to_json()["majority"] == pytest.approx(np.bincount(annotated).max() / len(annotated))


@pytest.mark.parametrize("count", [2, 4])
def test_recordings_without_annotation_teach_nothing(count: int):
    data = made(count, seed=3)
    parts = [data.annotations.of_samples(row, "phase", n, data.dt) for row, n in enumerate(data.length.tolist())]
    some = [parts[0], *(np.full_like(part, UNKNOWN) for part in parts[1:])]
    segmenter = WrenchSegmenter(words=False, **TREES).fit(data, some)
    assert (segmenter.predict(data)[0] == parts[0]).mean() > 0.9


def test_what_cannot_be_learnt_is_said():
    data = made(2)
    with pytest.raises(InputError, match="no annotations"):
        segment(replace(data, annotations=Annotations()), WrenchSegmenter())
    with pytest.raises(InputError, match="another one is needed"):
        segment(data.take(np.array([0])), WrenchSegmenter())
    with pytest.raises(InputError, match="two are needed"):
        WrenchSegmenter().fit(data, [np.full(n, UNKNOWN) for n in data.length.tolist()])
    for shape in ((3,), (int(data.length[0]), 1)):
        with pytest.raises(InputError, match="other lengths"):
            WrenchSegmenter().fit(data, [np.zeros(shape, int)] * 2)


def test_a_fit_that_fails_leaves_what_was_fitted_before():
    data = made(3)
    y = [np.arange(n) // 20 % 2 for n in data.length.tolist()]
    segmenter = WrenchSegmenter(**TREES).fit(data, y)
    before = segmenter.predict_proba(data)[0]
    segmenter.set_params(rule="fit", tolerance=[0.1] * 7)  # of seven axes, where there are two
    with pytest.raises(InputError):
        segmenter.fit(data, [np.where(part > 0, 7, 3) for part in y])
    segmenter.set_params(rule="paper", tolerance=None)
    assert segmenter.classes_.tolist() == [0, 1]
    np.testing.assert_array_equal(segmenter.predict_proba(data)[0], before)
