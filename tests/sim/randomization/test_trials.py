"""Randomised trials: a seed and an index determine them, ranges hold, faults do what they are called."""

from __future__ import annotations

import inspect
import re
from copy import copy
from dataclasses import replace
from typing import Any

import hypothesis.strategies as st
import jax
import numpy as np
import pytest
from hypothesis import given, settings

from rcbht_jax.errors import InputError
from sim_mjx.assembly.rollout import TrialParams
from sim_mjx.presets import ONE_ARM
from sim_mjx.randomization import trials
from sim_mjx.randomization.trials import FAULTS, LIMITS, DomainRandomization, Fault, sample
from sim_mjx.registry import get_scenario

NOMINAL = DomainRandomization(nominal_share=1.0)
PATTERN = re.compile(r"([+-]x)?([+-]y)?([+-]r)?")  # as rcbht_jax.types.Recordings.failure_type has it


def only(kind: str, **changes: object) -> DomainRandomization:
    return replace(DomainRandomization(nominal_share=0.0, faults=(kind,)), **changes)


def given_as(spec: DomainRandomization, **values: object) -> DomainRandomization:
    """The spec with values of any type, which the annotations of the tests' run refuse."""
    new = copy(spec)
    for name, value in values.items():
        object.__setattr__(new, name, value)
    new.__post_init__()
    return new


def same(a: TrialParams, b: TrialParams) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


@given(st.integers(0, 2**64 - 1), st.integers(0, 10**9), st.sampled_from(list(ONE_ARM)))
def test_seed_and_index_determine_a_trial(seed: int, index: int, preset: str) -> None:
    params, fault = sample(ONE_ARM[preset], seed, index, DomainRandomization())
    batch, faults = get_scenario(preset).draw_batch(seed, [index + 7, index, index + 1], DomainRandomization())
    assert same(params, jax.tree.map(lambda leaf: leaf[1], batch))
    assert (fault.kind, fault.failure_type) == (faults[1].kind, faults[1].failure_type)
    assert np.array_equal(fault.deviation, faults[1].deviation)
    assert not np.array_equal(batch.seed[0], batch.seed[1])


def test_streams_of_neighbours_differ() -> None:
    keys = {
        tuple(sample(ONE_ARM["A"], seed, index, NOMINAL)[0].seed.tolist()) for seed in range(20) for index in range(20)
    }
    assert len(keys) == 400


@pytest.mark.parametrize("seed", [-1, 2**64, 1.5, "1", None])
def test_what_is_no_seed_is_refused(seed: Any) -> None:
    unchecked = inspect.unwrap(trials._streams)  # the annotations of the tests' run refuse it first
    with pytest.raises(InputError, match=r"The seed is .*; expected a whole number, 0 to"):
        next(unchecked(seed, (0,)))


@pytest.mark.parametrize(("name", "total"), [("A", 3843.1440608310095), ("two", 7799.405561914242)])
def test_draws_are_those_of_this_version(name: str, total: float) -> None:
    # guards against another order or distribution of the draws, which would change every stored set of trials
    params, faults = get_scenario(name).draw_batch(0, range(600), DomainRandomization())
    leaves = jax.tree.leaves((params, [fault.deviation for fault in faults]))
    drawn = np.nan_to_num(np.concatenate([np.ravel(leaf) for leaf in leaves], dtype=np.float64), posinf=0, neginf=0)
    assert np.sin(1e3 * drawn).sum() == pytest.approx(total, rel=1e-9)


