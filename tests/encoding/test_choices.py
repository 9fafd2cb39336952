"""Choices of an encoder that come from a file: of the right type and countable, or refused in one sentence."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import config_fields, config_from
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning.svm import SvmSpec

ROOT = Path(__file__).resolve().parents[2]
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


NUMBERS_OF_ARRAYS = """
import json
from dataclasses import asdict

import jax.numpy as jnp
import numpy as np

import rcbht_jax as rj
from rcbht_jax.encoding.fit import FitConfig

for made, plain in (
    (rj.EncoderConfig(np.int64(7), np.float64(0.25), gate=np.bool_(True)), rj.EncoderConfig(7, 0.25)),
    (rj.EncoderConfig(dt=jnp.float32(0.25), latency_cap=np.float32(0.5)), rj.EncoderConfig(dt=0.25, latency_cap=0.5)),
    (FitConfig(np.int32(7), np.array(0.25), evidence=jnp.float32(0.5)), FitConfig(7, 0.25, evidence=0.5)),
    (rj.FeatureSpec(["ngram"], slots=np.array([3, 2, 1])), rj.FeatureSpec(("ngram",), slots=(3, 2, 1))),
):
    assert (made, hash(made), json.dumps(asdict(made))) == (plain, hash(plain), json.dumps(asdict(plain))), made
wrench = np.zeros((60, 2))
for rate in (np.float32(200), np.int64(200), jnp.float32(200)):
    assert rj.encode(wrench, rate).info == rj.encode(wrench).info, rate
"""


def test_choices_of_arrays_and_lists_are_those_of_plain_values() -> None:
    """In a process that does not check types, which would refuse them here."""
    done = subprocess.run([sys.executable, "-c", NUMBERS_OF_ARRAYS], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64, jnp.float32])
def test_a_rate_of_any_type_gives_the_same_features(kind: Any) -> None:
    wrench = np.arange(240.0).reshape(2, 60, 2) % 7
    found, expected = (rj.WrenchFeatures(rate=rate).fit_transform(wrench) for rate in (kind(200), 200.0))
    np.testing.assert_array_equal(found, expected)


def test_an_absurd_cost_is_refused() -> None:
    for cost in (math.nan, math.inf, 0.0, -1.0):
        with pytest.raises(InputError, match=r"does not exist|finite number"):
            SvmSpec(cost=cost)
