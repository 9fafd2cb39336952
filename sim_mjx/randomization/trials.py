"""Randomised trials and faults: a seed and an index determine a trial, whatever batch it is simulated in.

Every trial has its own Philox stream: the seed is the key, the index the highest word of the counter, so that
streams never overlap. Deviations are those of the hand from the part, as in the names of the recorded failures:
+x = the hand is too far forward, +y too far left, +r turned to the left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float64

from rcbht_jax.errors import InputError
from sim_mjx.assembly import parts
from sim_mjx.assembly.parts import TABS, PartParams
from sim_mjx.assembly.rollout import TrialParams, repeated
from sim_mjx.assembly.sensor import LONGEST_DELAY, SensorParams
from sim_mjx.assembly.task import TaskParams, horizontal
from sim_mjx.own_code import finite, two_numbers, with_tuples
from sim_mjx.presets import ONE_ARM
from sim_mjx.presets.session import Range, SessionPreset
from sim_mjx.randomization import overrides
from sim_mjx.randomization.overrides import Physical

# How often the recorded failures deviate in which directions.
PATTERNS = {"x": 31, "y": 44, "r": 55, "xy": 59, "xr": 58, "yr": 72, "xyr": 79}


@dataclass(frozen=True)
class DomainRandomization:
    """Quantities that vary between trials; ranges are uniform distributions (lowest, highest).

    The end of each comment is the source: "recordings" = measured in them, "CAD" = the model of the parts,
    "controller" = regression on the logged references, "signature" = the comparison with session B, "chosen" = by us.
    ``lag``, ``noise``, ``force_bias``, ``moment_bias`` and ``tare`` vary in sessions recorded on the robot, not in
    OpenHRP's and those of two arms; with ``sensor``, all but ``lag`` do.
    """

    nominal_share: float = 0.5  # of the trials without a fault; chosen
    faults: tuple[str, ...] = (  # equally likely among the others; chosen
        "pose", "jamming", "wedging", "missing-tab", "moved-part", "early-stop",
    )  # fmt: skip
    longest: float | None = None  # s, longest duration of a trial; None = the preset's own timeout
    # s, for which recording continues after the planned end of the trial, the robot keeping still, as by a logger that
    # knows nothing of a fault; None = it ends when the task is done or the robot has stopped
    logs_on: float | None = None
    physical: Physical = ()  # nominal parameters of parts and sensor that replace the preset's, by name
    sensor: str | None = None  # session whose wrist sensor is used, noise and drift included; None = the preset's

    shift: Range = (-5e-4, 5e-4)  # m, hand in x and y without a fault: seated in A, B, OpenHRP
    turn: Range = (-0.005, 0.005)  # rad, hand about the vertical without a fault; chosen
    stiffness: Range = (0.85, 1.15)  # factor per tab: release force 11-18 N about its mean; recordings
    overlap: Range = (0.93, 1.07)  # factor on each tab's hook overlap: 0.06 mm of moulding; chosen
    friction: Range = (0.8, 1.2)  # factor; chosen
    mount: Range = (0.85, 1.15)  # factor: contact stiffness 5-8 N/mm; signature
    gain: Range = (0.95, 1.05)  # factor, force and moment law each; chosen
    goal: Range = (0.97, 1.03)  # factor, force and moment set-points each; controller
    speed: Range = (0.97, 1.03)  # factor of the approach; chosen, below B's against C's (7-15 mm/s)
    lag: tuple[int, int] = (5, 5)  # control periods from command to servo, both included; recordings: 20-25 ms
    noise: Range = (0.8, 1.25)  # factor on the sensor's noise; recordings give one value per session
    force_bias: Range = (-0.3, 0.3)  # N, drift since the tare, each axis: <= 0.4 N; recordings
    moment_bias: Range = (-0.02, 0.02)  # Nm, likewise; session C's My in free space is -0.045; recordings
    tare: Range = (0.97, 1.0)  # share of the tool's weight that the tare removes; chosen
    mating: Range | None = None  # s, recorded after mating begins; None = the preset's own time

    fault_x: Range = (0.0, 0.020)  # m, pose fault; recordings: 0-19.7 mm
    fault_y: Range = (-0.0105, 0.0105)  # m, pose fault; recordings: +-10.5 mm
    fault_roll: Range = (-0.5235, 0.5235)  # rad, pose fault; recordings: +-30 degrees
    jam_friction: Range = (3.0, 5.0)  # factor: a rough hook; alone it creeps past its lip in time; chosen
    jam_overlap: Range = (1.65e-3, 1.85e-3)  # m, each hook: nearly the tip's radius, which no tab passes; chosen
    wedge_roll: Range = (0.09, 0.20)  # rad, either sign: more than the slots' play allows; chosen
    wedge_tilt: Range = (0.05, 0.12)  # rad, either sign, of the hand at contact; chosen
    # factor on the hook overlap of the tab of a missing-tab fault: negative = broken off, 0 to 1 = worn; chosen
    missing_overlap: Range = (-1.0, -1.0)
    moved_by: Range = (0.021, 0.040)  # m, part along x or y: beyond every pose fault; chosen
    stop_at: Range = (0.3, 0.9)  # share of the time to mating after which the robot stops; chosen

    def __post_init__(self) -> None:
        with_tuples(self)


# Limits of a user's ranges: no trial could be simulated beyond them.
LIMITS: dict[str, Range] = {
    "shift": (-0.1, 0.1), "turn": (-1.0, 1.0), "stiffness": (0.05, 20.0), "overlap": (0.05, 2.0),
    "friction": (0.01, 20.0), "mount": (0.05, 20.0), "gain": (0.0, 10.0), "goal": (0.0, 10.0), "speed": (0.05, 20.0),
    "noise": (0.0, 100.0), "force_bias": (-50.0, 50.0), "moment_bias": (-5.0, 5.0), "tare": (0.0, 1.0),
    "mating": (0.1, 600.0), "fault_x": (-0.1, 0.1), "fault_y": (-0.1, 0.1), "fault_roll": (-1.0, 1.0),
    "jam_friction": (0.01, 20.0), "jam_overlap": (1e-5, 1.99e-3),
    "wedge_roll": (0.0, 1.0), "wedge_tilt": (0.0, 0.5), "missing_overlap": (-1.0, 1.0), "moved_by": (0.0, 0.1),
    "stop_at": (0.01, 3.0),
}  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """The fault that a trial was given, whether or not it failed."""

    kind: str  # "none" or one of FAULTS
    failure_type: str  # sign pattern of a pose fault or a moved part, such as "+x-y+r"; else ""
    deviation: Float64[np.ndarray, " 3"]  # m, m, rad: hand from part in x, y, about the vertical


@dataclass
class _Faulty:
    """Changes that faults make to trials; factors unless a unit is given."""

    hand: Float64[np.ndarray, "trial 3"]  # m, m, rad; NaN = as drawn for all trials
    part: Float64[np.ndarray, "trial 2"]  # m
    tilt: Float64[np.ndarray, " trial"]  # rad
    overlap: Float64[np.ndarray, "trial 4"]  # negative = missing
    friction: Float64[np.ndarray, " trial"]
    hooks: Float64[np.ndarray, "trial 4"]  # m, overlaps in place of the drawn ones; NaN = those
    stop: Float64[np.ndarray, " trial"]  # share of the time to mating; infinite = it does not stop
    failure_type: list[str]

    @classmethod
    def none(cls, trials: int) -> _Faulty:
        """Trials without a fault."""
        zero, one, nan = (partial(np.full, fill_value=value) for value in (0.0, 1.0, np.nan))
        return cls(
            nan((trials, 3)), zero((trials, 2)), zero(trials), one((trials, 4)), one(trials), nan((trials, 4)),
            np.full(trials, np.inf), [""] * trials,
        )  # fmt: skip


_Numbers = dict[str, Float64[np.ndarray, "trial count"]]  # by name of their range
# What is drawn for every trial, in this order: range and count of numbers.
_DRAWN = (
    ("speed", 1), ("gain", 2), ("goal", 2), ("noise", 1), ("force_bias", 3), ("moment_bias", 3), ("tare", 1),
    ("stiffness", 4), ("mount", 1), ("shift", 2), ("turn", 1), ("overlap", 4), ("friction", 1),
)  # fmt: skip


def check_common(nominal_share: Any, longest: Any, lag: Any) -> None:
    """Check the options that the distributions of all assemblies have; arguments as of :class:`DomainRandomization`.

    Raises:
        InputError: an invalid share, time or lag.
    """
    if not finite(nominal_share) or not 0.0 <= nominal_share <= 1.0:
        raise InputError(f"The nominal share is {nominal_share}; expected 0 to 1.")
    if longest is not None and not (finite(longest) and longest > 0):
        raise InputError(f"The longest trial is {longest} s; expected a positive number of seconds.")
    if not finite(lag, 2) or np.asarray(lag).dtype.kind == "f" or not 0 <= lag[0] <= lag[1] <= LONGEST_DELAY - 2:
        raise InputError(f"The lag is {lag}; expected two increasing counts from 0 to {LONGEST_DELAY - 2}.")


@lru_cache  # called for every batch
def check(spec: DomainRandomization) -> None:
    """Check distributions before trials are drawn from them.

    Raises:
        InputError: an invalid share, range, lag or time, or an unknown fault.
    """
    check_common(spec.nominal_share, spec.longest, spec.lag)
    if not spec.faults or not set(spec.faults) <= set(FAULTS):
        raise InputError(f"The faults are {list(spec.faults)}; expected some of {', '.join(FAULTS)}.")
    if spec.logs_on is not None and not 0.0 <= spec.logs_on <= 600.0:
        raise InputError(f"The logger goes on for {spec.logs_on} s; expected 0 to 600 s.")
    overrides.check(spec.physical)
    if spec.sensor is not None:
        real_sensor(spec.sensor)
    for name, (least, most) in LIMITS.items():
        if getattr(spec, name) is None:
            continue
        low, high = two_numbers(name, getattr(spec, name))
        if not least <= low <= high <= most:
            raise InputError(f"The range of {name} is {low} to {high}; expected it within {least} to {most}.")


def real_sensor(session: str) -> SensorParams:
    """The wrist sensor of a session recorded on the robot.

    Raises:
        InputError: there is none.
    """
    sensors = {name: preset.sensor for name, preset in ONE_ARM.items() if preset.real}
    if session not in sensors:
        raise InputError(f"There is no sensor of session {session!r}; expected one of {', '.join(sensors)}.")
    return sensors[session]


def sample(preset: SessionPreset, seed: int, index: int, spec: DomainRandomization) -> tuple[TrialParams, Fault]:
    """One trial of a preset, of the right arm: :func:`sample_batch` of one index, without the batch axis."""
    params, (fault,) = sample_batch(preset, seed, (index,), spec)
    return jax.tree.map(lambda leaf: leaf[0], params), fault


def sample_batch(
    preset: SessionPreset,
    seed: int,
    indices: Sequence[int],
    spec: DomainRandomization,
    mating_time: Float64[np.ndarray, " trial"] | None = None,
) -> tuple[TrialParams, list[Fault]]:
    """Trials of a preset, of the right arm.

    Args:
        preset: nominal values.
        seed: seed of the whole set, 0 to 2^64 - 1; all presets have the same random numbers.
        indices: numbers of the trials within the set, >= 0.
        spec: the distributions.
        mating_time: time recorded after mating begins, s; None = that of ``spec``.

    Returns:
        their parameters ``[trial, ...]`` and their faults; a trial's do not depend on the others.

    Raises:
        InputError: negative seed or index, or impossible distributions.
    """
    check(spec)
    uniform = np.empty((len(indices), sum(count for _, count in _DRAWN)))
    lag, key, mating = np.ones(len(indices), np.int32), np.empty((len(indices), 2), np.uint32), np.empty(len(indices))
    faulty, kinds = _Faulty.none(len(indices)), list[str]()
    for row, rng in enumerate(_streams(seed, indices)):
        rng.random(out=uniform[row])
        key[row] = rng.integers(0, 2**32, 2, dtype=np.uint32)
        nominal = rng.random() < spec.nominal_share
        kinds.append("none" if nominal else spec.faults[int(rng.integers(len(spec.faults)))])
        if not nominal:
            FAULTS[kinds[-1]](faulty, row, spec, rng)
        # the last draws, so that the others do not depend on them
        mating[row] = rng.uniform(*spec.mating or (0.0, 0.0))
        if preset.real:
            lag[row] = rng.integers(spec.lag[0], spec.lag[1], endpoint=True)
    drawn = _scaled(uniform, spec)
    hand = np.where(np.isnan(faulty.hand), np.concatenate([drawn["shift"], drawn["turn"]], axis=1), faulty.hand)
    task, sensor, part = repeated(_nominal(preset, spec), len(indices))
    if mating_time is None and spec.mating is not None:
        mating_time = mating
    if mating_time is not None:  # before the time limits, which include it: no duration may reveal a fault
        task = replace(task, mating_time=mating_time)
    task, part = _task(preset, task, drawn, hand, faulty, spec), _parts(part, drawn, faulty)
    if preset.real or spec.sensor is not None:
        sensor = _measured(sensor, drawn)
    parts.check(part)
    away = hand - horizontal(faulty.part)
    faults = [Fault(*one) for one in zip(kinds, faulty.failure_type, away, strict=True)]
    return TrialParams(task, sensor, part, lag, key), faults


def stream(seed: int, index: int, branch: int = 0) -> np.random.Generator:
    """A trial's random numbers; branches of one trial never overlap.

    Raises:
        InputError: negative or too large seed or index.
    """
    return next(_streams(seed, (index,), branch))


def _streams(seed: int, indices: Sequence[int], branch: int = 0) -> Iterator[np.random.Generator]:
    """:func:`stream` of each trial: one generator whose state is set, since making one takes longer than its draws."""
    if not isinstance(seed, int | np.integer) or not 0 <= seed < 2**64:
        raise InputError(f"The seed is {seed!r}; expected a whole number, 0 to 2^64 - 1.")
    bits = np.random.Philox(key=seed)
    rng, state = np.random.Generator(bits), bits.state  # its buffer is empty
    for index in indices:
        if not 0 <= index < 2**63:
            raise InputError(f"The trial's index is {index}; expected 0 or more.")
        state["state"]["counter"] = np.array([0, 0, branch, index], np.uint64)
        bits.state = state
        yield rng


def _scaled(uniform: Float64[np.ndarray, "trial number"], spec: DomainRandomization) -> _Numbers:
    """Numbers of 0 to 1 in their ranges, by name ``[trial, count]``."""
    ends = np.cumsum([count for _, count in _DRAWN])[:-1]
    spans = {name: getattr(spec, name) for name, _ in _DRAWN}
    columns = np.split(uniform, ends, axis=1)
    return {name: low + (high - low) * one for (name, (low, high)), one in zip(spans.items(), columns, strict=True)}


def _nominal(preset: SessionPreset, spec: DomainRandomization) -> tuple[TaskParams, SensorParams, PartParams]:
    """Controller, sensor and parts before anything varies."""
    sensor = preset.sensor if spec.sensor is None else real_sensor(spec.sensor)
    sensor = overrides.apply_overrides(sensor, "sensor", spec.physical)
    return preset.task, sensor, overrides.apply_overrides(preset.parts, "parts", spec.physical)


def _measured(sensor: SensorParams, drawn: _Numbers) -> SensorParams:
    """Sensors whose noise, bias and tare differ."""
    bias = np.concatenate([drawn["force_bias"], drawn["moment_bias"]], axis=1)
    noise, tared = sensor.noise * drawn["noise"], sensor.tared * drawn["tare"][:, 0]
    return replace(sensor, noise=noise, bias=sensor.bias + bias, tared=tared)


def _task(
    preset: SessionPreset,
    task: TaskParams,
    drawn: _Numbers,
    hand: Any,
    faulty: _Faulty,
    spec: DomainRandomization,
) -> TaskParams:
    """The tasks with the hand's deviation in both waypoints, as the recorded failures had it, and their time limits."""
    speed, gain, goal = drawn["speed"], drawn["gain"], drawn["goal"]
    way_time = task.way_time / speed
    mating_begins = way_time[:, -1] + preset.mating_begins - float(preset.task.way_time[-1])
    stop, rest, timeout = faulty.stop * mating_begins, spec.logs_on or 0.0, task.timeout
    if spec.logs_on is None:
        timeout = np.minimum(timeout, stop)
    else:
        ends = mating_begins + task.mating_time + rest
        timeout = np.where(np.isfinite(stop), np.minimum(timeout, ends), timeout)
        task = replace(task, stop=np.where(np.isfinite(stop), stop, task.stop))
    if spec.longest is not None:
        timeout = np.minimum(timeout, spec.longest)
    turned = np.stack([hand[:, 2], faulty.tilt], axis=1)
    return replace(
        task,
        way_time=way_time,
        contact_after=task.contact_after / speed[:, 0],
        force=task.force * goal[:, :1, None],
        moment=task.moment * goal[:, 1:, None],
        force_gain=task.force_gain * gain[:, 0],
        moment_gain=task.moment_gain * gain[:, 1:],
        way_position=task.way_position + _sum_of(hand[:, :2], preset.across),
        way_rpy=task.way_rpy + _sum_of(turned, preset.turns),
        timeout=timeout,
        rest=np.full(len(timeout), rest),
    )