@pytest.mark.parametrize("name", sorted(LIMITS))
@settings(max_examples=5)
@given(st.data(), st.sampled_from(sorted(FAULTS)), st.integers(0, 1000))
def test_any_allowed_range_gives_a_trial_inside_it(name: str, data: st.DataObject, kind: str, i: int) -> None:
    low, high = sorted(data.draw(st.floats(*LIMITS[name])) for _ in range(2))
    params, fault = sample(ONE_ARM["A"], 1, i, only(kind, **{name: (low, high)}))
    leaves = [np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(params)]
    finite = np.concatenate([np.ravel(leaf) for leaf in leaves])
    assert not np.isnan(finite).any()
    nominal, at_rest, own, task = ONE_ARM["A"].parts, ONE_ARM["A"].sensor, ONE_ARM["A"].task, params.task
    ratios = {
        "stiffness": params.parts.tab_stiffness / nominal.tab_stiffness,
        "mount": params.parts.mount_stiffness / nominal.mount_stiffness,
        "overlap": np.abs(params.parts.hook_overlap) / nominal.hook_overlap,
        "force_bias": params.sensor.bias[:3] - at_rest.bias[:3],
        "moment_bias": params.sensor.bias[3:] - at_rest.bias[3:],
        "tare": params.sensor.tared,
        "speed": own.way_time / task.way_time,
        "gain": np.append(task.moment_gain / own.moment_gain, task.force_gain / own.force_gain),
        "goal": np.append(task.force[:, 0] / own.force[:, 0], task.moment[:3, 1] / own.moment[:3, 1]),
        "friction": params.parts.friction / nominal.friction,
        "noise": params.sensor.noise / at_rest.noise,
    }
    if name in ratios and not (name in ("overlap", "friction") and kind == "jamming"):
        slack = 1e-9 * max(1.0, abs(low), abs(high))
        assert ((ratios[name] >= low - slack) & (ratios[name] <= high + slack)).all()
    assert fault.kind == kind


def test_ranges_may_be_lists_or_arrays_and_nothing_else_than_two_numbers() -> None:
    listed = given_as(NOMINAL, friction=[0.9, 1.1], faults=["pose"], lag=[4, 5])
    plain = replace(NOMINAL, friction=(0.9, 1.1), faults=("pose",), lag=(4, 5))
    assert listed == given_as(plain, friction=np.array([0.9, 1.1]), nominal_share=np.array(plain.nominal_share))
    assert listed == plain
    assert same(sample(ONE_ARM["B"], 0, 0, listed)[0], sample(ONE_ARM["B"], 0, 0, plain)[0])
    for values, sentence in (
        ({"friction": 0.9}, "The range of friction is 0.9; expected two numbers"),
        ({"friction": (0.9, 1.0, 1.1)}, r"The range of friction is \(0.9, 1.0, 1.1\); expected two numbers"),
        ({"lag": (4.5, 5.0)}, r"The lag is \(4.5, 5.0\); expected two increasing counts"),
        ({"longest": "3"}, "The longest trial is 3 s"),
    ):
        with pytest.raises(InputError, match=sentence):
            sample(ONE_ARM["B"], 0, 0, given_as(NOMINAL, **values))


