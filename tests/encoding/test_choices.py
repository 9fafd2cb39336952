"""Choices of an encoder that come from a file: of the right type and countable, or refused in one sentence."""

from __future__ import annotations

import math
from typing import Any

import pytest

from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import config_fields, config_from
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning.svm import SvmSpec

HOSTILE: tuple[Any, ...] = (None, "x", -1, 0, 1.5, 1e9, math.nan, math.inf, [], {}, [1], True, 10**30, -(10**30))


@pytest.mark.parametrize("config", [EncoderConfig(), FitConfig()])
def test_any_value_is_refused_or_makes_an_encoder(config: EncoderConfig | FitConfig) -> None:
    """What is accepted is hashable, of the stated type, and counts in 32 bits."""
    fields, refused = config_fields(config), 0
    for name in fields:
        for value in HOSTILE:
            try:
                made = config_from({**fields, name: value})
            except InputError:
                refused += 1
                continue
            hash(made)
            assert isinstance(made.window, int)
            assert made.short < 2**31
            assert made.latency_cap is None or made.latency_cap / made.dt < 2**31
    assert refused > 8 * len(fields)
    with pytest.raises(InputError, match="evil"):
        config_from({**fields, "evil": 1})
    assert config_from(fields) == config


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [({"slots": [10**9, 1, 1]}, "slots"), ({"slots": [1]}, "slots"), ({"families": "histogram"}, "families"),
     ({"ngram": True}, "ngram"), ({"balance": 1}, "balance")],
)  # fmt: skip
def test_features_of_a_file_are_checked(fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        FeatureSpec.from_dict(fields)


def test_an_absurd_cost_is_refused() -> None:
    for cost in (math.nan, math.inf, 0.0, -1.0):
        with pytest.raises(InputError, match="does not exist"):
            SvmSpec(cost=cost)
