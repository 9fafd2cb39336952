"""The scikit-learn estimators: their conventions, and that they equal the functions below them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from sklearn import config_context
from sklearn.base import clone
from sklearn.ensemble import RandomForestClassifier
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GridSearchCV, GroupKFold, LeaveOneGroupOut, cross_val_score
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import parametrize_with_checks

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec, Intervals, interval_features
from rcbht_jax.learning.estimators import StateClassifier, WrenchFeatures
from rcbht_jax.learning.probability import fit_probabilistic
from rcbht_jax.learning.svm import SvmSpec, fit
from rcbht_jax.learning.svm_classifier import SvmClassifier


def not_applicable(estimator: SvmClassifier) -> dict[str, str]:
    check = "check_sample_weight_equivalence_on_dense_data"
    return {check: "it gives lists of rows as cv; ours takes splitters"} if estimator.probability else {}


@parametrize_with_checks([SvmClassifier(), SvmClassifier(probability=True)], expected_failed_checks=not_applicable)
def test_scikit_learn_conventions(estimator, check):
    check(estimator)


SPEC = FeatureSpec(("histogram", "attributes"), layers=("primitive", "llb"))
TRIAL = np.arange(24) // 2
STATE = np.repeat(["push", "rest"], 12)


def wrenches(seed: int = 0, samples: int = 300) -> np.ndarray:
    """Half of the recordings are pushed along every axis for half a second."""
    push = np.clip(np.arange(samples) / 200 - 0.5, 0, 0.5)[:, None] * 20
    noise = np.random.default_rng(seed).normal(size=(24, samples, 6)) * 0.02
    return noise + np.where(STATE == "push", 1, 0)[:, None, None] * push


@pytest.mark.parametrize("window", [5, 8])
def test_features_equal_those_of_the_encoder(window):
    wrench = wrenches().astype(np.float32)
    made = WrenchFeatures(window=window, thresholds="pa10", features=SPEC).fit_transform(wrench)
    length, rows = np.full(24, 300, np.int32), np.arange(24)
    tracks = encode_batch(EncoderConfig(window), preset("pa10"), wrench, length)
    expected = interval_features(tracks, Intervals(rows, 0 * rows, length, 0.005), SPEC)
    np.testing.assert_array_equal(made, expected.values)


def test_layouts_and_unequal_lengths_agree():
    parts = [wrench[: 200 + 3 * k] for k, wrench in enumerate(wrenches())]
    encoder = WrenchFeatures(features=SPEC)
    made = encoder.fit_transform(parts)
    one_by_one = np.concatenate([encoder.transform(part[None]) for part in parts[:3]])
    np.testing.assert_array_equal(made[:3], one_by_one)
    turned = clone(encoder).set_params(layout="axis-time")
    np.testing.assert_array_equal(made, turned.fit_transform([part.T for part in parts]))
    assert turned.n_features_in_ == 6
    equal = wrenches()
    np.testing.assert_array_equal(turned.transform(equal.swapaxes(1, 2)), encoder.transform(equal))


def test_names_of_axes_are_kept_and_compared():
    """A column of time is no axis, and columns in another order are other features."""
    names = ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
    plain = wrenches()
    frames = [pd.DataFrame(wrench, columns=names).assign(time=np.arange(300) / 200) for wrench in plain]
    arrays = xr.DataArray(plain.swapaxes(1, 2), dims=("trial", "axis", "time"), coords={"axis": names})
    chain = StateClassifier(features=SPEC).fit(frames, STATE)
    assert chain.n_features_in_ == 6
    assert chain.feature_names_in_.tolist() == names
    expected = StateClassifier(features=SPEC).fit(plain, STATE).decision_function(plain)
    for form in (frames, plain, arrays, list(arrays)):
        np.testing.assert_array_equal(chain.decision_function(form), expected)
    assert cross_val_score(StateClassifier(features=SPEC), arrays, STATE, groups=TRIAL, cv=GroupKFold(2)).min() > 0.8
    for form in ([frame[names[::-1]] for frame in frames], arrays.assign_coords(axis=list("abcdef"))):
        with pytest.raises(InputError, match="fit had Fx, Fy, Fz, Mx, My, Mz, in this order"):
            chain.predict(form)
    with pytest.raises(InputError, match="different axes"):
        chain.fit([frames[0], frames[1][names[::-1]]], STATE[:2])
    with pytest.raises(InputError, match="100 samples per second"):
        chain.fit([frame.assign(time=np.arange(300) / 100) for frame in frames], STATE)
    assert not hasattr(chain.fit(plain, STATE), "feature_names_in_")
    other = WrenchFeatures(features=SPEC).fit([frame.rename(columns={"Fx": "grip"}) for frame in frames])
    assert other.get_feature_names_out()[0] == "histogram.primitive.grip.time.bpos"


def test_options_of_the_encoder_are_used():
    config = EncoderConfig(window=99, dt=9.0, gate=False, adj_exempt=False)
    wrench = np.cumsum(np.random.default_rng(1).normal(size=(3, 400, 6)), axis=1)
    plain, other = (WrenchFeatures(config=c).fit_transform(wrench) for c in (None, config))
    assert not np.array_equal(plain, other)
    same = WrenchFeatures(config=EncoderConfig()).fit_transform(wrench)
    np.testing.assert_array_equal(plain, same)
    seconds = [WrenchFeatures(rate=r, features=FeatureSpec(("elapsed",))).fit_transform(wrench) for r in (100, 400)]
    np.testing.assert_allclose([s[:, 0] for s in seconds], [[4] * 3, [1] * 3])


@pytest.mark.parametrize("tolerance", ["auto", 0.3, np.linspace(0.1, 0.6, 6)])
def test_features_of_the_fit_rule_equal_those_of_the_encoder(tolerance):
    """The tolerance is of the recordings of ``fit``, whatever is transformed later."""
    taught, wrench = wrenches().astype(np.float32)[:18], 3 * wrenches(1).astype(np.float32)[:5]
    maker = WrenchFeatures(rule="fit", tolerance=tolerance, features=SPEC).fit(taught)
    found = auto_tolerance(taught, np.full(18, 300), 5) if isinstance(tolerance, str) else np.broadcast_to(tolerance, 6)
    np.testing.assert_array_equal(maker.tolerance_, found)
    length, rows = np.full(5, 300, np.int32), np.arange(5)
    tracks = encode_batch(FitConfig(), FitLimits(preset().limits, found), wrench, length)
    expected = interval_features(tracks, Intervals(rows, 0 * rows, length, 0.005), SPEC)
    np.testing.assert_array_equal(maker.transform(wrench), expected.values)
    assert not np.array_equal(WrenchFeatures(features=SPEC).fit(taught).transform(wrench), expected.values)
    assert WrenchFeatures().fit(taught).tolerance_ is None


def test_the_tolerance_is_found_by_a_grid_search_and_learned_from_the_training_folds():
    huge, spec = 1e6, FeatureSpec(("histogram",), layers=("primitive",))  # huge: a level explains everything
    chain = StateClassifier(rule="fit", features=spec, classifier=SvmClassifier(kernel="linear"))
    search = GridSearchCV(chain, {"tolerance": [huge, "auto"]}, cv=GroupKFold(3)).fit(wrenches(), STATE, groups=TRIAL)
    assert search.best_params_ == {"tolerance": "auto"}
    assert search.cv_results_["mean_test_score"][0] < 0.8 < search.best_score_
    half = clone(chain).fit(wrenches()[::2], STATE[::2])
    expected = auto_tolerance(wrenches()[::2].astype(np.float32), np.full(12, 300), 5)
    np.testing.assert_array_equal(half.features_.tolerance_, expected)
    assert clone(search.best_estimator_).get_params()["rule"] == "fit"


@pytest.mark.parametrize("form", ["name", "object", "array", "one axis"])
def test_thresholds_of_any_form(form):
    limits = np.tile([70.0, 46, 23, 1], (6, 1))
    forms = {"name": "hiro", "object": preset("hiro"), "array": limits.tolist(), "one axis": (70.0, 46, 23, 1)}
    encoder = WrenchFeatures(thresholds=forms[form]).fit(wrenches())
    expected = preset("hiro").limits if form in ("name", "object") else limits
    np.testing.assert_array_equal(encoder.thresholds_, expected)
    assert clone(encoder).get_params().keys() == encoder.get_params().keys()


@pytest.mark.parametrize(
    ("parameters", "wrench", "why"),
    [
        ({}, np.zeros((5, 6)), "pass a single recording"),
        ({}, [np.zeros((5, 6)), np.zeros((5, 3))], "same axes"),
        ({}, [np.zeros((0, 6))], "need samples"),
        ({}, [], "no recording"),
        ({"layout": "aeon"}, np.zeros((1, 9, 6)), "layout is 'aeon'"),
        ({"thresholds": "c3po"}, np.zeros((1, 9, 6)), "no thresholds"),
        ({"thresholds": np.ones((3, 4))}, np.zeros((1, 9, 6)), r"expected \[6, 4\]"),
        ({"thresholds": (1, 2, 3, 4)}, np.zeros((1, 9, 6)), "ordered"),
        ({"rate": 0}, np.zeros((1, 9, 6)), "rate"),
        ({"rule": "fit"}, np.full((1, 9, 6), np.nan), "not finite"),
        ({"features": ("histogram",)}, np.zeros((1, 9, 6)), "expected a FeatureSpec"),
        ({"window": 1}, np.zeros((1, 9, 6)), "window"),
        ({"rule": "best"}, np.zeros((1, 9, 6)), "no rule 'best'"),
        ({"tolerance": 1.0}, np.zeros((1, 9, 6)), "belongs to the fit rule"),
        ({"rule": "fit", "tolerance": 0.0}, np.zeros((1, 9, 6)), "positive"),
        ({"rule": "fit", "tolerance": "much"}, np.zeros((1, 9, 6)), "expected numbers"),
        ({"rule": "fit", "tolerance": np.ones(3)}, np.zeros((1, 9, 6)), "Tolerances have shape"),
        ({"rule": "fit", "config": EncoderConfig()}, np.zeros((1, 9, 6)), "takes FitConfig"),
        ({"config": FitConfig()}, np.zeros((1, 9, 6)), "takes EncoderConfig"),
    ],
)
def test_what_does_not_fit_is_refused(parameters, wrench, why):
    with pytest.raises(InputError, match=why):
        WrenchFeatures(**parameters).fit(wrench)


def test_transform_refuses_other_axes_and_missing_values():
    encoder = WrenchFeatures().fit(wrenches())
    with pytest.raises(InputError, match="fit had 6"):
        encoder.transform(np.zeros((1, 9, 2)))
    with pytest.raises(InputError, match="not finite"):
        encoder.transform(np.full((1, 9, 6), np.nan))


def test_pandas_output_names_every_column():
    table = WrenchFeatures(features=SPEC).set_output(transform="pandas").fit_transform(wrenches())
    assert table.shape == (24, len(set(table.columns)))
    assert {name.split(".")[0] for name in table.columns} == {"histogram", "attributes"}


def test_window_and_thresholds_are_found_by_a_grid_search_over_groups():
    huge = np.tile([7e6, 6e6, 5e6, 4e6], (6, 1))  # N/s: every segment is constant, so nothing can be told apart
    grid = {"thresholds": [huge, preset("hiro")], "window": [5, 10]}
    chain = StateClassifier(features=FeatureSpec(("histogram",)), classifier=SvmClassifier(kernel="linear"))
    search = GridSearchCV(chain, grid, cv=GroupKFold(3)).fit(wrenches(), STATE, groups=TRIAL)
    assert search.best_score_ == 1
    scores = search.cv_results_["mean_test_score"]
    assert max(scores[:2]) < 0.8
    assert search.best_params_["thresholds"] is not huge
    assert search.predict(wrenches(5)[[0, -1]]).tolist() == ["push", "rest"]


def test_the_chain_equals_a_pipeline_and_its_parts():
    wrench = wrenches()
    chain = StateClassifier(features=SPEC).fit(wrench, STATE)
    pipeline = make_pipeline(WrenchFeatures(features=SPEC), SvmClassifier()).fit(wrench, STATE)
    new = wrenches(1)
    np.testing.assert_array_equal(chain.decision_function(new), pipeline.decision_function(new))
    assert chain.predict(new).tolist() == pipeline.predict(new).tolist() == STATE.tolist()
    assert chain.classes_.tolist() == ["push", "rest"]
    assert cross_val_score(pipeline, wrench, STATE, groups=TRIAL, cv=GroupKFold(3)).tolist() == [1, 1, 1]
    assert not hasattr(chain, "predict_proba")
    grouped = clone(chain).set_params(classifier=SvmClassifier(probability=True)).fit(wrench, STATE, groups=TRIAL)
    assert (grouped.predict_proba(new).argmax(1) == (STATE == "rest")).all()


def test_an_ensemble_as_classifier_keeps_its_probabilities():
    chain = StateClassifier(features=SPEC, classifier=RandomForestClassifier(5, random_state=0)).fit(wrenches(), STATE)
    assert not hasattr(chain, "decision_function")
    assert (chain.predict_proba(wrenches(1)).argmax(1) == (STATE == "rest")).all()


def test_balanced_columns_reach_the_machine():
    spec = FeatureSpec(("histogram", "elapsed"), balance=True)
    chain = StateClassifier(features=spec).fit(wrenches(), STATE)
    plain = StateClassifier(features=FeatureSpec(("histogram", "elapsed"))).fit(wrenches(), STATE)
    weight = chain.features_.feature_weight_
    assert weight[-1] > weight[0]
    np.testing.assert_allclose(chain.classifier_.model_.width * weight, plain.classifier_.model_.width)


def test_balance_is_for_classifiers_that_weigh_features():
    spec = FeatureSpec(("histogram", "elapsed"), balance=True)
    for classifier in (RandomForestClassifier(3, random_state=0), GridSearchCV(SvmClassifier(), {"cost": [1.0]}, cv=2)):
        with pytest.raises(InputError, match=f"{type(classifier).__name__} takes no weights of features"):
            StateClassifier(features=spec, classifier=classifier).fit(wrenches(), STATE)


def test_a_fit_that_fails_changes_no_answer():
    wrench, x = wrenches(), blobs(2)[0][:24]
    chain, machine = StateClassifier().fit(wrench, STATE), SvmClassifier(probability=True).fit(x, STATE)
    for estimator, given in ((chain, wrench), (machine, x)):
        before = estimator.predict(given).tolist()
        for y in (np.full(24, "one"), [None] * 24):
            with pytest.raises(ValueError):
                estimator.fit(given, y)
            assert estimator.predict(given).tolist() == before
    with pytest.raises(InputError, match="two of every class"):
        machine.fit(x, np.where(np.arange(24) < 1, "rare", "usual"))
    assert machine.predict(x).tolist() == before
    for estimator, given in ((StateClassifier(), wrench), (SvmClassifier(), x), (WrenchFeatures(features="x"), wrench)):
        with pytest.raises(InputError):
            estimator.fit(given, np.full(24, "one"))
        with pytest.raises(NotFittedError):
            (estimator.transform if isinstance(estimator, WrenchFeatures) else estimator.predict)(given)


def blobs(classes: int = 3, items: int = 120) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    code = np.arange(items) % classes
    x = rng.normal(size=(classes, 5))[code] * 1.5 + rng.normal(size=(items, 5))
    return x, np.array(list("zmaq"))[code], np.arange(items) // 4


@pytest.mark.parametrize("classes", [2, 3])
def test_the_classifier_equals_the_projects_machine(classes):
    x, y, groups = blobs(classes)
    names, code = np.unique(y, return_inverse=True)
    spec = SvmSpec("rbf", 2.0, True, ranks=True)
    machine = SvmClassifier(cost=2.0, ranks=True, probability=True, random_state=3).fit(x, y, groups=groups)
    expected = fit_probabilistic(x, code, groups, names.tolist(), spec, 3)
    np.testing.assert_array_equal(machine.predict_proba(x), expected.probability(x))
    np.testing.assert_array_equal(machine.predict(x), fit(x, code, names.tolist(), spec).predict(x))
    decision = machine.decision_function(x)
    assert decision.shape == ((120,) if classes == 2 else (120, 3))


@pytest.mark.parametrize("weight", [[1.0, 2.0], [1.0, 0.0, 1.0], 1.0])
def test_weights_that_are_not_one_for_each_feature_are_refused(weight):
    with pytest.raises(InputError, match="expected 3 positive numbers"):
        SvmClassifier(feature_weight=weight).fit(np.eye(3), [0, 1, 1])


def test_folds_are_a_number_of_any_type_or_a_splitter():
    x, y, _ = blobs(2)
    plain, whole = (SvmClassifier(probability=True, cv=cv).fit(x, y) for cv in (3, np.int64(3)))
    np.testing.assert_array_equal(whole.predict_proba(x), plain.predict_proba(x))
    with pytest.raises(InputError, match="folds are list; expected a number"):
        SvmClassifier(probability=True, cv=[([0], [1])]).fit(x, y)


def test_groups_and_splitters_decide_which_samples_fit_the_sigmoids():
    x, y, groups = blobs(2)
    alone = SvmClassifier(probability=True).fit(x, y).sigmoid_
    grouped = SvmClassifier(probability=True).fit(x, y, groups=groups).sigmoid_
    left_out = SvmClassifier(probability=True, cv=LeaveOneGroupOut()).fit(x, y, groups=groups).sigmoid_
    assert len({float(s[0, 0]) for s in (alone, grouped, left_out)}) == 3


OPTIONS = [
    {},
    {"kernel": "linear", "balanced": True},
    {"kernel": "poly", "gamma": "scale"},
    {"ranks": True, "balanced": True},
    {"probability": True},
]


@pytest.mark.parametrize("options", OPTIONS)
def test_weights_of_one_change_no_bit(options):
    x, y, groups = blobs()
    plain = SvmClassifier(**options).fit(x, y, groups=groups)
    weighted = SvmClassifier(**options).fit(x, y, groups=groups, sample_weight=np.ones(120, int))
    np.testing.assert_array_equal(weighted.decision_function(x), plain.decision_function(x))
    np.testing.assert_array_equal(weighted.model_.dual, plain.model_.dual)
    if "probability" in options:
        np.testing.assert_array_equal(weighted.sigmoid_, plain.sigmoid_)


@pytest.mark.parametrize("classes", [2, 3])
@pytest.mark.parametrize("options", [one for one in OPTIONS if "ranks" not in one])
def test_integer_weights_equal_repeated_rows(options, classes):
    """But for where the solver stops; with probabilities, in folds that weights do not move."""
    x, y, groups = blobs(classes)
    weight = np.random.default_rng(1).integers(0, 4, 120)
    again = np.repeat(np.arange(120), weight)
    machine = SvmClassifier(**options, cv=GroupKFold(5))
    repeated = clone(machine).fit(x[again], y[again], groups=groups[again] % 5)
    weighted = clone(machine).fit(x, y, groups=groups % 5, sample_weight=weight)
    np.testing.assert_allclose(weighted.model_.width, repeated.model_.width, rtol=1e-12)
    assert weighted.model_.gamma == pytest.approx(repeated.model_.gamma, rel=1e-12)
    np.testing.assert_allclose(weighted.model_.decision(x), repeated.model_.decision(x), atol=5e-3, rtol=2e-3)
    assert np.abs(weighted.model_.decision(x) - clone(machine).fit(x, y).model_.decision(x)).max() > 0.05
    if "probability" in options:
        np.testing.assert_allclose(weighted.predict_proba(x), repeated.predict_proba(x), atol=5e-3)


@pytest.mark.parametrize("weight", [[1.0, 2.0], [[1.0], [1.0], [1.0]], [1, -1, 1], [1, np.nan, 1], [1, np.inf, 1], 2.0])
def test_weights_that_are_not_one_for_each_sample_are_refused(weight):
    with pytest.raises(InputError, match="expected 3 finite numbers, none of them negative"):
        SvmClassifier().fit(np.eye(3), [0, 1, 1], sample_weight=weight)


def test_a_class_without_weight_is_no_class():
    x, y, _ = blobs()
    machine = SvmClassifier().fit(x, y, sample_weight=y != "z")
    assert machine.classes_.tolist() == ["a", "m"]
    with pytest.raises(InputError, match="at least two classes"):
        machine.fit(x, y, sample_weight=y == "z")


def test_weights_reach_the_classifier_of_the_chain():
    """Also where cross-validation hands them on; classifiers that take none are not silently fitted without."""
    wrench, weight = wrenches(), np.where(TRIAL < 9, 1.0, 0.0)
    chain = StateClassifier(features=SPEC, classifier=SvmClassifier(probability=True))
    few = clone(chain).fit(wrench[TRIAL < 9], STATE[TRIAL < 9], TRIAL[TRIAL < 9])
    weighted = clone(chain).fit(wrench, STATE, TRIAL, weight)
    np.testing.assert_array_equal(weighted.predict_proba(wrench), few.predict_proba(wrench))
    with config_context(enable_metadata_routing=True):
        asked = clone(chain).set_fit_request(groups=True, sample_weight=True).set_score_request(sample_weight=True)
        scores = cross_val_score(
            asked, wrench, STATE, cv=GroupKFold(3), params={"groups": TRIAL, "sample_weight": weight}
        )
        for score, (a, b) in zip(scores, GroupKFold(3).split(wrench, STATE, TRIAL), strict=True):
            a, b = a[weight[a] > 0], b[weight[b] > 0]
            assert score == clone(chain).fit(wrench[a], STATE[a], TRIAL[a]).score(wrench[b], STATE[b])
        with pytest.raises(ValueError, match="sample_weight"):
            cross_val_score(asked, wrench, STATE, cv=2, params={"groups": TRIAL, "sample_weight": -weight})
    nested = clone(chain).set_params(classifier=GridSearchCV(SvmClassifier(), {"cost": [1, 2]}, cv=2))
    assert nested.fit(wrench, STATE, sample_weight=1 + weight).score(wrench, STATE) == 1
    with pytest.raises(InputError, match="KNeighborsClassifier takes no sample_weight"):
        chain.set_params(classifier=KNeighborsClassifier()).fit(wrench, STATE, sample_weight=weight)


@pytest.mark.parametrize("kernel", ["linear", "rbf"])
def test_a_constant_feature_decides_nothing(kernel):
    """The deviation of 21 values 0.1 is 1e-17 by rounding; divided by it, 0.11 would be far from all that was seen."""
    x = np.random.default_rng(0).normal(size=(21, 3))
    y = x[:, 0] > 0
    x[:, 2] = 0.1
    assert x[:, 2].std() > 0
    machine = SvmClassifier(kernel=kernel).fit(x, y)
    seen = machine.decision_function(x)
    x[:, 2] = 0.11
    np.testing.assert_allclose(machine.decision_function(x), seen, atol=0.1)
