"""Small models for the tests of introspection, trained on synthetic signals."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import weights
from rcbht_jax.introspection.chain import FeatureView, online_features
from rcbht_jax.introspection.model import Head, IntrospectionModel
from rcbht_jax.learning.probability import fit_probabilistic
from rcbht_jax.learning.progress import ProgressCalibration
from rcbht_jax.learning.svm import SvmSpec

CONFIG, LIMITS = EncoderConfig(), preset()
FIT, FIT_LIMITS = FitConfig(window=4), FitLimits(LIMITS.limits, np.linspace(0.05, 0.1, 6))
BY_PROGRESS = ProgressCalibration(3.0, (2.0, 1.5, 1.0, 0.8), (0.9, 0.4, 0.1, 0.0), (0.4, 0.3, 0.3))
NOW = np.arange(20, 401, 40)
VIEW = FeatureView(FeatureSpec(families=("histogram", "edges", "parts", "levels"), balance=True))


def trial(kind: int, seed: int, samples: int = 400) -> np.ndarray:
    """Calm, pushed or shaken: float32 ``[time, 6]``."""
    rng = np.random.default_rng([kind, seed])
    time = np.arange(samples)[:, None] * CONFIG.dt
    slope = (0.0, 5.0, 0.0)[kind] * time
    shake = (0.0, 0.0, 3.0)[kind] * np.sin(25 * time + rng.uniform(0, 6))
    return (rng.normal(size=(samples, 6)) * 0.02 + slope + shake).astype(np.float32)


@cache
def features(kind: int, seed: int, fits: bool) -> np.ndarray:
    """Of a trial, from its beginning to each moment of NOW; the heads share the trials."""
    config, limits = (FIT, FIT_LIMITS) if fits else (CONFIG, LIMITS)
    return online_features(config, limits, VIEW, trial(kind, seed), np.zeros_like(NOW), NOW)


def head(name: str, scope: str, classes: tuple[str, ...], kernel: str, alarm: str = "", fits: bool = False) -> Head:
    kinds = np.repeat(np.arange(len(classes)), 6)
    x = [features(int(kind), seed, fits) for seed, kind in enumerate(kinds)]
    y, group = np.repeat(kinds, len(NOW)), np.repeat(np.arange(len(kinds)), len(NOW))
    spec = SvmSpec(kernel, 1.0, True, floor=0.1, ranks=True)
    machine = fit_probabilistic(np.concatenate(x), y, group, classes, spec, weight=weights(VIEW.spec))
    return Head(name, scope, VIEW, machine, alarm)


@cache
def model() -> IntrospectionModel:
    heads = (
        head("states", "subtask", ("calm", "push", "shake"), "linear"),
        head("outcome", "trial", ("success", "failure"), "rbf", "failure"),
        replace(head("failure-type", "trial", ("none", "pushed", "shaken"), "poly"), progress=BY_PROGRESS),
    )
    return IntrospectionModel(CONFIG, np.asarray(preset().limits), heads, "abc", extra={"made": "up"})


@cache
def fit_model() -> IntrospectionModel:
    """One classifier of words by the fit rule."""
    states = head("states", "subtask", ("calm", "push", "shake"), "linear", fits=True)
    return IntrospectionModel(FIT, FIT_LIMITS, (states,), "abc")


def few_axes(count: int) -> IntrospectionModel:
    """One classifier of a signal with so many axes."""
    limits, kinds = LIMITS.limits[:count], np.repeat([0, 1], 6)
    x = [
        online_features(
            CONFIG, GradientThresholds(limits), VIEW, trial(int(kind), k)[:, :count], np.zeros_like(NOW), NOW
        )
        for k, kind in enumerate(kinds)
    ]
    y, group = np.repeat(kinds, len(NOW)), np.repeat(np.arange(len(kinds)), len(NOW))
    spec = SvmSpec("linear", 1.0, True, floor=0.1, ranks=True)
    machine = fit_probabilistic(np.concatenate(x), y, group, ("calm", "push"), spec, weight=weights(VIEW.spec, count))
    return IntrospectionModel(CONFIG, limits, (Head("states", "subtask", VIEW, machine),), "abc")


def archive_of(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Arrays and description of a model file, as ``write_archive`` takes them."""
    with np.load(path) as archive:
        members = {name: archive[name] for name in archive.files}
    return members, json.loads(str(members.pop("meta")))
