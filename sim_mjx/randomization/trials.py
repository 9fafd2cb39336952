"""Randomised trials and faults: a seed and an index determine a trial, whatever batch it is simulated in.

Every trial has its own Philox stream: the seed is the key, the index the highest word of the counter, so that
streams never overlap. Deviations are those of the hand from the part, as in the names of the recorded failures:
+x = the hand is too far forward, +y too far left, +r turned to the left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float64

from rcbht_jax.errors import InputError
from sim_mjx.assembly import parts
from sim_mjx.assembly.parts import TABS, PartParams
from sim_mjx.assembly.rollout import TrialParams
from sim_mjx.assembly.sensor import LONGEST_DELAY, SensorParams
from sim_mjx.assembly.task import TaskParams
from sim_mjx.presets import ONE_ARM
from sim_mjx.presets.session import Range, SessionPreset
from sim_mjx.randomization import overrides
from sim_mjx.randomization.overrides import Physical

# How often the recorded failures deviate in which directions.
PATTERNS = {"x": 31, "y": 44, "r": 55, "xy": 59, "xr": 58, "yr": 72, "xyr": 79}


@dataclass(frozen=True)
class DomainRandomization:
    """What varies between trials; ranges are uniform distributions (lowest, highest).

    The end of each comment is the source: "recordings" = measured in them, "CAD" = the model of the parts,
    "controller" = regression on the logged references, "signature" = the comparison with session B, "chosen" = ours.
    """

    nominal_share: float = 0.5  # of the trials without a fault; chosen
    faults: tuple[str, ...] = (  # equally likely among the others; chosen
        "pose", "jamming", "wedging", "missing-tab", "moved-part", "early-stop",
    )  # fmt: skip
    longest: float | None = None  # s, cuts every trial; None = the preset's own timeout
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


# What a user's ranges must keep within: no trial could be simulated beyond.
LIMITS: dict[str, Range] = {
    "shift": (-0.1, 0.1), "turn": (-1.0, 1.0), "stiffness": (0.05, 20.0), "overlap": (0.05, 2.0),
    "friction": (0.01, 20.0), "mount": (0.05, 20.0), "gain": (0.0, 10.0), "goal": (0.0, 10.0), "speed": (0.05, 20.0),
    "noise": (0.0, 100.0), "force_bias": (-50.0, 50.0), "moment_bias": (-5.0, 5.0), "tare": (0.0, 1.0),
    "mating": (0.1, 600.0), "fault_x": (-0.1, 0.1), "fault_y": (-0.1, 0.1), "fault_roll": (-1.0, 1.0),
    "jam_friction": (0.01, 20.0), "jam_overlap": (1e-5, 1.99e-3),
    "wedge_roll": (0.0, 1.0), "wedge_tilt": (0.0, 0.5), "missing_overlap": (-1.0, 1.0), "moved_by": (0.0, 0.1),
    "stop_at": (0.01, 1.0),
}  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """The fault that a trial was given, whether or not it failed."""

    kind: str  # "none" or one of FAULTS
    failure_type: str  # sign pattern of a pose fault or a moved part, such as "+x-y+r"; else ""
    deviation: Float64[np.ndarray, " 3"]  # m, m, rad: hand from part in x, y, about the vertical


@dataclass
class _Values:
    """Drawn numbers of one trial, before they become parameters; factors unless a unit is given."""

    hand: Float64[np.ndarray, " 3"]  # m, m, rad
    part: Float64[np.ndarray, " 2"]  # m
    tilt: float  # rad
    overlap: Float64[np.ndarray, " 4"]  # negative = missing
    friction: float
    hooks: Float64[np.ndarray, " 4"] | None = None  # m, overlaps in place of the nominal ones
    stop: float | None = None  # share of the time to mating
    failure_type: str = ""


def check_common(nominal_share: float, longest: float | None, lag: tuple[int, int]) -> None:
    """Refuse what no distribution of any assembly can have; arguments as of :class:`DomainRandomization`.

    Raises:
        InputError: a share, time or lag is not one.
    """
    if not 0.0 <= nominal_share <= 1.0:
        raise InputError(f"The nominal share is {nominal_share}; expected 0 to 1.")
    if longest is not None and not 0.0 < longest < np.inf:
        raise InputError(f"The longest trial is {longest} s; expected a positive number of seconds.")
    if not 0 <= lag[0] <= lag[1] <= LONGEST_DELAY - 2:
        raise InputError(f"The lag is {lag}; expected two increasing counts from 0 to {LONGEST_DELAY - 2}.")


@lru_cache  # every trial asks
def check(spec: DomainRandomization) -> None:
    """Refuse distributions that no trial could be drawn from.

    Raises:
        InputError: a share, range, lag, fault or time is not one.
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
        low, high = getattr(spec, name)
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
    """One trial of a preset, of the right arm.

    Args:
        preset: nominal values.
        seed: of the whole set, 0 to 2^64 - 1.
        index: of the trial within the set, >= 0.
        spec: the distributions.

    Returns:
        its parameters (a single trial: leaves have no batch axis) and its fault.

    Raises:
        InputError: negative seed or index, or impossible distributions.
    """
    check(spec)
    rng = stream(seed, index)
    task, sensor, part = _nominal(preset, spec, rng)
    values = _Values(
        hand=np.array([_draw(rng, spec.shift), _draw(rng, spec.shift), _draw(rng, spec.turn)]),
        part=np.zeros(2),
        tilt=0.0,
        overlap=_draw(rng, spec.overlap, 4),
        friction=float(_draw(rng, spec.friction)),
    )
    lag = int(rng.integers(spec.lag[0], spec.lag[1], endpoint=True)) if preset.real else 1
    key = rng.integers(0, 2**32, 2, dtype=np.uint32)
    kind = "none" if rng.random() < spec.nominal_share else spec.faults[int(rng.integers(len(spec.faults)))]
    if kind != "none":
        FAULTS[kind](values, spec, rng)
    if spec.mating is not None:  # the last draw, so that the others do not depend on it
        task = replace(task, mating_time=np.asarray(_draw(rng, spec.mating)))
    params = TrialParams(
        task=_with_task(preset, task, values, spec),
        sensor=sensor,
        parts=_with_parts(part, values),
        command_delay=np.array(lag, np.int32),
        seed=key,
    )
    parts.check(params.parts)
    return params, Fault(kind, values.failure_type, values.hand - [*values.part, 0.0])


