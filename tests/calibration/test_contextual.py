"""The authors' rule on primitives whose limits can be counted by hand; learners that must not see test folds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rcbht_jax.calibration import contextual, nested
from rcbht_jax.calibration.dataset import calibration_data
from rcbht_jax.calibration.nested import CandidateBank, calibrated_svm, fixed
from rcbht_jax.calibration.objective import Objective
from rcbht_jax.calibration.search import SearchSpace
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import TaskSpec, extract_features, labelled_intervals
from rcbht_jax.learning.validation import nested_svm
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import LabelTrack, Recordings
from tests.support.snaps import marked

DT = 0.005
CONFIG = EncoderConfig(window=5, dt=DT)
QUICK = Grid(kernels=("linear",), costs=(1.0,), scalings=(True,), inner=2)


def track(slopes: list[float]) -> LabelTrack:
    """One trial of primitives of 1 s each, slopes on the axes times 1 ... 6; a free slot at the end."""
    n = len(slopes)
    grad = np.zeros((1, 6, n + 1))
    grad[:, :, :n] = np.array(slopes) * np.arange(1, 7)[:, None]
    label = np.zeros((1, 6, n + 1), np.int8)
    label[..., :n] = 7
    t0 = np.broadcast_to(np.arange(n + 1, dtype=np.int32) * 200, label.shape).copy()
    zero = np.zeros_like(grad)
    return LabelTrack(label, t0, t0 + np.int32(200), t0, zero, zero, zero, grad)


def test_limits_of_a_trial_counted_by_hand():
    # Approach 0-2 s, rotation 2-4.5 s, insertion 4.5-8.5 s, mating after.
    made = track([9, 9, 1, -3, 50, 6, -20, 7, 80, 99])
    onset, end = np.array([[0, 1.5, 4.5, 8.5]]), np.array([10.0])
    impulse, constant = contextual.trial_limits(made, onset, end, DT)
    axis = np.arange(1, 7)
    # Primitives inside the insertion begin at 5, 6 and 7 s; inside the rotation at 2 and 3 s (4-5 s sticks out).
    np.testing.assert_allclose(impulse[0], 0.85 * 20 * axis)
    np.testing.assert_allclose(constant[0], 0.90 * abs(1 - 3) / 2 * axis)


def test_missing_states_are_silent_and_medians_ignore_them():
    made = track([9, 9, 1, -3, 50, 6, -20, 7, 80, 99])
    for missing in (1, 2):
        onset = np.array([[0, 1.5, 4.5, 8.5]])
        onset[0, missing] = np.nan
        impulse, constant = contextual.trial_limits(made, onset, np.array([10.0]), DT)
        assert np.isnan(constant).all()
        assert np.isnan(impulse).all() == (missing == 2)
    # A trial that never mates inserts until its end: 80 comes in, 99 ends with the record and is not inside.
    onset = np.array([[0, 1.5, 4.5, np.nan]])
    assert contextual.trial_limits(made, onset, np.array([10.0]), DT)[0][0, 0] == pytest.approx(0.85 * 80)
    silent = np.full((1, 6), np.nan)
    values = np.tile([[1.0], [3.0], [50.0]], (1, 6))
    found = contextual.combine(np.concatenate([values * 10, silent]), np.concatenate([values, silent]), preset())
    np.testing.assert_allclose(found.thresholds.limits, np.tile([30, 21, 12, 3], (6, 1)))
    assert found.trials.tolist() == [[3] * 6, [3] * 6]


def test_a_primitive_that_ends_with_the_rotation_is_inside_and_a_free_slot_is_nowhere() -> None:
    made = track([9, 9, 1, -5, 50, 6, -20, 7, 80, 99])
    onset, end = np.array([[0, 1.5, 4.0, 8.5]]), np.array([10.0])
    assert contextual.trial_limits(made, onset, end, DT)[1][0, 0] == pytest.approx(0.90 * abs(1 - 5) / 2)
    label = made.label.copy()
    label[..., [3, 6]] = 0
    impulse, constant = contextual.trial_limits(replace(made, label=label), onset, end, DT)
    assert impulse[0, 0] == pytest.approx(0.85 * 7)
    assert constant[0, 0] == pytest.approx(0.90 * 1)


def test_axes_copy_as_the_authors_do_and_the_preset_stands_in():
    impulse, constant = np.arange(60.0, 66)[None], np.arange(1.0, 7)[None]
    limits = contextual.combine(impulse, constant, preset()).thresholds.limits
    np.testing.assert_allclose(limits[:, 0], [60, 62, 62, 64, 64, 64])
    np.testing.assert_allclose(limits[:, 3], [1, 1, 1, 5, 5, 5])
    own = contextual.combine(impulse, constant, preset(), contextual.OWN).thresholds.limits
    np.testing.assert_allclose(own[:, [0, 3]], np.stack([impulse[0], constant[0]], 1))
    silent = np.full((2, 6), np.nan)
    fallback = contextual.combine(silent, silent, preset()).thresholds.limits
    np.testing.assert_allclose(fallback[:, [0, 3]], np.asarray(preset().limits)[:, [0, 3]])
    found = contextual.combine(np.array([[9.0] * 6]), np.array([[1.0, 9, 12, 1, 1, 1]]), preset(), contextual.OWN)
    assert found.ungraded == ("Fy", "Fz")  # there the rotation is as steep as the insertion
    assert (np.ptp(np.asarray(found.thresholds.limits)[[1, 2]], axis=1) < 1e-3).all()
    with pytest.raises(InputError, match="copying rule"):
        contextual.combine(impulse, constant, preset(), (("Fx", "Fx"),))


def test_trials_are_counted_for_the_axis_that_a_limit_comes_from() -> None:
    """The number was that of trials with a primitive on any axis."""
    impulse = np.full((3, 6), np.nan)
    impulse[0, 0], impulse[1:, 1], impulse[:, 2] = 9.0, 8.0, 7.0  # one, two and three trials
    constant = np.where(np.arange(6) == 5, 0.5, np.full((3, 6), np.nan))
    assert contextual.combine(impulse, constant, preset()).trials.tolist() == [[1, 3, 3, 0, 0, 0], [0] * 6]
    own = contextual.combine(impulse, constant, preset(), contextual.OWN)
    assert own.trials.tolist() == [[1, 2, 3, 0, 0, 0], [0, 0, 0, 0, 0, 3]]


def recordings(trials: int = 8, seed: int = 0) -> Recordings:
    """Two states of the assembly differ by the steepness of a saw tooth; the others by noise only."""
    rng = np.random.default_rng(seed)
    steep = np.repeat([3.0, 8.0, 3.0, 30.0], 100)
    teeth = (np.sign(np.sin(np.arange(400) / 5)) * steep)[None, :, None]
    steps = teeth * rng.uniform(0.8, 1.2, (trials, 1, 6)) + rng.normal(size=(trials, 400, 6))
    names = np.array([f"t{k}" for k in range(trials)])
    same = np.full(trials, "S")
    onset = np.tile([0.0, 0.5, 1.0, 1.5], (trials, 1))
    return snap_recordings(
        wrench=np.cumsum(steps * DT, axis=1).astype(np.float32),
        length=np.full(trials, 400, np.int32),
        dt=DT,
        onset=onset,
        onset_harmonised=onset,
        trial=names,
        arm=np.full(trials, "R"),
        source=same,
        session=same,
        outcome=np.full(trials, "success"),
        failure_type=np.full(trials, ""),
        deviation=np.full((trials, 3), np.nan),
        note=np.full(trials, ""),
    )


def test_context_of_recordings_and_of_none():
    some = recordings()
    found = contextual.calibrate(some, np.arange(8), CONFIG)
    limits = np.asarray(found.thresholds.limits)
    assert (np.diff(limits, axis=1) < 0).all()
    assert (found.trials[0] == 8).all()
    with pytest.raises(InputError, match="no trial to calibrate"):
        contextual.calibrate(some, np.arange(0), CONFIG)
    nothing = marked(some, onset_harmonised=np.full((8, 4), np.nan))
    with pytest.raises(InputError, match="states may be missing"):
        contextual.calibrate(nothing, np.arange(8), CONFIG)
    onset = np.tile([0.0, np.nan, 1.0, 1.5], (8, 1))  # insertions alone are enough
    found = contextual.calibrate(marked(some, onset_harmonised=onset), np.arange(8), CONFIG)
    assert found.trials.tolist() == [[8] * 6, [0] * 6]


def test_recorded_boundaries_are_used_where_they_are_asked_for() -> None:
    """They served the scores alone; the limits came from the corrected ones."""
    both = recordings()
    late = marked(both, onset=both.starts("states-harmonised") + 0.25)
    alone = replace(late, annotations=late.annotations.of("states"))
    recorded = contextual.calibrate(late, np.arange(8), CONFIG, boundaries="recorded")
    np.testing.assert_array_equal(recorded.impulse, contextual.calibrate(alone, np.arange(8), CONFIG).impulse)
    assert not np.array_equal(recorded.impulse, contextual.calibrate(late, np.arange(8), CONFIG).impulse)


def test_a_user_s_track_without_corrections_serves_and_other_tracks_are_named() -> None:
    some = recordings()
    plain = replace(some, annotations=some.annotations.of("states-harmonised"))
    rows = plain.annotations
    own = replace(plain, annotations=replace(rows, labels={"states": rows.labels["states-harmonised"]}))
    expected = contextual.calibrate(some, np.arange(8), CONFIG)
    np.testing.assert_array_equal(contextual.calibrate(own, np.arange(8), CONFIG).impulse, expected.impulse)
    other = replace(plain, annotations=replace(rows, labels={"phase": rows.labels["states-harmonised"]}))
    with pytest.raises(InputError, match=r"needs a track states of approach, .*; there is phase \(approach, "):
        contextual.calibrate(other, np.arange(8), CONFIG)


def test_poisoned_test_folds_change_no_threshold_and_no_training():
    clean = recordings()
    items = labelled_intervals(clean, TaskSpec())
    train = np.flatnonzero(np.isin(items.trial, ["t0", "t1", "t2", "t4", "t6", "t7"]))
    test = np.setdiff1d(np.arange(len(items.y)), train)
    poison = clean.wrench.copy()
    poison[[3, 5]] = np.random.default_rng(9).normal(size=(2, 400, 6)) * 1e3
    candidates = SearchSpace(groups=(0,) * 6).thresholds(np.random.default_rng(1).random((8, 4)))
    answers = []
    for wrench in (clean.wrench, poison):
        data = replace(clean, wrench=wrench)
        library = CandidateBank.make(calibration_data(data, items, CONFIG), CONFIG, candidates, chunk=3)
        assert len(library.times) == 8
        choose = library.chooser(Objective(), top=2)

        def by_context(rows, seed, data=data):
            return GradientThresholds(contextual.calibrate(data, rows, CONFIG).thresholds.limits[None])

        for chooser in (choose, by_context, fixed(preset())):
            learner = calibrated_svm(data, items, CONFIG, chooser, QUICK, FeatureSpec(families=("histogram",)))
            answers.append(learner(train, test, 0))
    for before, after in zip(answers[:3], answers[3:], strict=True):
        assert before[1] == after[1]  # thresholds, kernel and cost
    assert any((a[0] != b[0]).any() for a, b in zip(answers[:3], answers[3:], strict=True))  # the poison works
    assert np.mean(answers[0][0] == items.y[test]) > 0.6


def test_fixed_thresholds_are_one_or_several_in_every_fold() -> None:
    one = preset().limits
    several = np.stack([one, 2 * one])
    for given, expected in ((one, one[None]), (several, several), (GradientThresholds(several), several)):
        for rows in (np.arange(2), np.arange(5)):
            np.testing.assert_array_equal(fixed(given)(rows, 0).limits, expected)


def test_candidates_are_ranked_by_the_rows_given_and_the_first_of_equals_comes_first() -> None:
    """Candidates 1 and 2 name the classes of the first four recordings, 0 those of the last four."""
    telling, mute = np.zeros((2, 6, 25), np.int32), np.zeros((2, 6, 25), np.int32)
    telling[[0, 1], :, [0, 1]], mute[..., 0] = 10, 10
    times = np.stack([[mute] * 4 + [telling] * 4, [telling] * 4 + [mute] * 4, [telling] * 4 + [mute] * 4])
    limits = np.stack([preset().limits * factor for factor in (1, 2, 3)])
    bank = CandidateBank(GradientThresholds(limits), times, np.tile(np.arange(2, dtype=np.int32), (8, 1)), 2)
    assert bank.rank(np.arange(4), Objective()).tolist() == [1, 2, 0]
    assert bank.rank(np.arange(4, 8), Objective()).tolist() == [0, 1, 2]
    np.testing.assert_array_equal(bank.chooser(Objective(), 2)(np.arange(4), 0).limits, limits[1:])


def test_thresholds_of_several_folds_are_encoded_once(monkeypatch):
    data, encoded = recordings(), []
    monkeypatch.setattr(nested, "encode_batch", lambda *given: encoded.append(given[1]) or encode_batch(*given))
    items = labelled_intervals(data, TaskSpec())
    two = fixed(np.stack([preset().limits, 2 * preset().limits]))
    learner = calibrated_svm(data, items, CONFIG, two, QUICK, FeatureSpec(("histogram",), ("llb",)))
    for held in ("t0", "t1"):
        learner(np.flatnonzero(items.trial != held), np.flatnonzero(items.trial == held), 0)
    assert len(encoded) == 2


def test_any_features_and_scaling_inside_the_folds():
    """Ranks and balanced families: the same answers as the SVM on the features themselves."""
    data = recordings()
    items = labelled_intervals(data, TaskSpec())
    train = np.flatnonzero(np.isin(items.trial, ["t0", "t1", "t2", "t4", "t6", "t7"]))
    test = np.setdiff1d(np.arange(len(items.y)), train)
    spec = FeatureSpec(families=("histogram", "spread", "levels"), balance=True)
    grid = replace(QUICK, scalings=(True,), ranks=True)
    said, chosen = calibrated_svm(data, items, CONFIG, fixed(preset()), grid, spec)(train, test, 0)
    tracks = encode_batch(CONFIG, preset(), data.wrench, data.length)
    made = extract_features(tracks, items, spec)
    assert made.weights(spec) is not None
    learner = nested_svm({"0": made.values}, items.y, items.trial, grid, {"0": made.weights(spec)})
    expected, same = learner(train, test, 0)
    np.testing.assert_array_equal(said, expected)
    assert chosen == {**same, "limits": np.asarray(preset().limits).tolist()}
    assert chosen["ranks"]
