"""Checks of an assembly before anything is simulated: what its functions take and return, and its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rcbht_jax.errors import InputError
from sim_mjx.assemblies.assembly import Assembly, AssemblyTrial, Phase, Variation
from sim_mjx.assembly.rollout import as_float32
from sim_mjx.assembly.sensor import LONGEST_DELAY, required
from sim_mjx.controllers import Sense
from sim_mjx.own_code import finite, own_code


def check_assembly(assembly: Assembly) -> None:
    """Check what can be checked without a robot and without drawing a trial.

    Raises:
        InputError: a field of another kind, no phase or two of one name, no marks or tabs for some of them only, an
            impossible number, a fault of the name that trials without a fault have, or a ``seated`` that does not give
            one truth value for each mark.
    """
    _check_kinds(assembly)
    name, states = assembly.name, tuple(phase.name for phase in assembly.phases)
    for text in (name, *states, *assembly.faults, *assembly.tabs):
        if not text.strip() or not text.isprintable():
            raise InputError(f"{text!r} names the assembly, a phase, a fault or a tab of {name!r}; expected a word.")
    if len(set(states)) < max(len(states), 1):
        raise InputError(
            f"{name} has the phases {', '.join(states) or 'none'}; expected one or more of different names."
        )
    if not assembly.marks:
        raise InputError(f"{name} has no marks, by whose places success is decided; expected at least one pair.")
    if assembly.tabs and len(assembly.tabs) != len(assembly.marks):
        raise InputError(
            f"{name} names {len(assembly.tabs)} tabs and {len(assembly.marks)} marks; expected a tab for each mark, or "
            "none."
        )
    if "none" in assembly.faults:
        raise InputError(f"{name} has a fault named 'none', as trials without a fault are called; rename it.")
    _check_numbers(assembly)
    _check_seated(assembly)


def _check_kinds(assembly: Assembly) -> None:
    name, phases, faults, tabs = assembly.name, assembly.phases, assembly.faults, assembly.tabs
    marks, variation = assembly.marks, assembly.variation
    for field, expected, value, holds in (
        ("name", "a word", name, isinstance(name, str)),
        ("phases", "a tuple of Phase", phases, _all_are(phases, Phase)),
        ("faults", "a dict of functions by name", faults, isinstance(faults, Mapping) and _all_are([*faults], str)),
        ("marks", "a tuple of pairs of names", marks, _all_are(marks, tuple) and all(map(_is_pair, marks))),
        ("tabs", "a tuple of names", tabs, _all_are(tabs, str)),
        ("variation", "a class derived from Variation", variation, _is_variation(variation)),
    ):
        if not holds:
            raise InputError(f"{field} of the assembly {name} is {value!r}; expected {expected}.")


def _all_are(values: Any, kind: type) -> bool:
    return isinstance(values, tuple | list) and all(isinstance(value, kind) for value in values)


def _is_pair(values: Any) -> bool:
    return len(values) == 2 and _all_are(values, str)


def _is_variation(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Variation)


def _check_numbers(assembly: Assembly) -> None:
    name, substeps, stiffness = assembly.name, assembly.substeps, assembly.mount_stiffness
    if not finite(assembly.timeout) or assembly.timeout <= 0:
        raise InputError(f"The timeout of {name} is {assembly.timeout} s; expected a positive, finite number.")
    for what in ("reach", "start"):
        if not finite(value := getattr(assembly, what)):
            raise InputError(f"The {what} of {name} is {value} m; expected a finite number.")
    if not isinstance(substeps, int | np.integer) or substeps < 1:
        raise InputError(f"The substeps of {name} are {substeps}; expected a count of 1 or more.")
    if not finite(stiffness, 3) or min(stiffness) < 0:
        raise InputError(f"The mount_stiffness of {name} is {stiffness}; expected three numbers, zero or more each.")


def _check_seated(assembly: Assembly) -> None:
    marks = len(assembly.marks)
    for lead in ((marks + 1,), ()):  # a batch, and one trial
        with own_code(f"seated of {assembly.name}"):
            found = np.asarray(assembly.seated(np.zeros((*lead, marks, 3))))
        if found.shape != (*lead, marks) or found.dtype != np.bool_:
            raise InputError(
                f"seated of {assembly.name} gives {found.dtype} {list(found.shape)} for places "
                f"{[*lead, marks, 3]}; expected bool {[*lead, marks]}, one for each mark."
            )


def check_drawn(assembly: Assembly, task: Any, own: Any) -> None:
    """Check the parameters that an assembly draws, and its phases with them.

    Raises:
        InputError: the parameters are no dataclasses that JAX knows, or hold something else than arrays, or NaN; or a
            phase's motion is no twist, or its condition no truth value.
    """
    for what, values in (("task", task), ("parts", own)):
        kind = type(values).__name__
        if not is_dataclass(values) or isinstance(values, type):
            raise InputError(f"draw of {assembly.name} gives a {kind} for the {what}; expected a dataclass.")
        if any(leaf is values for leaf in jax.tree.leaves(values)):
            raise InputError(f"{kind} of {assembly.name} is unknown to JAX; add @jax.tree_util.register_dataclass.")
        for field in fields(values):  # which are stored
            value = getattr(values, field.name)
            if isinstance(value, tuple | list) or np.asarray(value).dtype.kind not in "biuf":
                found = type(value).__name__
                raise InputError(f"{field.name} of {kind} of {assembly.name} is of type {found}; expected an array.")
        check_like(f"draw of {assembly.name}", values, values)
    for phase in assembly.phases:
        _check_phase(assembly, phase, as_float32(task))


def _check_phase(assembly: Assembly, phase: Phase, task: Any) -> None:
    number, vector = jnp.float32(0.0), jnp.zeros(3, jnp.float32)
    sense, where = Sense(number, *[vector] * 7), f"the phase {phase.name!r} of {assembly.name}"
    with own_code(f"move of {where}"):
        twist = jax.eval_shape(phase.move, sense, task)
    with own_code(f"leave of {where}"):
        leaves = jax.eval_shape(phase.leave, sense, task)
    for what, found, shape, kind in (("move", twist, (6,), "f"), ("leave", leaves, (), "b")):
        if getattr(found, "shape", None) != shape or found.dtype.kind != kind:
            text = f"{found.dtype} {list(found.shape)}" if hasattr(found, "shape") else type(found).__name__
            expected = "a twist, float32 [6]" if what == "move" else "one bool"
            raise InputError(f"{what} of {where} gives {text}; expected {expected}.")


def check_like(what: str, like: Any, found: Any) -> None:
    """Check the numbers of a trial against those of another one: a batch, and a store, has one shape for all.

    Args:
        what: where they come from, as a sentence begins.
        like: a pytree. found: another one.

    Raises:
        InputError: an array has another shape, holds NaN or no numbers, or fractions where whole numbers are expected.
    """
    before, after = (dict(jax.tree_util.tree_leaves_with_path(tree)) for tree in (like, found))
    for path in before | after:
        name = jax.tree_util.keystr(path).lstrip(".")
        if path not in before or path not in after:
            raise InputError(f"{what} does not always give {name}; expected the same parameters in every trial.")
        old, new = before[path], after[path]
        if np.shape(old) != np.shape(new):
            shapes = [list(np.shape(one)) for one in (old, new)]
            raise InputError(f"{what} changes the shape of {name} from {shapes[0]} to {shapes[1]}.")
        if np.asarray(new).dtype.kind not in "biuf" or np.isnan(new).any():
            raise InputError(f"{what} sets {name} to {new}; expected numbers.")
        types = [np.asarray(one).dtype for one in (old, new)]
        if not np.can_cast(types[1], types[0], "same_kind"):
            raise InputError(
                f"{what} changes the type of {name} from {types[0]} to {types[1]}; expected one type in every trial, "
                "such as 0.0, not 0, of a value that is not always whole."
            )


def check_faulty(what: str, nominal: AssemblyTrial, faulty: Any) -> None:
    """Check the trial that a fault gives.

    Args:
        what: the fault, as a sentence begins.
        nominal: the trial before. faulty: what the fault gave.

    Raises:
        InputError: it is no trial, its arrays have other shapes or hold NaN, or its timeout, delay or sensor is
            impossible.
    """
    if not isinstance(faulty, AssemblyTrial):
        raise InputError(f"{what} gives a {type(faulty).__name__}; expected the changed trial.")
    delay, most = faulty.command_delay, LONGEST_DELAY - 2
    if not finite(faulty.timeout) or faulty.timeout <= 0:
        raise InputError(f"{what} sets a timeout of {faulty.timeout} s; expected a positive, finite number.")
    if not finite(delay) or np.asarray(delay).dtype.kind == "f" or not 0 <= delay <= most:
        raise InputError(f"{what} sets a delay of {delay} periods; expected a whole number, 0 to {most}.")
    check_like(what, nominal, faulty)
    for field in fields(faulty.sensor):
        value = getattr(faulty.sensor, field.name)
        if wanted := required(field.name, value):
            raise InputError(f"{what} sets sensor.{field.name} to {value}; expected {wanted}.")