def stream(seed: int, index: int, branch: int = 0) -> np.random.Generator:
    """A trial's random numbers; branches of one trial never overlap.

    Raises:
        InputError: negative or too large seed or index.
    """
    if not 0 <= seed < 2**64:
        raise InputError(f"The seed is {seed}; expected 0 to 2^64 - 1.")
    if not 0 <= index < 2**63:
        raise InputError(f"The trial's index is {index}; expected 0 or more.")
    return np.random.Generator(np.random.Philox(key=seed, counter=(index << 192) + (branch << 128)))


def _draw(rng: np.random.Generator, span: Range, size: int | None = None) -> Any:
    return rng.uniform(span[0], span[1], size)


def _nominal(
    preset: SessionPreset, spec: DomainRandomization, rng: np.random.Generator
) -> tuple[TaskParams, SensorParams, PartParams]:
    """Controller, sensor and materials of the parts, which differ between any two trials."""
    task = preset.task
    speed, force_gain, moment_gain = _draw(rng, spec.speed), _draw(rng, spec.gain), _draw(rng, spec.gain)
    task = replace(
        task,
        way_time=task.way_time / speed,
        contact_after=task.contact_after / speed,
        force=task.force * _draw(rng, spec.goal),
        moment=task.moment * _draw(rng, spec.goal),
        force_gain=task.force_gain * force_gain,
        moment_gain=task.moment_gain * moment_gain,
    )
    noise, bias = _draw(rng, spec.noise), np.concatenate(
        [_draw(rng, spec.force_bias, 3), _draw(rng, spec.moment_bias, 3)]
    )  # fmt: skip
    tare = _draw(rng, spec.tare)
    sensor = preset.sensor if spec.sensor is None else real_sensor(spec.sensor)
    sensor = overrides.apply_overrides(sensor, "sensor", spec.physical)
    if preset.real or spec.sensor is not None:
        tared = np.asarray(sensor.tared * tare)
        sensor = replace(sensor, noise=sensor.noise * noise, bias=sensor.bias + bias, tared=tared)
    part = overrides.apply_overrides(preset.parts, "parts", spec.physical)
    part = replace(
        part,
        tab_stiffness=part.tab_stiffness * _draw(rng, spec.stiffness, 4),
        mount_stiffness=part.mount_stiffness * _draw(rng, spec.mount),
    )
    return task, sensor, part