@pytest.mark.parametrize("name", sorted(LIMITS))
def test_ranges_beyond_the_limits_are_refused(name: str) -> None:
    least, most = LIMITS[name]
    wrong = [(least - 1.0, most), (least, most + 1.0), (most, least), (float("nan"), most), (least, float("inf"))]
    for span in wrong:
        with pytest.raises(InputError, match=name):
            sample(ONE_ARM["A"], 0, 0, replace(DomainRandomization(), **{name: span}))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"nominal_share": -0.1}, "nominal share"),
        ({"nominal_share": float("nan")}, "nominal share"),
        ({"faults": ()}, "faults"),
        ({"faults": ("pose", "gremlins")}, "gremlins"),
        ({"longest": 0.0}, "longest"),
        ({"longest": float("inf")}, "longest"),
        ({"lag": (5, 4)}, "lag"),
        ({"lag": (0, 11)}, "lag"),
    ],
)
def test_other_bad_options_are_refused(changes: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        sample(ONE_ARM["A"], 0, 0, replace(DomainRandomization(), **changes))


@pytest.mark.parametrize(("preset", "seed", "index"), [("A", -1, 0), ("A", 2**64, 0), ("A", 0, -1)])
def test_bad_trials_are_refused(preset: str, seed: int, index: int) -> None:
    with pytest.raises(InputError, match="expected"):
        sample(ONE_ARM[preset], seed, index, DomainRandomization())


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_nominal_share(share: float) -> None:
    _, faults = get_scenario("A").draw_batch(9, range(500), DomainRandomization(nominal_share=share))
    assert abs(np.mean([fault.kind == "none" for fault in faults]) - share) <= (0.07 if share == 0.3 else 0.0)
    kinds = {fault.kind for fault in faults} - {"none"}
    assert kinds == (set() if share == 1.0 else set(FAULTS))


def drawn(kind: str, preset: str = "A") -> list[tuple[TrialParams, Fault]]:
    return [sample(ONE_ARM[preset], 2, index, only(kind)) for index in range(200)]


def test_nominal_trials_deviate_little() -> None:
    deviation = np.array([sample(ONE_ARM["A"], 2, i, NOMINAL)[1].deviation for i in range(200)])
    assert (np.abs(deviation[:, :2]) <= 0.5e-3).all()
    assert deviation[:, :2].std(0) == pytest.approx([0.29e-3] * 2, rel=0.15)


def test_the_earliest_contact_moves_with_the_approach() -> None:
    own, task = ONE_ARM["openhrp"].task, sample(ONE_ARM["openhrp"], 0, 0, NOMINAL)[0].task
    assert task.way_time[1] != own.way_time[1]
    assert task.contact_after / task.way_time[1] == pytest.approx(own.contact_after / own.way_time[1])


def test_pose_faults_are_named_after_their_signs_and_stay_in_the_recorded_range() -> None:
    home = ONE_ARM["A"].task
    trials = drawn("pose")
    assert {len(fault.failure_type) // 2 for _, fault in trials} == {1, 2, 3}
    for params, fault in trials:
        assert fault.failure_type
        assert PATTERN.fullmatch(fault.failure_type)
        x, y, roll = fault.deviation
        assert -0.5e-3 <= x <= 0.020
        assert abs(y) <= 0.0105
        assert abs(roll) <= 0.5236
        for sign, axis in re.findall("([+-])(.)", fault.failure_type):
            assert (fault.deviation["xyr".index(axis)] >= 0) == (sign == "+")
        np.testing.assert_allclose(params.task.way_position - home.way_position, [[x, y, 0.0]] * 2, atol=1e-12)
        np.testing.assert_allclose(params.task.way_rpy - home.way_rpy, [[roll, 0.0, 0.0]] * 2, atol=1e-12)


def test_other_faults_do_what_they_are_called() -> None:
    nominal = ONE_ARM["A"].parts
    for params, _ in drawn("jamming"):
        assert params.parts.friction > 2 * nominal.friction
        assert (params.parts.hook_overlap > 1.5 * nominal.hook_overlap).all()
    assert all((params.parts.hook_overlap < 0).sum() == 1 for params, _ in drawn("missing-tab"))
    missing = {int(np.argmin(params.parts.hook_overlap)) for params, _ in drawn("missing-tab")}
    assert missing == {0, 1, 2, 3}
    worn = replace(only("missing-tab"), missing_overlap=(-1.0, 0.5))
    tabs = [sample(ONE_ARM["A"], 2, i, worn)[0].parts.hook_overlap / nominal.hook_overlap for i in range(60)]
    least = np.array([tab.min() for tab in tabs])
    assert 0.4 < (least < 0).mean() < 0.9  # two thirds broken off, the others worn
    assert all((np.sort(tab)[1:] > 0.9).all() for tab in tabs)
    with pytest.raises(InputError, match="missing_overlap"):
        sample(ONE_ARM["A"], 0, 0, replace(worn, missing_overlap=(-2.0, 0.0)))
    for params, fault in drawn("wedging"):
        tilt = params.task.way_rpy[1, 1] - ONE_ARM["A"].task.way_rpy[1, 1]
        assert 0.09 <= abs(fault.deviation[2]) <= 0.20
        assert 0.05 <= abs(tilt) <= 0.12
        assert fault.failure_type == ""
    for params, fault in drawn("moved-part"):
        axis = "xy".index(fault.failure_type[1])
        assert 0.021 <= abs(params.parts.position[axis] - nominal.position[axis]) <= 0.040 + 1e-12
        assert np.sign(fault.deviation[axis]) == -np.sign(params.parts.position[axis])
        assert (fault.deviation[axis] > 0) == (fault.failure_type[0] == "+")


@pytest.mark.parametrize("preset", list(ONE_ARM))
def test_early_stop_comes_before_mating(preset: str) -> None:
    limits = [float(params.task.timeout) for params, _ in drawn("early-stop", preset)]
    assert 0 < min(limits) < max(limits) < ONE_ARM[preset].mating_begins
    assert sample(ONE_ARM[preset], 2, 0, NOMINAL)[0].task.timeout == ONE_ARM[preset].task.timeout


@pytest.mark.parametrize("preset", list(ONE_ARM))
def test_a_logger_that_goes_on_sees_the_stopped_robot_until_the_planned_end(preset: str) -> None:
    spec = only("early-stop", logs_on=2.5)
    own, planned = ONE_ARM[preset].task, ONE_ARM[preset].mating_begins - ONE_ARM[preset].task.way_time[-1]
    for index in range(20):
        quiet, logged = (sample(ONE_ARM[preset], 2, index, replace(spec, logs_on=on))[0].task for on in (None, 2.5))
        assert logged.stop == quiet.timeout < quiet.stop
        ends = logged.way_time[-1] + planned + own.mating_time + 2.5
        assert logged.timeout == pytest.approx(min(ends, float(own.timeout)))
    nominal = sample(ONE_ARM[preset], 2, 0, replace(NOMINAL, logs_on=2.5))[0].task
    assert nominal.rest == 2.5
    assert same(replace(nominal, rest=np.array(0.0)), sample(ONE_ARM[preset], 2, 0, NOMINAL)[0].task)
    with pytest.raises(InputError, match="logger goes on for -1"):
        sample(ONE_ARM[preset], 0, 0, replace(NOMINAL, logs_on=-1.0))
    with pytest.raises(InputError, match="expected 0 to 600 s"):
        sample(ONE_ARM[preset], 0, 0, replace(NOMINAL, logs_on=600.5))


def test_longest_cuts_every_trial() -> None:
    assert all(sample(ONE_ARM["A"], 2, i, DomainRandomization(longest=1.5))[0].task.timeout <= 1.5 for i in range(50))


def test_simulated_preset_has_the_simulated_sensor() -> None:
    params, _ = sample(ONE_ARM["openhrp"], 0, 0, NOMINAL)
    assert not params.sensor.bias.any()
    assert params.command_delay == 1
    assert sample(ONE_ARM["A"], 0, 0, NOMINAL)[0].command_delay in (4, 5)


def test_a_trial_can_use_another_sessions_sensor() -> None:
    borrowed, _ = sample(ONE_ARM["openhrp"], 0, 0, replace(NOMINAL, sensor="B"))
    own, real = sample(ONE_ARM["openhrp"], 0, 0, NOMINAL)[0], ONE_ARM["B"].sensor
    assert [borrowed.sensor.b, borrowed.sensor.delay] == [real.b, real.delay]
    assert np.ptp(borrowed.sensor.noise / real.noise) < 1e-9
    assert not np.array_equal(borrowed.sensor.bias, real.bias)
    assert same(replace(borrowed, sensor=own.sensor), own)
    with pytest.raises(InputError, match="no sensor of session 'Z'"):
        sample(ONE_ARM["A"], 0, 0, replace(NOMINAL, sensor="Z"))


def test_lag_and_how_long_mating_is_recorded_can_vary_and_change_nothing_else() -> None:
    own, varied = (
        sample(ONE_ARM["C"], 0, 6, DomainRandomization(nominal_share=0.0, mating=mating, lag=lag))[0]
        for mating, lag in ((None, (5, 5)), ((1.0, 20.0), (2, 8)))
    )
    assert varied.command_delay != own.command_delay
    assert 1.0 <= varied.task.mating_time <= 20.0 != own.task.mating_time
    task = replace(varied.task, mating_time=own.task.mating_time)
    assert same(replace(varied, command_delay=own.command_delay, task=task), own)


@pytest.mark.parametrize("name", ["C", "two"])
def test_a_fault_is_not_told_by_the_duration_where_mating_varies_too(name: str) -> None:
    scenario = get_scenario(name)
    spec = DomainRandomization(faults=("early-stop",), mating=(1.0, 2.0), logs_on=0.5)
    params, faults = scenario.draw_batch(3, range(60), spec)
    task, own = params.task, scenario.preset.task
    begins = task.way_time[:, -1] + scenario.preset.mating_begins - own.way_time[-1]
    stopped = np.array([fault.kind == "early-stop" for fault in faults])
    assert ((task.mating_time >= 1.0) & (task.mating_time <= 2.0)).all()
    np.testing.assert_allclose(task.timeout[stopped], (begins + task.mating_time + 0.5)[stopped])
