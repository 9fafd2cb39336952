"""Groups of trials, such as operators, that no fold may divide."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import GridSearchCV, GroupKFold

from rcbht_jax import StateClassifier, SvmClassifier, encode
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning.evaluation import EvaluationProtocol, evaluate
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import TaskSpec
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
    with pytest.raises(InputError, match="has 2 operators, so choose 2 folds"):
        scored(folds=3, group="operator")
    with pytest.raises(InputError, match="no column 'day'; there are"):
        scored(group="day")
    with pytest.raises(InputError, match="grouped by operator, but sessions"):
        scored(group="operator", train_on=("A",), test_on=("B",))


@pytest.mark.parametrize(
    "classifier",
    [
        None,
        RandomForestClassifier(3, random_state=0),
        GridSearchCV(SvmClassifier(kernel="linear"), {"cost": [1, 2]}, cv=GroupKFold(2)),
    ],
)
def test_groups_go_to_classifiers_that_take_them(classifier):
    made = Recordings.example()
    groups = np.tile([0, 1], 4)
    found = StateClassifier(classifier=classifier).fit(made.wrench, made.outcome, groups=groups)
    assert found.predict(made.wrench).tolist() == made.outcome.tolist()
