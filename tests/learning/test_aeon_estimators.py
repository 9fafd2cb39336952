"""aeon's own checks of the estimators for collections, and that they equal the ones below them."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("aeon", reason="aeon wants older numba and pandas than constraints.txt; install the extra aeon")

from aeon.testing.estimator_checking import parametrize_with_checks

from rcbht_jax.learning.aeon_estimators import AeonStateClassifier, AeonWrenchFeatures
from rcbht_jax.learning.estimators import StateClassifier, WrenchFeatures
from rcbht_jax.learning.svm_classifier import SvmClassifier

PROBABLE = SvmClassifier(kernel="linear", probability=True)


@parametrize_with_checks([AeonWrenchFeatures(), AeonStateClassifier(), AeonStateClassifier(classifier=PROBABLE)])
def test_aeon_conventions(check):
    check()


def test_adapters_equal_their_estimators():
    wrench = np.cumsum(np.random.default_rng(0).normal(size=(12, 300, 6)), axis=1)
    y, turned = np.repeat(["a", "b"], 6), wrench.swapaxes(1, 2)
    np.testing.assert_array_equal(
        AeonWrenchFeatures(window=8).fit_transform(turned), WrenchFeatures(window=8).fit_transform(wrench)
    )
    ours, theirs = AeonStateClassifier(window=8).fit(turned, y), StateClassifier(window=8).fit(wrench, y)
    np.testing.assert_array_equal(ours.predict(turned), theirs.predict(wrench))
