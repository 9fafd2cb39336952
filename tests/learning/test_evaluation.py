"""Tasks and protocols on a small made-up data set whose answers can be counted by hand."""

from __future__ import annotations

import json
from dataclasses import replace

import jax
import numpy as np
import pytest
from sklearn.model_selection import GroupShuffleSplit, KFold, LeaveOneGroupOut

from rcbht_jax._util.digest import data_hash
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning import model_io
from rcbht_jax.learning.evaluation import EvaluationProtocol, evaluate, score
from rcbht_jax.learning.fitting import train
from rcbht_jax.learning.metrics import wilson
from rcbht_jax.learning.predict import classify
from rcbht_jax.learning.svm import Grid, grouped_folds
from rcbht_jax.learning.tasks import TaskSpec, extract_features, labelled_intervals
from rcbht_jax.learning.validation import cross_validate, forest, majority, nested_svm, repeated_folds
from rcbht_jax.robots.snap_assembly import FAILURE_TYPES, RECORDED, snap_recordings
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings
from tests.support.snaps import marked, with_columns

QUICK = Grid(kernels=("linear",), costs=(0.1, 1.0), scalings=(False,), inner=2)
TRIALS = 12  # per session, two sessions, the last two of each fail; right arm only but for the first four
STATE_CODE = (1, 2, 3, 4)


def make_recordings() -> Recordings:
    """States of 10, 2, 8 and 20 samples; 40 samples at 0.1 s."""
    rows = [(s, t, "R") for s in "AB" for t in range(TRIALS)] + [("A", t, "L") for t in range(4)]
    n = len(rows)
    onset = np.tile([0.0, 1.0, 1.2, 2.0], (n, 1))
    harmonised = np.tile([0.0, 1.0, 1.5, 2.0], (n, 1))
    onset[3, 3] = harmonised[3, 3] = np.nan  # A3 R lacks the mating state
    failed = np.array([t >= TRIALS - 2 for _, t, _ in rows])
    types = np.where(failed, np.where([t % 2 == 0 for _, t, _ in rows], "+x", "-y"), "")
    note = np.full(n, "", dtype="<U40")
    note[TRIALS - 1] = "harmonised;contradictory-duplicate:B3"
    return snap_recordings(
        wrench=np.zeros((n, 40, 6), np.float32),
        length=np.full(n, 40, np.int32),
        dt=0.1,
        onset=onset,
        onset_harmonised=harmonised,
        trial=np.array([f"{s}{t}" for s, t, _ in rows]),
        arm=np.array([a for _, _, a in rows]),
        source=np.array([f"SET_{s}" for s, _, _ in rows]),
        session=np.array([s for s, _, _ in rows]),
        outcome=np.where(failed, "failure", "success"),
        failure_type=types,
        deviation=np.full((n, 3), np.nan),
        note=note,
    )


def make_tracks(recordings: Recordings, seed: int = 0, wrong: float = 0.0) -> LabelTracks:
    """Every state says its own code on every axis and layer; a share of spans says something else."""
    rng = np.random.default_rng(seed)
    n = len(recordings)
    edges = np.array([0, 10, 15, 20, 40], np.int32)
    label = np.tile(np.array(STATE_CODE, np.int8), (n, 6, 1))
    label = np.where(rng.random(label.shape) < wrong, rng.integers(1, 9, label.shape), label).astype(np.int8)
    t0, t1 = (np.broadcast_to(e, label.shape).astype(np.int32) for e in (edges[:-1], edges[1:]))
    value = rng.normal(size=label.shape)
    zero = np.zeros(label.shape)
    track = LabelTrack(label=label, t0=t0, t1=t1, emit=t1, vmax=value, vmin=value - 1, avg=value, grad=zero)
    return LabelTracks(track, track, track)


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return make_recordings()


def test_states_cover_the_record_and_incomplete_trials_are_counted(recordings):
    items = labelled_intervals(recordings, TaskSpec(boundaries="recorded", complete=True))
    assert items.classes == ("approach", "rotation", "insertion", "mating")
    assert items.dropped == {"outcome not success": 4, "a state is missing": 1}
    good = 2 * (TRIALS - 2) - 1
    assert len(items.y) == 4 * good
    (only,) = items.intervals
    first = only.recording == 0
    assert only.start[first].tolist() == [0, 10, 12, 20]
    assert only.end[first].tolist() == [10, 12, 20, 40]
    assert items.y[first].tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(items.seconds[first, 0], [1.0, 0.2, 0.8, 2.0])
    assert not {"A3", "A10", "B11"} & set(items.trial.tolist())


