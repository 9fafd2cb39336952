"""The alphabets and the thresholds."""

from __future__ import annotations

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rcbht_jax import labels
from rcbht_jax.calibration.label_durations import Samples, label_durations
from rcbht_jax.encoding import encoder, soft_runs, thresholds
from rcbht_jax.encoding.batch import encode_on_device
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.limit_files import read_limits, write_limits
from rcbht_jax.encoding.rules import AnyConfig, rule_of
from rcbht_jax.encoding.thresholds import GradientThresholds, by_lane
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from tests.support import oracle


def test_every_label_has_a_name_a_meaning_and_a_colour() -> None:
    for layer, alphabet, size in zip(labels.LAYERS, labels.ALPHABETS, labels.LAYER_SIZES, strict=True):
        assert sorted(alphabet) == list(range(1, size + 1))
        assert len(labels.MEANING[layer]) == size
        assert len(set(labels.COLORS[layer])) == size
        assert len({labels.name(layer, code) for code in range(size + 1)}) == size + 1


@pytest.mark.parametrize(("layer", "code"), [("primitive", 10), ("llb", -1), ("word", 1)])
def test_unknown_labels_have_no_name(layer: str, code: int) -> None:
    with pytest.raises(ValueError):
        labels.name(layer, code)


def test_pair_table_is_the_specified_one() -> None:
    for row, first in enumerate("PNKpn"):
        for column, second in enumerate("PNKpn"):
            assert labels.name("mc", int(labels.MC_PAIR[row, column])) == oracle.PAIR[first + second]


@pytest.mark.parametrize("robot", thresholds.ROBOTS)
def test_presets_are_ordered_and_moments_a_tenth(robot: str) -> None:
    limits = thresholds.preset(robot).limits
    assert limits.shape == (6, 4)
    np.testing.assert_allclose(limits[3:] * 10, limits[:3])


@given(free=arrays(np.float32, (6, 4), elements=st.floats(-8, 8, width=32)))
def test_free_parameters_always_give_ordered_thresholds(free: np.ndarray) -> None:
    limits = np.asarray(thresholds.from_free(free).limits)
    assert (limits > 0).all()
    assert (np.diff(limits, axis=-1) <= 0).all()


def test_free_parameters_round_trip() -> None:
    limits = thresholds.preset().limits.astype(np.float32)
    back = thresholds.from_free(thresholds.to_free(GradientThresholds(limits))).limits
    np.testing.assert_allclose(back, limits, rtol=1e-5)


@pytest.mark.parametrize(
    "limits",
    [
        np.ones(4),
        np.ones((6, 3)),
        -np.ones((6, 4)),
        np.full((6, 4), np.nan),
        np.full((6, 4), 1e39),
        np.full((6, 4), 1e-39),
        np.tile([1.0, 2.0, 3.0, 4.0], (6, 1)),
    ],
)
def test_bad_thresholds_are_refused(limits: np.ndarray) -> None:
    with pytest.raises(InputError):
        thresholds.validate(limits)


def test_a_file_takes_a_name_and_what_encoders_take(tmp_path: Path) -> None:
    path, limits = str(tmp_path / "limits.json"), thresholds.preset().limits
    for form in (limits, GradientThresholds(limits)):
        thresholds.write_thresholds(path, form, {})
        np.testing.assert_array_equal(thresholds.read_thresholds(path)[0].limits, limits)
    fitted = FitLimits(limits, np.ones(6))
    with pytest.raises(InputError, match="write_limits"):
        thresholds.write_thresholds(path, fitted, {})
    write_limits(path, fitted, {})
    assert isinstance(read_limits(path)[0], FitLimits)


def test_files_with_tolerances_have_the_version_that_others_refuse(tmp_path: Path) -> None:
    """Files are read years later: the numbers are part of the format."""
    row = {"impulse": 4.0, "big": 3.0, "medium": 2.0, "small": 1.0}
    path, top = tmp_path / "limits.json", {"format": "rcbht-thresholds", "provenance": {}}
    path.write_text(json.dumps({**top, "format_version": 1, "limits": {"Fz": row}}))
    assert thresholds.read_thresholds(path, ["Fz"])[0].limits.tolist() == [[4.0, 3.0, 2.0, 1.0]]
    write_limits(path, FitLimits(np.array([[4.0, 3.0, 2.0, 1.0]]), np.array([0.5])), {}, axes=["Fz"])
    written = json.loads(path.read_text())
    assert (written["format_version"], written["limits"]) == (2, {"Fz": {**row, "tolerance": 0.5}})
    with pytest.raises(InputError, match="of the fit rule"):
        thresholds.read_thresholds(path, ["Fz"])


