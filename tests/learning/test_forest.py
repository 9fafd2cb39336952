"""Trees as arrays, against scikit-learn's."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier

from rcbht_jax.errors import InputError
from rcbht_jax.learning.forest import LEAF, Forest

RNG = np.random.default_rng(0)
X, Y = RNG.normal(size=(300, 5)), RNG.integers(0, 3, 300)


@pytest.mark.parametrize("kind", [ExtraTreesClassifier, RandomForestClassifier])
@pytest.mark.parametrize("leaf", [1, 5, 300])
def test_probabilities_are_those_of_scikit_learn(kind, leaf):
    trees = kind(20, min_samples_leaf=leaf, random_state=0).fit(X, Y)
    forest = Forest.of(trees)
    forest = Forest.from_arrays(forest.arrays("a."), 5, 3, "a.")
    test = RNG.normal(size=(50, 5))
    np.testing.assert_allclose(forest.probabilities(test), trees.predict_proba(test), atol=1e-12)
    np.testing.assert_array_equal(forest.probabilities(test[:1]), forest.probabilities(test)[:1])


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("left", lambda part: part * 0),  # a tree without end
        ("right", lambda part: part + len(part)),
        ("feature", lambda part: np.where(part == LEAF, LEAF, 5)),
        ("feature", lambda part: part - 1),
        ("feature", lambda part: part.astype(float)),
        ("share", lambda part: part + 1),
        ("share", lambda part: part[:, :2]),
        ("threshold", lambda part: part[:-1]),
        ("root", lambda part: part[:0]),
        ("root", lambda part: part - 1),
    ],
)
def test_trees_that_do_not_fit_are_refused(name, change):
    arrays = Forest.of(ExtraTreesClassifier(4, random_state=0).fit(X, Y)).arrays()
    with pytest.raises(InputError, match="do not fit each other"):
        Forest.from_arrays(arrays | {name: change(arrays[name])}, 5, 3)