def test_two_sources_may_use_the_same_names(recordings):
    alone, states = recordings.take(np.flatnonzero(recordings.arm == "R")), TaskSpec(sessions=("A", "B"))
    names = labelled_intervals(alone, states).trial
    same = replace(alone, trial=np.char.lstrip(alone.trial, "AB"))
    found = labelled_intervals(same, states)
    assert len(np.unique(found.trial)) == len(np.unique(names)) > TRIALS
    assert found.trial[0] == "SET_A/0"
    protocol = EvaluationProtocol(grid=QUICK, train_on=("A",), test_on=("B",))
    made = evaluate(same, make_tracks(same), states, FeatureSpec(("histogram",)), protocol)
    assert made.tested == len({name for name in names.tolist() if name.startswith("B")})


def test_boundaries_can_be_harmonised_or_merged(recordings):
    harmonised = labelled_intervals(recordings, TaskSpec(boundaries="harmonised")).intervals[0]
    assert harmonised.end[:4].tolist() == [10, 15, 20, 40]
    merged = labelled_intervals(recordings, TaskSpec(boundaries="merged"))
    assert merged.classes == ("approach", "rotation+insertion", "mating")
    assert merged.intervals[0].start[:3].tolist() == [0, 10, 20]
    assert merged.y[:3].tolist() == [0, 1, 2]


def test_boundaries_that_no_track_has_are_refused(recordings):
    with pytest.raises(InputError, match="no boundaries 'nope' of states; expected recorded, harmonised, merged"):
        labelled_intervals(recordings, TaskSpec(boundaries="nope"))


def test_merging_needs_no_rotation_mark(recordings):
    onset = recordings.starts(RECORDED).copy()
    onset[:, 2] = np.nan
    without = marked(recordings, onset)
    assert len(labelled_intervals(without, TaskSpec(boundaries="merged")).y) > 0
    with pytest.raises(InputError, match="there is no known class in"):
        labelled_intervals(without, TaskSpec(boundaries="recorded", complete=True))


@pytest.mark.parametrize("bad", [5.0, 1.0, 0.95])
def test_marks_beyond_the_record_or_out_of_order_drop_the_trial(recordings, bad):
    onset = recordings.starts(RECORDED).copy()
    onset[0, 2] = bad
    items = labelled_intervals(marked(recordings, onset), TaskSpec(boundaries="recorded", complete=True))
    assert items.dropped["a state is missing"] == 2
    assert "A0" not in items.trial


def test_a_trial_that_lacks_a_mark_keeps_its_other_intervals(recordings):
    items = labelled_intervals(recordings, TaskSpec(boundaries="recorded"))
    (only,) = items.intervals
    of = only.recording == 3  # A3 has no mating: it ended while inserting
    assert [items.classes[y] for y in items.y[of]] == ["approach", "rotation", "insertion"]
    assert only.end[of].tolist() == [10, 12, 40]
    onset = recordings.starts(RECORDED)
    onset[0, 1] = np.nan  # approach may have ended anywhere before the insertion
    items = labelled_intervals(marked(recordings, onset), TaskSpec(boundaries="recorded"))
    of = items.intervals[0].recording == 0
    assert [items.classes[y] for y in items.y[of]] == ["insertion", "mating"]
    why = "intervals, empty, outside the record or without a known end"
    assert items.dropped == {"outcome not success": 4, why: 1}