def _sum_of(shares: Float64[np.ndarray, "trial 2"], vectors: Any) -> Float64[np.ndarray, "trial 1 3"]:
    """Two vectors in shares, for all waypoints."""
    return (shares[:, :1] * vectors[0] + shares[:, 1:] * vectors[1])[:, None]


def _parts(part: PartParams, drawn: _Numbers, faulty: _Faulty) -> PartParams:
    part = replace(
        part,
        tab_stiffness=part.tab_stiffness * drawn["stiffness"],
        mount_stiffness=part.mount_stiffness * drawn["mount"],
        friction=part.friction * (drawn["friction"][:, 0] * faulty.friction),
        position=part.position + horizontal(faulty.part),
    )
    return part.with_overlap(
        np.where(np.isnan(faulty.hooks), part.hook_overlap * (drawn["overlap"] * faulty.overlap), faulty.hooks)
    )


def _pose(faulty: _Faulty, row: int, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """The hand arrives beside or turned, in one to three directions."""
    weights = np.array(list(PATTERNS.values()), float)
    axes = list(PATTERNS)[int(rng.choice(len(weights), p=weights / weights.sum()))]
    for way, (axis, span) in enumerate(zip("xyr", (spec.fault_x, spec.fault_y, spec.fault_roll), strict=True)):
        value = rng.uniform(*span)
        if axis in axes:
            faulty.hand[row, way] = value
            faulty.failure_type[row] += ("+" if value >= 0 else "-") + axis


def _jamming(faulty: _Faulty, row: int, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """Rough hooks that reach so far under their lips that the tabs do not slide over them."""
    faulty.friction[row] *= rng.uniform(*spec.jam_friction)
    faulty.hooks[row] = rng.uniform(*spec.jam_overlap, 4)


def _wedging(faulty: _Faulty, row: int, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """The part is turned and tilted in the hand, a little more than the slots allow."""
    faulty.hand[row, 2] = rng.uniform(*spec.wedge_roll) * rng.choice((-1.0, 1.0))
    faulty.tilt[row] = rng.uniform(*spec.wedge_tilt) * rng.choice((-1.0, 1.0))


def _missing_tab(faulty: _Faulty, row: int, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """One tab has broken off or is worn; by convention of PartParams the overlap of a missing one is negative."""
    tab, (low, high) = int(rng.integers(len(TABS))), spec.missing_overlap
    # nothing is drawn where there is nothing to choose, so that later draws do not depend on this range
    faulty.overlap[row, tab] *= low if low == high else rng.uniform(low, high)


def _moved_part(faulty: _Faulty, row: int, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """The female part stands farther off than any pose fault, along x or along y."""
    axis = int(rng.integers(2))
    faulty.part[row, axis] = rng.uniform(*spec.moved_by) * rng.choice((-1.0, 1.0))
    # the hand deviates the other way
    faulty.failure_type[row] = ("-" if faulty.part[row, axis] > 0 else "+") + "xy"[axis]


def _early_stop(faulty: _Faulty, row: int, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """The robot stops before mating begins."""
    faulty.stop[row] = rng.uniform(*spec.stop_at)


FAULTS: dict[str, Callable[[_Faulty, int, DomainRandomization, np.random.Generator], None]] = {
    "pose": _pose, "jamming": _jamming, "wedging": _wedging, "missing-tab": _missing_tab, "moved-part": _moved_part,
    "early-stop": _early_stop,
}  # fmt: skip
