"""Groups of trials, such as operators, that no fold may divide."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from sklearn import config_context
from sklearn.calibration import CalibratedClassifierCV
from sklearn.ensemble import BaggingClassifier, RandomForestClassifier, VotingClassifier
from sklearn.model_selection import GridSearchCV, GroupKFold, GroupShuffleSplit
from sklearn.pipeline import make_pipeline

from rcbht_jax import StateClassifier, SvmClassifier, encode
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec, Intervals
from rcbht_jax.learning import fitting
from rcbht_jax.learning.evaluation import EvaluationProtocol, evaluate, score
from rcbht_jax.learning.fitting import train
from rcbht_jax.learning.metrics import wilson
from rcbht_jax.learning.svm import Grid, grouped_folds, select
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec
from rcbht_jax.learning.validation import CrossValidation, cross_validate, majority, repeated_folds
from rcbht_jax.types import Recordings

QUICK = Grid(kernels=("linear",), costs=(0.1, 1.0), scalings=(False,), inner=2)


def test_no_fold_divides_what_the_group_names():
    made = Recordings.example()
    operator = np.tile(["ana", "bo"], 4)
    pushed = made.outcome == "success"
    made = replace(  # what is a success of ana's is a failure of bo's
        made,
        outcome=np.where(pushed == (operator == "ana"), "success", "failure"),
        columns={"operator": operator},
    )
    tracks = encode(made.wrench, rate=200)

    def scored(**how: Any) -> Any:
        protocol = EvaluationProtocol(repeats=1, grid=QUICK, **how)
        return evaluate(made, tracks, TaskSpec("outcome"), FeatureSpec(("histogram",)), protocol)

    found = scored(folds=2, group="operator")
    assert found.fold_accuracy == [[0.0, 0.0]]
    assert (found.trials, found.tested, found.protocol["group"]) == (8, 2, "operator")
    assert scored(group="operator").protocol["folds"] == 2  # of four trials of each class
    with pytest.raises(InputError, match="has 2 operators, so choose 2 folds"):
        scored(folds=3, group="operator")
    with pytest.raises(InputError, match="no column 'day'; there are"):
        scored(group="day")
    with pytest.raises(InputError, match="grouped by operator, but sessions"):
        scored(group="operator", train_on=("A",), test_on=("B",))


def test_parameters_are_chosen_without_dividing_a_group():
    """Who the operator is tells nothing about others, though it tells everything about further trials of the same."""
    rng = np.random.default_rng(0)
    operator = np.repeat(np.arange(16), 4)
    y = rng.permutation(np.repeat([0, 1], 8))[operator]
    items = LabelledIntervals(
        ("a", "b"), y, np.arange(64).astype(str), np.full(64, "A"),
        (Intervals(np.arange(64), np.zeros(64, int), np.full(64, 10), 0.005),), {},
    )  # fmt: skip
    who = rng.normal(size=(16, 4))[operator] + 0.02 * rng.normal(size=(64, 4))
    matrices = {"who": who, "signal": 3 * y[:, None] + rng.normal(size=(64, 1))}
    grid = Grid(("rbf",), (10.0,), (True,), inner=4)
    protocol = EvaluationProtocol(folds=4, repeats=1, grid=grid, group="operator")
    found = score(items, matrices, protocol, {}, {}, groups=operator)
    assert {line.split()[0] for line in found.chosen} == {"signal"}
    by_trial = score(items, matrices, replace(protocol, group="trial"), {}, {})
    assert {line.split()[0] for line in by_trial.chosen} == {"who"}


@pytest.mark.parametrize(
    ("operator", "groups"), [(["ana", "bo"] * 4, {"ana", "bo"}), (["ana"] * 8, {f"{n}" for n in range(8)})]
)
def test_the_final_classifier_is_chosen_without_dividing_a_group_either(monkeypatch, operator, groups):
    """Where a single operator is known, by trial."""
    kept: list[Any] = []

    def spy(x: Any, y: Any, apart: Any, *more: Any) -> Any:
        kept.append(apart)
        return select(x, y, apart, *more)

    monkeypatch.setattr(fitting, "select", spy)
    example = Recordings.example()
    made = replace(example, trial=np.arange(8).astype(str), columns={"operator": np.array(operator)})
    tracks = encode(made.wrench, rate=200)
    model = train(made, tracks, TaskSpec("outcome"), FeatureSpec(("histogram",)), QUICK, group="operator")
    assert (set(kept[0].tolist()), model.extra["group"]) == (groups, "operator")
    with pytest.raises(InputError, match="no column 'day'; there are"):
        train(made, tracks, TaskSpec("outcome"), FeatureSpec(("histogram",)), QUICK, group="day")


def test_no_session_may_teach_the_trial_that_another_tests():
    """Items of other origins than a store, in which a trial has one session."""
    rows = np.arange(8)
    items = LabelledIntervals(
        ("a", "b"), rows % 2, np.array(["both", *"abc", "both", *"def"]), np.repeat(["A", "B"], 4),
        (Intervals(rows, np.zeros_like(rows), rows + 10, 0.005),), {},
    )  # fmt: skip
    protocol = EvaluationProtocol(grid=QUICK, train_on=("A",), test_on=("B",))
    with pytest.raises(InputError, match="the trial both is on both sides"):
        score(items, {"": np.ones((8, 2))}, protocol, {}, {})


def test_repetitions_of_the_same_folds_are_counted_once():
    """Two operators can be divided in one way only, so ten repetitions measure the same as one."""
    y, operator = np.tile([0, 1], 20), np.repeat([0, 1], 20)
    guess = np.where(np.arange(40) % 10 < 4 + 2 * operator, y, 1 - y)  # 40 % of ana's, 60 % of bo's are right

    def interval(repeats: int) -> dict[str, float]:
        folds = repeated_folds(y, operator, 2, repeats, 0)
        return cross_validate(lambda train, test, seed: (guess[test], {}), y, folds).summary(2)["accuracy"]

    once, often = interval(1), interval(10)
    assert (once["low"], once["high"]) == (0, 1)
    assert often == pytest.approx(once)


@pytest.mark.parametrize(("value", "repeats", "folds"), [(0.9, 3, 5), (0.7, 10, 5), (2 / 3, 10, 5)])
def test_folds_that_score_the_same_have_wilsons_interval(value, repeats, folds):
    """Rounding may leave 1e-16 between the ends, which is no width."""
    same = np.full((repeats, folds), value)
    run = CrossValidation(
        same, same, [], np.zeros((2, 2), int), 0.25, np.arange(same.size).reshape(same.shape), np.array([10, 10])
    )
    found = run.summary(20)["accuracy"]
    assert (found["low"], found["high"]) == pytest.approx(wilson(20 * value, 20))


def test_stratified_folds_do_not_narrow_the_interval_of_a_rare_class():
    """Every fold holds one of three failures, so that the most frequent class scores nearly the same in each."""
    y = np.array([0] * 3 + [1] * 50)
    run = cross_validate(majority(y), y, repeated_folds(y, np.arange(53), 3, 2, 0))
    found = run.summary(53)["accuracy"]
    assert (found["low"], found["high"]) == pytest.approx(wilson(53 * found["mean"], 53))
    assert run.summary()["accuracy"]["high"] - run.summary()["accuracy"]["low"] < 0.02
    near = np.array([[0.5, 0.49, 0.5], [0.5, 0.5, 0.5]])  # mean recall: of the three failures, hardly anything is known
    recall = replace(run, balanced_accuracy=near, split=np.arange(6).reshape(2, 3)).summary(53)["balanced_accuracy"]
    assert recall["high"] - recall["low"] > 0.4


def test_mean_recall_without_a_mistake_knows_little_of_a_rare_class():
    """Of two failures that are found among 100 trials: about as much as of four trials of each class."""
    y = np.repeat([0, 1], [98, 2])
    run = cross_validate(lambda train, test, seed: (y[test], {}), y, repeated_folds(y, np.arange(100), 2, 10, 0))
    found = run.summary(100)
    items = 4 / (1 / 98 + 1 / 2)
    assert found["balanced_accuracy"]["low"] == pytest.approx(wilson(items, items)[0])
    assert found["accuracy"]["low"] == pytest.approx(wilson(100, 100)[0])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.lists(st.integers(0, 8), min_size=3, max_size=3), min_size=3, max_size=6), st.integers(0, 9))
def test_every_fold_trains_all_classes_if_any_division_of_the_groups_does(counts, seed):
    """All trials of a class came into one fold where that made the folds of more equal size; then nothing was left."""
    items = np.array(counts)  # [group, class]
    assume(((items > 0).sum(0) > 1).all())
    y, groups = (np.repeat(part.ravel(), items.ravel()) for part in np.indices(items.shape)[::-1])
    trained = all(len(np.unique(y[train])) == 3 for train, _ in grouped_folds(y, groups, 2, seed))
    divisions = np.array(list(itertools.product([False, True], repeat=len(items))))  # [division, group]
    both = [(items[side] > 0).any(0).all() and (items[~side] > 0).any(0).all() for side in divisions]
    assert trained == any(both)


def test_classes_of_few_trials_are_learned():
    """Two of five trials have contacts, most of them one: "rcbht train" ended with an error of scikit-learn."""
    items = np.array([[3, 1], [3, 0], [3, 7], [3, 0], [1, 0]])
    y, groups = (np.repeat(part.ravel(), items.ravel()) for part in np.indices(items.shape)[::-1])
    x = y[:, None] + np.random.default_rng(0).normal(0, 0.1, (len(y), 1))
    assert select({"": x}, y, groups, replace(QUICK, inner=5), 0).kernel == "linear"
    machine = SvmClassifier(probability=True, random_state=0).fit(x, y, groups=groups)
    assert (machine.predict(x) == y).all()


def test_a_class_that_a_fold_cannot_learn_is_named():
    y = np.array([0, 1, 0, 1, 1, 2, 2, 0])
    operator = np.array([0, 0, 0, 1, 1, 1, 2, 2])  # two of three hold all of a class, however they are divided
    part = np.array(["a", "b", "c"])[y]
    made = Recordings.from_arrays(np.random.default_rng(0).normal(size=(8, 400, 6)), part=part, operator=operator)
    protocol = EvaluationProtocol(folds=2, repeats=1, seed=169, grid=Grid(("linear",), (1.0,), (True,)))
    task, spec, labels = TaskSpec("part"), FeatureSpec(("histogram",)), encode(made.wrench, rate=200)
    found = evaluate(made, labels, task, spec, replace(protocol, group="operator"))
    (split,) = [(train, test) for train, test in grouped_folds(y, operator, 2, 169) if len(np.unique(y[train])) < 3]
    assert found.untrained == tuple("abc"[k] for k in np.setdiff1d(y[split[1]], y[split[0]]))
    assert evaluate(made, labels, task, spec, protocol).untrained == ()
    machine = SvmClassifier(probability=True, cv=2, random_state=169)
    with pytest.raises(InputError, match="A fold holds every group of"):
        machine.fit(np.random.default_rng(0).normal(size=(8, 2)), part, groups=operator)


def test_only_tested_groups_are_counted():
    made = Recordings.example()
    splitter = GroupShuffleSplit(2, test_size=0.25, random_state=1)
    found = evaluate(
        made, encode(made.wrench, rate=200), TaskSpec("outcome"), FeatureSpec(("histogram",)),
        EvaluationProtocol(grid=QUICK), splitter=splitter,
    )  # fmt: skip
    tests = {trial for _, test in splitter.split(made.trial, groups=made.trial) for trial in test.tolist()}
    assert found.tested == len(tests) < 8
    assert found.score["accuracy"]["low"] == pytest.approx(wilson(len(tests), len(tests))[0])
    with pytest.raises(InputError, match="a splitter"):
        evaluate(
            made, encode(made.wrench, rate=200), TaskSpec("outcome"), FeatureSpec(("histogram",)),
            EvaluationProtocol(train_on=("1",), test_on=("2",)), splitter=splitter,
        )  # fmt: skip


@pytest.mark.parametrize(
    "classifier",
    [
        None,
        RandomForestClassifier(3, random_state=0),
        GridSearchCV(SvmClassifier(kernel="linear"), {"cost": [1, 2]}, cv=GroupKFold(2)),
        GridSearchCV(make_pipeline(SvmClassifier()), {"svmclassifier__cost": [1, 2]}, cv=GroupKFold(2)),
        make_pipeline(SvmClassifier()),
        VotingClassifier([("svm", SvmClassifier())]),
        BaggingClassifier(SvmClassifier(), 2, random_state=0),
        CalibratedClassifierCV(SvmClassifier(), cv=2),
    ],
)
def test_groups_go_to_classifiers_that_take_them(classifier):
    made = Recordings.example()
    groups = np.tile([0, 1], 4)
    found = StateClassifier(classifier=classifier).fit(made.wrench, made.outcome, groups=groups)
    assert found.predict(made.wrench).tolist() == made.outcome.tolist()


def test_a_pipeline_takes_weights_and_groups_by_metadata_routing_only():
    made, weight = Recordings.example(), np.ones(8)
    given = {"groups": np.arange(8), "sample_weight": weight}
    svm = SvmClassifier(probability=True)
    for classifier in (make_pipeline(svm), GridSearchCV(make_pipeline(svm), {"svmclassifier__cost": [1, 2]}, cv=2)):
        with pytest.raises(InputError, match=r"takes no sample_weight; .* set_fit_request\(sample_weight=True\)"):
            StateClassifier(classifier=classifier).fit(made.wrench, made.outcome, sample_weight=weight)
    voting = StateClassifier(classifier=VotingClassifier([("svm", svm)]))
    assert voting.fit(made.wrench, made.outcome, **given).score(made.wrench, made.outcome) == 1
    with config_context(enable_metadata_routing=True):
        asked = make_pipeline(SvmClassifier(probability=True).set_fit_request(sample_weight=True, groups=True))
        together = {**given, "groups": np.zeros(8)}
        with pytest.raises(InputError, match="has 1 trial"):
            StateClassifier(classifier=asked).fit(made.wrench, made.outcome, **together)
        assert StateClassifier(classifier=asked).fit(made.wrench, made.outcome, **given).predict(made.wrench).size == 8
        with pytest.raises(InputError, match="Pipeline takes no sample_weight"):
            StateClassifier(classifier=make_pipeline(svm)).fit(made.wrench, made.outcome, **given)


def test_two_seeds_share_no_repetition() -> None:
    y, trial = np.arange(160) % 4, np.arange(160) // 4
    made = {seed: repeated_folds(y, trial, 5, 10, seed) for seed in range(3)}
    tests = {seed: [{test.tobytes() for _, test in folds} for folds in runs] for seed, runs in made.items()}
    assert tests[0] == [{test.tobytes() for _, test in grouped_folds(y, trial, 5, repeat)} for repeat in range(10)]
    for one, other in itertools.combinations(made, 2):
        assert not any(a & b for a in tests[one] for b in tests[other])
    with pytest.raises(InputError, match="There are 1001 repeats; expected at most 1000"):
        repeated_folds(y, trial, 5, 1001, 0)