def test_two_arms_are_paired_by_trial(recordings):
    items = labelled_intervals(recordings, TaskSpec(arms="both", sources=("SET_A",), complete=True))
    assert sorted(set(items.trial.tolist())) == ["A0", "A1", "A2"]  # A3 lacks a state of its right arm
    assert items.dropped == {"outcome not success": 2, "no arm R and L": 6, "a state is missing": 1}
    right, left = items.intervals
    assert set(recordings.arm[right.recording]) == {"R"}
    assert set(recordings.arm[left.recording]) == {"L"}
    np.testing.assert_array_equal(recordings.trial[right.recording], recordings.trial[left.recording])
    tracks = make_tracks(recordings, wrong=0.5)
    made = extract_features(tracks, items, FeatureSpec(families=("histogram",)))
    alone = extract_features(
        tracks,
        labelled_intervals(recordings, TaskSpec(arms="L", sources=("SET_A",), complete=True)),
        FeatureSpec(("histogram",)),
    )
    np.testing.assert_array_equal(made.values[:, made.values.shape[1] // 2 :], alone.values[: len(items.y)])
    assert made.names[0].startswith("R.histogram")


def test_outcome_and_failure_type_use_whole_records(recordings):
    items = labelled_intervals(recordings, TaskSpec("outcome"))
    assert items.classes == ("failure", "success")
    assert np.bincount(items.y).tolist() == [4, 20]
    assert set(items.intervals[0].start.tolist()) == {0}
    assert set(items.intervals[0].end.tolist()) == {40}
    items = labelled_intervals(recordings, TaskSpec("failure-type"))
    assert items.classes == ("+x", "-y")
    assert np.bincount(items.y).tolist() == [2, 1]
    assert items.dropped == {"same record under two names": 1}


def test_rare_failure_types_are_left_out(recordings):
    types = recordings.column("failure_type").astype("<U8")
    types[20] = "+x-y"  # a listed type, on a success: the outcome filter hides it
    types[TRIALS - 2] = "-r"
    listed = TaskSpec("failure-type", outcomes=("failure",), classes=FAILURE_TYPES)
    types[2 * TRIALS - 1] = "-y"
    items = labelled_intervals(with_columns(recordings, failure_type=types), listed)
    assert items.classes == ("+x", "-y", "-r")
    types[TRIALS - 2] = "+x+y-r"
    items = labelled_intervals(with_columns(recordings, failure_type=types), listed)
    assert items.classes == ("+x", "-y")
    assert items.dropped["class not in the list"] == 1
    assert len(FAILURE_TYPES) == 13


def test_evaluation_finds_what_the_labels_say(recordings):
    made = evaluate(
        recordings,
        make_tracks(recordings),
        TaskSpec(complete=True),
        FeatureSpec(("histogram",)),
        EvaluationProtocol(folds=3, repeats=2, grid=QUICK),
        {"window": 5},
    )
    assert made.score["accuracy"]["mean"] == 1
    assert made.majority_baseline["accuracy"] == {"mean": 0.25}  # which no other trials would change
    assert made.trials == 19
    assert np.array(made.confusion).tolist() == (np.eye(4, dtype=int) * 38).tolist()
    assert sum(made.chosen.values()) == 6
    assert made.provenance["labels"] == {"window": 5}
    assert made.confounds.startswith("The classes differ in length: the nearest median duration alone")
    assert made.confounds.endswith("Exact copies of another recording: 18; keep copies on one side of every split.")
    back = json.loads(json.dumps(made.to_json(), allow_nan=False))
    assert back["score"] == made.score
    assert back["protocol"]["seed"] == 0


def test_the_duration_baseline_sees_durations_only(recordings):
    # Labels are noise, and all durations are equal per state: the baseline is perfect, the labels are not.
    task, protocol = TaskSpec(boundaries="recorded", complete=True), EvaluationProtocol(folds=3, repeats=1, grid=QUICK)
    noise = make_tracks(recordings, wrong=1.0)
    made = evaluate(recordings, noise, task, FeatureSpec(("histogram",)), protocol)
    assert made.duration_baseline["accuracy"]["mean"] == 1
    assert made.score["accuracy"]["mean"] < 0.7


def test_the_same_seed_gives_the_same_result_and_folds_are_shared(recordings):
    tracks, spec = make_tracks(recordings, wrong=0.7), FeatureSpec(("histogram",))
    results = [
        evaluate(recordings, tracks, TaskSpec(), spec, EvaluationProtocol(folds=3, repeats=2, seed=s, grid=QUICK))
        for s in (0, 0, 1)
    ]
    assert results[0] == results[1]
    assert results[0].fold_accuracy != results[2].fold_accuracy


def test_the_best_feature_specification_is_chosen_inside_the_folds(recordings):
    tracks = make_tracks(recordings)
    specs = {"levels": FeatureSpec(("offset",)), "words": FeatureSpec(("histogram",))}
    made = evaluate(
        recordings, tracks, TaskSpec(complete=True), specs, EvaluationProtocol(folds=3, repeats=1, grid=QUICK)
    )
    assert all(line.startswith("words linear") for line in made.chosen)


@pytest.mark.filterwarnings("ignore:The groups parameter is ignored")
def test_a_splitter_replaces_the_folds_and_must_keep_trials_together(recordings):
    tracks, task, spec = make_tracks(recordings), TaskSpec(complete=True), FeatureSpec(("histogram",))
    made = evaluate(recordings, tracks, task, spec, EvaluationProtocol(grid=QUICK), splitter=LeaveOneGroupOut())
    assert np.shape(made.fold_accuracy) == (1, 19)
    assert [made.protocol[name] for name in ("folds", "repeats", "splitter")] == [None, None, "LeaveOneGroupOut()"]
    with pytest.raises(InputError, match="both sides"):
        evaluate(recordings, tracks, task, spec, EvaluationProtocol(grid=QUICK), splitter=KFold(3, shuffle=True))
    shuffle = GroupShuffleSplit(4, test_size=0.5, random_state=0)
    y, groups = np.arange(40) % 2, np.arange(40)
    score = cross_validate(majority(y), y, [grouped_folds(y, groups, shuffle, 0)])
    assert score.test_to_train == 1


def test_sessions_can_be_held_out(recordings):
    tracks = make_tracks(recordings)
    # Session B uses other words for the same states, so what A teaches is wrong there.
    label = tracks.mc.label.copy()
    label[recordings.session == "B"] = label[recordings.session == "B"] % 4 + 1
    odd = replace(tracks.mc, label=label)
    swapped = LabelTracks(odd, odd, odd)
    protocol = EvaluationProtocol(grid=QUICK, train_on=("A",), test_on=("B",))
    same = evaluate(recordings, tracks, TaskSpec(), FeatureSpec(("histogram",)), protocol)
    other = evaluate(recordings, swapped, TaskSpec(), FeatureSpec(("histogram",)), protocol)
    low = wilson(10, 10)[0]  # ten trials without a mistake
    assert same.tested == 10
    assert same.score["accuracy"] == {"mean": 1.0, "low": low, "high": 1.0}
    assert other.score["accuracy"]["mean"] == 0
    assert np.sum(same.confusion) == 40  # the ten successes of B
    assert (same.trials, same.untrained) == (20, ())
    third = replace(recordings, session=np.where(recordings.trial == "A0", "C", recordings.session))
    tool = with_columns(third, tool=np.where(third.session == "C", "clip", np.where(np.arange(28) % 2, "peg", "hole")))
    protocol = EvaluationProtocol(grid=QUICK, train_on=("A",), test_on=("C",))
    new = evaluate(tool, tracks, TaskSpec("tool"), FeatureSpec(("histogram",)), protocol)
    assert (new.untrained, new.tested) == (("clip",), 1)
    assert new.trials == sum(new.items.values()) == 11  # one has two names; none of session B
    json.dumps(same.to_json(), allow_nan=False)


def test_bad_protocols_and_filters_are_refused(recordings):
    tracks, spec = make_tracks(recordings), FeatureSpec(("histogram",))
    with pytest.raises(InputError, match="belong together"):
        EvaluationProtocol(train_on=("A",))
    with pytest.raises(InputError, match="one only"):
        EvaluationProtocol(train_on=("A", "B"), test_on=("B",))
    with pytest.raises(InputError, match="repeats"):
        EvaluationProtocol(repeats=0)
    with pytest.raises(InputError, match="session Z has no interval"):
        evaluate(recordings, tracks, TaskSpec(), spec, EvaluationProtocol(train_on=("A",), test_on=("Z",)))
    with pytest.raises(InputError, match="rarest class has 1 trial;"):
        evaluate(recordings, tracks, TaskSpec("failure-type"), spec, EvaluationProtocol())
    with pytest.raises(InputError, match="source"):
        labelled_intervals(recordings, TaskSpec(sources=("SET_Z",)))
    with pytest.raises(InputError, match="no track or column of text 'weather'"):
        labelled_intervals(recordings, TaskSpec("weather"))
    only_one = EvaluationProtocol(train_on=("A",), test_on=("B",))
    alike = replace(recordings, outcome=np.where(recordings.session == "A", "success", recordings.outcome))
    with pytest.raises(InputError, match="only one class"):
        evaluate(alike, tracks, TaskSpec("outcome"), spec, only_one)


def test_labels_of_other_recordings_are_refused(recordings):
    """Their rows would be those of other trials."""
    tracks, task, spec = make_tracks(recordings), TaskSpec("outcome"), FeatureSpec(("histogram",))
    model = train(recordings, tracks, task, spec, Grid(("linear",), (1.0,), inner=2))
    rows = np.arange(len(recordings))
    for fewer, labels in ((rows[1:], tracks), (rows, tracks.take(rows[1:]))):
        some = recordings.take(fewer)
        with pytest.raises(InputError, match="The labels are of"):
            evaluate(some, labels, task, spec, EvaluationProtocol(folds=2, repeats=1))
        with pytest.raises(InputError, match="The labels are of"):
            train(some, labels, task, spec)
        with pytest.raises(InputError, match="The labels are of"):
            classify(model, some, {"": labels}, task)
    for fewer, labels in ((rows, tracks.take(rows[:3])), (rows[:-2], tracks)):
        with pytest.raises(InputError, match=f"{len(labels.llb.label)} recordings, the intervals of {len(fewer)}"):
            extract_features(labels, labelled_intervals(recordings.take(fewer), task), spec)
    single = jax.tree.map(lambda leaf: leaf[0], tracks)
    with pytest.raises(InputError, match=r"expected \[recording, axis, slot\]"):
        extract_features(single, labelled_intervals(recordings, task), spec)


def test_a_trained_model_is_saved_and_says_the_same(recordings, tmp_path):
    tracks, spec = make_tracks(recordings, wrong=0.3), FeatureSpec(("histogram", "ngram"))
    model = train(recordings, tracks, TaskSpec(), spec, QUICK, {"window": 5})
    model_io.save(tmp_path / "m", model)
    back = model_io.load(tmp_path / "m")
    items = labelled_intervals(recordings, TaskSpec())
    made = extract_features(tracks, items, back.feature_spec)
    assert made.names == back.feature_names
    said = back.svm.predict(made.values)
    np.testing.assert_array_equal(said, model.svm.predict(made.values))
    assert np.mean(said == np.array(items.classes)[items.y]) > 0.9
    assert back.encoder == {"window": 5}
    assert back.data_hash == data_hash(recordings)


def test_the_data_hash_notices_a_single_sample_or_name(recordings):
    whole = data_hash(recordings)
    wrench = recordings.wrench.copy()
    wrench[3, 2, 1] = 1e-6
    assert data_hash(replace(recordings, wrench=wrench)) != whole
    assert data_hash(replace(recordings, session=recordings.trial)) != whole
    assert data_hash(make_recordings()) == whole


def test_any_features_can_be_scored_beside_the_baselines(recordings):
    items = labelled_intervals(recordings, TaskSpec(boundaries="recorded", complete=True))
    known = np.eye(4)[items.y]
    made = score(items, {"raw": known}, EvaluationProtocol(folds=3, repeats=1, grid=QUICK), {"task": "states"}, {})
    assert made.score["accuracy"]["mean"] == 1
    assert forest(items.seconds, items.y)(np.arange(40), np.arange(40, 44), 0)[0].tolist() == items.y[40:44].tolist()


@pytest.mark.parametrize(
    ("row", "archive", "prefix", "target"),
    [
        ("REAL states", "real_one_arm.npz", "", (0.960, 1.0)),
        ("SIM one-arm states", "sim_one_arm.npz", "", (0.831, 0.930)),
        ("SIM two-arm states", "sim_two_arm.npz", "combined_", (0.974, 1.0)),
    ],
)
def test_table_one_of_the_paper_on_the_published_features(golden_dir, row, archive, prefix, target):
    """Re-measured means of the evaluation notes: fixed (poly, C = 1) and nested, both grouped by trial."""
    with np.load(golden_dir / "published_features" / archive) as matrices:
        parts = [matrices[prefix + s] for s in ("approach", "rotation", "insertion", "mating")]
    table = np.concatenate(parts).astype(np.float64)
    x, y, trial = table[:, :-1], table[:, -1].astype(np.int64), np.tile(np.arange(len(parts[0])), 4)
    folds = repeated_folds(y, trial, 5, 4, 0)
    fixed = cross_validate(nested_svm({"": x}, y, trial, Grid(("poly",), (1.0,), (False,))), y, folds)
    nested = cross_validate(nested_svm({"": x}, y, trial, Grid(scalings=(False,))), y, folds[:1])
    for made in (fixed, nested):
        assert target[0] <= made.accuracy.mean() <= target[1], row


@pytest.mark.parametrize(("archive", "target"), [("real_one_arm.npz", (0.83, 1.0)), ("sim_one_arm.npz", (0.99, 1.0))])
def test_table_one_success_against_failure(golden_dir, archive, target):
    """Equal numbers of both classes, drawn anew in every repeat (16 + 16 real, 38 + 38 simulated)."""
    with np.load(golden_dir / "published_features" / archive) as matrices:
        parts = [matrices[name] for name in ("failure", "success")]
    fewest = min(len(part) for part in parts)
    scores = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        table = np.concatenate([p[rng.choice(len(p), fewest, replace=False)] for p in parts]).astype(np.float64)
        x, y, trial = table[:, :-1], table[:, -1].astype(np.int64), np.arange(2 * fewest)
        folds = repeated_folds(y, trial, 5, 1, seed)
        learner = nested_svm({"": x}, y, trial, Grid(("poly",), (1.0,), (False,)))
        scores.append(cross_validate(learner, y, folds).accuracy.mean())
    assert target[0] <= np.mean(scores) <= target[1]