def test_the_letters_of_a_text_are_no_axes(tmp_path: Path) -> None:
    thresholds.write_thresholds(tmp_path / "limits.json", thresholds.preset(), {})
    for read in (thresholds.read_thresholds, read_limits):
        with pytest.raises(InputError, match="The axes are 'Fz'; expected names"):
            read(tmp_path / "limits.json", "Fz")


def test_unknown_robot_is_refused() -> None:
    with pytest.raises(InputError, match="hiro"):
        thresholds.preset("r2d2")


@pytest.mark.parametrize(
    "name",
    [
        "Mx", "Tz", "mx", "m_y", "tx", "torque_z", "moment x", "tau_3", "left.torque.x", "left_mz", "T1", "M", "Mres",
        "TCP_Tz", "Torque z", "tau_x", "moment_z", "MeasuredMx", "TCPTz", "x_torque", "force_torque/Mx", "TORQUEX",
    ],
)  # fmt: skip
def test_moments_get_their_limits_however_they_are_spelled(name: str) -> None:
    np.testing.assert_array_equal(thresholds.preset("hiro", [name]).limits, thresholds.preset("hiro", ["Mz"]).limits)


@pytest.mark.parametrize(
    "name",
    [
        "Fx", "fz", "force_z", "mass", "motor_1", "tcp_x", "load", "axis0", "force_t0", "torque_sensor_fx",
        "TCP_Fz", "Tool force z", "MeasuredFz", "measured_fz", "TCPFz", "Tool z force", "Total force", "Fx_m1",
    ],
)  # fmt: skip
def test_all_other_axes_get_the_limits_of_forces(name: str) -> None:
    np.testing.assert_array_equal(thresholds.preset("hiro", [name]).limits, thresholds.preset("hiro", ["Fz"]).limits)


@pytest.mark.parametrize("name", ["step", "step_partial", "flush", "provisional"])
@pytest.mark.parametrize("config", [EncoderConfig(), FitConfig()])
def test_limits_of_other_axes_are_refused_by_every_function_of_a_stream(name: str, config: AnyConfig) -> None:
    rule, number = rule_of(config), 5 if isinstance(config, FitConfig) else 4
    state, window, limits = rule.init(config, (2, 6)), jnp.ones((5, 2, 6)), jnp.ones((7, number))
    count = () if name == "step" else (jnp.ones((2, 6), jnp.int32),)
    with pytest.raises(InputError, match=rf"shape \(7, {number}\); expected \[6, {number}\] or \[2, 6, {number}\]"):
        getattr(rule, name)(config, limits, state, window, *count)
    with pytest.raises(InputError, match="has 4 samples; this encoder takes 5"):
        getattr(rule, name)(config, limits[:6], state, window[1:], *count)


def test_limits_lead_in_front_of_all_lanes_and_none_is_missing() -> None:
    limits = np.arange(24.0).reshape(6, 4)
    np.testing.assert_array_equal(by_lane(limits, 4, (2, 6), np.float32), np.stack([limits.T] * 2, 1))
    for shape in ((3, 4), (3, 6), (3, 1), (2, 5), (1, 5), (5,), (1, 3, 5), ()):
        with pytest.raises(InputError, match=r"expected \[3, 5\]\.$"):
            by_lane(np.ones(shape), 5, (3,), np.float32)
    with pytest.raises(InputError, match=r"expected \[3, 5\] or \[2, 3, 5\]"):
        by_lane(np.ones((1, 3, 5)), 5, (2, 3), np.float32)


def test_limits_of_one_axis_or_recording_are_not_those_of_all() -> None:
    """They gave words of the others, which were wrong."""
    one, five, wrench = np.ones((1, 2, 4)), np.ones((1, 5)), np.zeros((3, 40, 2), np.float32)
    length, state, fit_state = np.full(3, 40, np.int32), encoder.init((2,)), soft_runs.init(FitConfig(), (2,))
    recordings, counts = Samples(jnp.zeros((3, 40, 6)), jnp.asarray(length)), jnp.full(2, 5, jnp.int32)
    edges = jnp.array([[0, 40]] * 3)
    for run in (
        lambda: encoder.encode(EncoderConfig(), one, wrench, length),
        lambda: encoder.step(EncoderConfig(), one[0, :1], state, wrench[0, :5]),
        lambda: encode_on_device(EncoderConfig(), one, wrench, length),
        lambda: encode_on_device(EncoderConfig(), one, wrench, length, batch=2),
        lambda: encode_on_device(EncoderConfig(), np.ones((2, 2, 4)), wrench, length, batch=2),
        lambda: soft_runs.step(FitConfig(), five, fit_state, wrench[0, :5], counts, 0.1),
        lambda: soft_runs.drain(FitConfig(), five, fit_state, 0.1),
        lambda: label_durations(FitConfig(), five[None], recordings, edges),
    ):
        with pytest.raises(InputError, match="Thresholds have shape"):
            run()
