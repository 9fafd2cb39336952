"""Random trials of any assembly: a seed and an index determine a trial, as in ``sim_mjx.randomization.trials``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any

import jax
import numpy as np

from rcbht_jax.errors import InputError
from sim_mjx.assemblies.assembly import Assembly, AssemblyTrial, FaultOf, Mount, Parts, Range, Variation
from sim_mjx.assemblies.checks import check_faulty, check_like
from sim_mjx.assemblies.scene import home
from sim_mjx.assembly.rollout import stack
from sim_mjx.assembly.sensor import SensorParams
from sim_mjx.own_code import own_code, two_numbers
from sim_mjx.randomization.trials import Fault, check_common, stream
from sim_mjx.robots.robot import Robot

NOISE = np.array([0.05, 0.05, 0.05, 0.002, 0.002, 0.002])  # N and Nm, standard deviation before the filter
STEP = np.array([0.01, 0.01, 0.01, 5e-4, 5e-4, 5e-4])  # N and Nm, quantisation
_NOT_NEGATIVE = ("friction", "mount", "gain", "noise")  # ranges of any assembly
KEPT = 0.5  # share of the low-pass filter's value that a control period keeps: 22 Hz


@dataclass(frozen=True, eq=False)
class Pairing:
    """An assembly on a robot, from which trials are drawn."""

    assembly: Assembly
    robot: Robot


def uniform(rng: np.random.Generator, span: Range, size: int | None = None) -> Any:
    """One or several random numbers from a range."""
    return np.asarray(rng.uniform(span[0], span[1], size))


def check(spec: Any, assembly: Assembly) -> None:
    """Raise an error for distributions from which no trial can be drawn.

    Raises:
        InputError: distributions of another assembly, an invalid share, range, lag or time, or an unknown fault.
    """
    has = {field.name for field in fields(spec)} if isinstance(spec, Variation) else set()
    if lacking := [field.name for field in fields(assembly.variation) if field.name not in has]:
        found, expected = type(spec).__name__, assembly.variation.__name__
        raise InputError(f"Distributions of {assembly.name} are a {expected}; this {found} has no {lacking[0]}.")
    check_common(spec.nominal_share, spec.longest, spec.lag)
    unknown = [name for name in spec.faults if name not in assembly.faults]
    if unknown:
        raise InputError(f"{assembly.name} has no fault {unknown[0]!r}; it has {', '.join(assembly.faults)}.")
    for field in fields(spec):
        value = getattr(spec, field.name)
        if _is_range(field.default) and not _is_range(value):  # an array is one, too
            value = two_numbers(field.name, value)
        if _is_range(value) and not -np.inf < value[0] <= value[1] < np.inf:
            raise InputError(f"The range of {field.name} is {value[0]} to {value[1]}; expected two increasing numbers.")
    for name in _NOT_NEGATIVE:
        if (low := getattr(spec, name)[0]) < 0:
            raise InputError(f"The range of {name} begins at {low}; expected zero or more.")
    if spec.stop_at[0] <= 0:
        raise InputError(f"The range of stop_at begins at {spec.stop_at[0]} s; expected more than zero.")


def _is_range(value: Any) -> bool:
    """Whether a value of a variation is a range: a tuple or list of two numbers; others are the assembly's business."""
    return isinstance(value, tuple | list) and len(value) == 2 and all(isinstance(one, Real) for one in value)


def drawn(assembly: Assembly, spec: Variation, rng: np.random.Generator, trial: str = "") -> tuple[Any, Any]:
    """Parameters of task and parts of one trial.

    Args:
        assembly, spec, rng: what draws, its distributions and random numbers. trial: words that name it.

    Raises:
        InputError: the assembly's ``draw`` fails, or gives no pair.
    """
    with own_code(what := f"draw of {assembly.name}{trial}"):
        found = assembly.draw(spec, rng)
    if not isinstance(found, tuple) or len(found) != 2:
        raise InputError(f"{what} gives a {type(found).__name__}; expected two: of task and of parts.")
    return found