def _with_task(preset: SessionPreset, task: TaskParams, values: _Values, spec: DomainRandomization) -> TaskParams:
    """The task with the hand's deviation in both waypoints, as the recorded failures had it, and its time limits."""
    mating_begins = float(task.way_time[-1]) + preset.mating_begins - float(preset.task.way_time[-1])
    stop = None if values.stop is None else values.stop * mating_begins
    rest, timeout = spec.logs_on or 0.0, float(task.timeout)
    if stop is not None and spec.logs_on is None:
        timeout = min(timeout, stop)
    elif stop is not None:
        timeout = min(timeout, mating_begins + float(task.mating_time) + rest)
        task = replace(task, stop=np.array(stop))
    if spec.longest is not None:
        timeout = min(timeout, spec.longest)
    return replace(
        task,
        way_position=task.way_position + values.hand[:2] @ preset.across,
        way_rpy=task.way_rpy + np.array([values.hand[2], values.tilt]) @ preset.turns,
        timeout=np.array(timeout),
        rest=np.array(rest),
    )


def _with_parts(part: PartParams, values: _Values) -> PartParams:
    overlap = part.hook_overlap * values.overlap if values.hooks is None else values.hooks
    return replace(
        part.with_overlap(overlap),
        friction=np.asarray(part.friction * values.friction),
        position=part.position + np.array([*values.part, 0.0]),
    )


def _pose(values: _Values, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """The hand arrives beside or turned, in one to three directions."""
    weights = np.array(list(PATTERNS.values()), float)
    axes = list(PATTERNS)[int(rng.choice(len(weights), p=weights / weights.sum()))]
    for row, (axis, span) in enumerate(zip("xyr", (spec.fault_x, spec.fault_y, spec.fault_roll), strict=True)):
        value = _draw(rng, span)
        if axis in axes:
            values.hand[row] = value
            values.failure_type += ("+" if value >= 0 else "-") + axis


def _jamming(values: _Values, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """Rough hooks that reach so far under their lips that the tabs do not slide over them."""
    values.friction *= _draw(rng, spec.jam_friction)
    values.hooks = _draw(rng, spec.jam_overlap, 4)


def _wedging(values: _Values, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """The part is turned and tilted in the hand, a little more than the slots allow."""
    values.hand[2] = _draw(rng, spec.wedge_roll) * rng.choice((-1.0, 1.0))
    values.tilt = float(_draw(rng, spec.wedge_tilt) * rng.choice((-1.0, 1.0)))


def _missing_tab(values: _Values, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """One tab has broken off or is worn; by convention of PartParams the overlap of a missing one is negative."""
    tab, (low, high) = int(rng.integers(len(TABS))), spec.missing_overlap
    # nothing is drawn where there is nothing to choose, so that later draws do not depend on this range
    values.overlap[tab] *= low if low == high else _draw(rng, (low, high))


def _moved_part(values: _Values, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """The female part stands farther off than any pose fault, along x or along y."""
    axis = int(rng.integers(2))
    values.part[axis] = _draw(rng, spec.moved_by) * rng.choice((-1.0, 1.0))
    # the hand deviates the other way
    values.failure_type = ("-" if values.part[axis] > 0 else "+") + "xy"[axis]


def _early_stop(values: _Values, spec: DomainRandomization, rng: np.random.Generator) -> None:
    """The robot stops before mating begins."""
    values.stop = float(_draw(rng, spec.stop_at))


FAULTS: dict[str, Callable[[_Values, DomainRandomization, np.random.Generator], None]] = {
    "pose": _pose,
    "jamming": _jamming,
    "wedging": _wedging,
    "missing-tab": _missing_tab,
    "moved-part": _moved_part,
    "early-stop": _early_stop,
}
