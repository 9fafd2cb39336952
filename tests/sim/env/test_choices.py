"""What an environment is made of: its options, thresholds, models and trials, and what does not fit."""

from __future__ import annotations

import inspect
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from rcbht_jax.encoding.thresholds import GradientThresholds, read_thresholds, write_thresholds
from rcbht_jax.errors import InputError
from sim_mjx import env as environments
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.env.actions import with_set_points
from sim_mjx.env.config import EnvConfig
from sim_mjx.env.senses import new_senses
from sim_mjx.registry import get_scenario
from tests.support.fake_physics import environment, model, trials

JOINT = EnvConfig(action="joint", controller="none", observe=("joints", "wrench"))
STEERED = EnvConfig(observe=("joints", "wrench"))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"action": "torque"}, "no action 'torque'"), ({"controller": "pid"}, "no controller"),
        ({"observe": ("camera",)}, "no observation 'camera'"), ({"observe": ()}, "one part or more"),
        ({"controller": "none"}, 'needs controller="recorded"'), ({"periods": 0}, "periods is 0"),
        ({"hold": 0.0}, "hold is 0.0"),
    ],
)  # fmt: skip
def test_impossible_configurations_are_refused(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        EnvConfig(**change)


def test_a_configuration_is_checked_whatever_its_types() -> None:
    def given(**values: Any) -> EnvConfig:  # which the annotations of the tests' run refuse
        config = copy(EnvConfig())
        for name, value in values.items():
            object.__setattr__(config, name, value)
        config.__post_init__()
        return config

    assert hash(given(observe=["joints", "wrench"])) == hash(EnvConfig(observe=("joints", "wrench")))
    for values, sentence in (
        ({"periods": 2.5}, "periods is 2.5; expected a whole number"),
        ({"periods": True}, "periods is True; expected a whole number"),
        ({"observe": "joints"}, "observe is 'joints'; expected a tuple of one part or more"),
        ({"observe": (["joints"],)}, r"There is no observation \['joints'\]"),
        ({"force": "20"}, "The environment's force is 20; expected a positive, finite number"),
    ):
        with pytest.raises(InputError, match=sentence):
            given(**values)


def test_words_without_a_model_take_any_thresholds(tmp_path: Path) -> None:
    wrist = np.arange(24, 0, -1.0).reshape(6, 4)
    two = np.concatenate([wrist, 2 * wrist])
    np.testing.assert_array_equal(new_senses(EnvConfig(), 6, 7, thresholds=GradientThresholds(wrist)).limits, wrist)
    np.testing.assert_array_equal(new_senses(EnvConfig(), 12, 14, thresholds=wrist).limits, np.tile(wrist, (2, 1)))
    np.testing.assert_array_equal(new_senses(EnvConfig(), 12, 14, thresholds=two).limits, two)
    file = tmp_path / "limits.json"
    write_thresholds(file, GradientThresholds(wrist), {})
    np.testing.assert_array_equal(new_senses(EnvConfig(), 6, 7, thresholds=read_thresholds(file)[0]).limits, wrist)
    for limits, sentence in ((wrist[:4], "every wrist, or"), (wrist[:, ::-1], "must be ordered")):
        with pytest.raises(InputError, match=sentence):
            new_senses(EnvConfig(), 12, 14, thresholds=limits)
    with pytest.raises(InputError, match="not both"):
        new_senses(EnvConfig(), 6, 6, model(), wrist)


def test_what_does_not_fit_the_scenario_is_refused() -> None:
    with pytest.raises(InputError, match="multiple of the encoder's window, 5"):
        new_senses(EnvConfig(periods=3), 6, 6)
    with pytest.raises(InputError, match="beliefs, which need a model"):
        new_senses(EnvConfig(observe=("beliefs",)), 6, 6)
    with pytest.raises(InputError, match="6 axes every"):
        new_senses(EnvConfig(), 12, 12, model())
    with pytest.raises(InputError, match="no force law"):
        with_set_points(object(), np.zeros(6, np.float32))
    scene = environment(JOINT)
    with pytest.raises(InputError, match="no force law"):
        environments.Environment(scene.program, scene.physics, replace(scene.trials, params=1), scene.senses, STEERED)
    for options, sentence in (
        ({"engine": "native"}, "engine 'native'; expected mjx or warp"),
        ({"trials": 0}, "trials is 0"),
        ({"trials": 2.0}, "trials is 2.0 .*; expected whole numbers"),
        ({"model": "online.model"}, "model is 'online.model'; expected what"),
        ({"spec": {"nominal_share": 1.0}}, "spec is .*; expected distributions"),
    ):
        with pytest.raises(InputError, match=sentence):
            inspect.unwrap(environments.load)("B", **options)
    for params in (jax.tree.map(lambda leaf: leaf[0], trials()), jax.tree.map(lambda leaf: leaf[:0], trials())):
        with pytest.raises(InputError, match="no batch of trials"):
            environments.load("B", params=params)
    with pytest.raises(InputError, match="trials of another scenario; expected"):
        environments.load("hooked-B", params=trials())
    with pytest.raises(InputError, match="trials of another scenario; expected"):
        environments.load(get_scenario("hooked-B"), params=trials())
    with pytest.raises(InputError, match=r"no environment 'tea-making'; expected one of camera-snap, .*, A, .*@"):
        environments.load("tea-making")


@pytest.mark.parametrize(
    ("extra", "sentence"),
    [
        ({"axes": ["Mx", "My", "Mz", "Fx", "Fy", "Fz"]}, "the model learned Mx, My, Mz, Fx, Fy, Fz"),
        ({"axes": list("abcdef"), "units": ["rad"] * 6}, "has a in N; the model learned it in rad"),
        ({"units": ["kN"] * 6}, "has Fx in N; the model learned it in kN"),
    ],
)
def test_a_model_of_other_axes_or_units_is_refused(extra: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        new_senses(EnvConfig(), 6, 6, replace(model(), extra=extra))


def test_time_of_a_step() -> None:
    assert EnvConfig(periods=10).dt == pytest.approx(10 * CONTROL_PERIOD)
