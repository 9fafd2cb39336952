"""Comparison of pytrees."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np


def assert_trees_equal(one: Any, other: Any) -> None:
    """The same structure and the same values, bit for bit (NaN equals NaN)."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(a, b)