def _sample(
    pairing: Pairing, seed: int, index: int, spec: Variation, pattern: tuple[Any, Any]
) -> tuple[AssemblyTrial, Fault]:
    """One trial of checked distributions; the names and shapes of its parameters must be those of ``pattern``."""
    assembly, robot, which = pairing.assembly, pairing.robot, f" in trial {index}"
    rng = stream(seed, index)
    hand = np.array([*uniform(rng, spec.shift, 2), 0.0])
    grip = np.array([*uniform(rng, spec.lean, 2), uniform(rng, spec.turn)])
    stiffness = np.array(assembly.mount_stiffness) * uniform(rng, spec.mount)
    mount = Mount(np.zeros(3), np.asarray(0.0), stiffness, uniform(rng, spec.friction))
    sensor = _sensor(spec, rng)
    least, most = spec.lag
    # a number is drawn from a range of one value, too, so that later draws do not depend on the range
    lag = least + min(int(rng.integers(max(most - least, 1), endpoint=True)), most - least)
    key = rng.integers(0, 2**32, 2, dtype=np.uint32)
    kinds = spec.faults or tuple(assembly.faults)
    nominal, number = rng.random() < spec.nominal_share, int(rng.integers(max(len(kinds), 1)))
    kind = "none" if nominal or not kinds else kinds[number]  # all other random numbers are those of a nominal trial
    task, own = drawn(assembly, spec, rng, which)
    for like, found in zip(pattern, (task, own), strict=True):
        check_like(f"draw of {assembly.name}{which}", like, found)
    task, own = (_typed(like, found) for like, found in zip(pattern, (task, own), strict=True))
    trial = AssemblyTrial(
        task=task, sensor=sensor, parts=Parts(mount, own, grip), hand=hand, home=np.array(home(assembly, robot)),
        timeout=np.asarray(assembly.timeout, np.float64), command_delay=np.array(lag, np.int32), seed=key,
    )  # fmt: skip
    if kind != "none":
        with own_code(what := f"the fault {kind!r} of {assembly.name}{which}"):
            faulty = assembly.faults[kind](trial, spec, rng)
        check_faulty(what, trial, faulty)
        trial = _typed(trial, faulty)
    if spec.longest is not None:
        trial = replace(trial, timeout=np.minimum(trial.timeout, spec.longest))
    shift = trial.hand[:2] - trial.parts.mount.position[:2]
    return trial, Fault(kind, "", np.array([*shift, trial.parts.grip[2] - trial.parts.mount.turn]))


def _typed(like: Any, found: Any) -> Any:
    """Checked numbers with the types of others: all shards of a store have the same."""
    types = [np.asarray(leaf).dtype for leaf in jax.tree.leaves(like)]
    leaves, kind = jax.tree.flatten(found)
    pairs = zip(leaves, types, strict=True)
    return jax.tree.unflatten(
        kind, [leaf if np.asarray(leaf).dtype == dtype else np.asarray(leaf, dtype) for leaf, dtype in pairs]
    )


def sample_batch(
    pairing: Pairing, seed: int, indices: Sequence[int], spec: Variation
) -> tuple[AssemblyTrial, list[Fault]]:
    """Several trials.

    Args:
        pairing: the assembly and its robot.
        seed: seed of the whole set, 0 to 2^64 - 1.
        indices: numbers of the trials within the set, >= 0.
        spec: the distributions.

    Returns:
        their parameters ``[trial, ...]`` and their faults; a trial's do not depend on the others.

    Raises:
        InputError: negative seed or index, no index, or impossible distributions.
    """
    assembly = pairing.assembly
    if not len(indices):
        raise InputError(f"There is no trial of {assembly.name} to draw; expected one index or more.")
    check(spec, assembly)
    pattern = drawn(assembly, spec, stream(0, 0))
    trials = [_sample(pairing, seed, index, spec, pattern) for index in indices]
    return stack([params for params, _ in trials]), [fault for _, fault in trials]


def _sensor(spec: Variation, rng: np.random.Generator) -> SensorParams:
    bias = np.concatenate([uniform(rng, spec.force_bias, 3), uniform(rng, spec.moment_bias, 3)])
    kept, new = np.asarray(KEPT), np.asarray(1 - KEPT)
    return SensorParams(
        a=kept, b=new, c=kept, d=new, delay=np.array(1, np.int32), noise=NOISE * uniform(rng, spec.noise), step=STEP,
        bias=bias, tared=np.asarray(1.0), reference=np.zeros(3),
    )  # fmt: skip


def moved_part(trial: AssemblyTrial, spec: Variation, rng: np.random.Generator) -> AssemblyTrial:
    """The female part stands where no search can find it."""
    angle, distance = uniform(rng, (0.0, 2 * np.pi)), uniform(rng, spec.moved_by)
    return with_mount(trial, position=np.array([np.cos(angle) * distance, np.sin(angle) * distance, 0.0]))


def early_stop(trial: AssemblyTrial, spec: Variation, rng: np.random.Generator) -> AssemblyTrial:
    """The robot and its logger stop before the parts are together."""
    return replace(trial, timeout=uniform(rng, spec.stop_at))


def with_mount(trial: AssemblyTrial, **values: Any) -> AssemblyTrial:
    """The trial with some values of its mount replaced."""
    return replace(trial, parts=replace(trial.parts, mount=replace(trial.parts.mount, **values)))


def with_own(trial: AssemblyTrial, **values: Any) -> AssemblyTrial:
    """The trial with some values of the assembly's own parts replaced."""
    return replace(trial, parts=replace(trial.parts, own=replace(trial.parts.own, **values)))


COMMON_FAULTS: Mapping[str, FaultOf] = {"moved-part": moved_part, "early-stop": early_stop}
