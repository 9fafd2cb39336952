"""The support vector machine as an estimator: what a second fit leaves, and what its groups are."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.exceptions import NotFittedError

from rcbht_jax.errors import InputError
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.learning.svm_classifier import SvmClassifier

X, Y = np.random.default_rng(0).normal(size=(40, 3)) + np.arange(40)[:, None] % 2, np.arange(40) % 2


def test_probabilities_need_a_fit_with_them() -> None:
    """Those of an earlier fit belong to another machine."""
    machine = SvmClassifier(probability=True).fit(X, Y)
    machine.set_params(probability=False).fit(-X, Y).set_params(probability=True)
    with pytest.raises(NotFittedError, match="fitted without probability"):
        machine.predict_proba(X)
    assert machine.fit(X, Y).predict_proba(X).shape == (40, 2)


def test_groups_are_a_column() -> None:
    with pytest.raises(ValueError, match="1d array"):
        SvmClassifier(probability=True).fit(X, Y, groups=np.ones((40, 2)))


def test_groups_that_have_no_order_are_refused() -> None:
    for groups in ([None] * 40, np.array(["day"] * 39 + [None], object)):
        with pytest.raises(InputError, match="Some groups are missing or of another kind"):
            SvmClassifier(probability=True).fit(X, Y, groups=groups)
        with pytest.raises(InputError, match="Some groups are missing or of another kind"):
            NominalMonitor().fit(np.zeros((40, 9, 1)), groups=groups)
