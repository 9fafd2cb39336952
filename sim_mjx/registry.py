"""Scenarios that can be simulated, by name, each with its scene and its trials.

A name is a preset of the recorded camera snap ("A", "two"), or ASSEMBLY@ROBOT: "peg-in-hole@panda". Either half may be
your own: FILE.py:NAME is the object NAME of a Python file, see docs/howto/own_assembly.md.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache, partial
from typing import Any

import jax

from rcbht_jax.errors import InputError
from sim_mjx.assemblies import ASSEMBLIES, Assembly, checks, draw, scene
from sim_mjx.assemblies.assembly import Mount
from sim_mjx.assembly.hooked_parts import HookedParams
from sim_mjx.assembly.parts import TABS
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.task import STATES
from sim_mjx.assembly.two_arm_scene import ARMS, two_arm
from sim_mjx.own_code import own_code
from sim_mjx.own_files import OwnFile, run_file
from sim_mjx.presets import DEFAULT, preset
from sim_mjx.presets.two_arm import TwoArmPreset
from sim_mjx.randomization import trials
from sim_mjx.randomization import two_arm as randomization_two_arm
from sim_mjx.randomization.trials import DomainRandomization, Fault
from sim_mjx.robots import ROBOTS, Robot

SNAP, HIRO = "camera-snap", "hiro"  # the recorded assembly and its robot, which have presets

# Stored parameters of a trial: their group ("" = none) and field.
PARAMETERS = (
    ("task", "force_gain"), ("task", "moment_gain"), ("task", "force"), ("task", "moment"), ("task", "way_time"),
    ("task", "way_position"), ("task", "way_rpy"), ("task", "mating_time"), ("task", "timeout"), ("task", "stop"),
    ("sensor", "noise"), ("sensor", "bias"), ("sensor", "tared"),
    ("parts", "tab_stiffness"), ("parts", "hook_overlap"), ("parts", "friction"), ("parts", "mount_stiffness"),
    ("parts", "position"), ("parts", "roll"),
)  # fmt: skip
HOOKED_PARAMETERS = (*PARAMETERS, ("parts", "hook_wear"), ("parts", "tab_cut"))
TWO_ARM_PARAMETERS = (
    *PARAMETERS, ("", "offset"), ("", "chatter"), ("hold", "force"), ("hold", "moment"),
    ("hold", "force_gain"), ("hold", "moment_gain"),
)  # fmt: skip


@dataclass(frozen=True)
class Scenario:
    """A preset with its scene, its logged quantities and the distribution of its trials."""

    preset: Any  # SessionPreset or Pairing, which ``sample_batch`` takes
    arms: tuple[str, ...]  # whose wrenches are logged, in this order
    scene: Callable[..., Scene]  # takes substeps, iterations, ls_iterations
    # of a preset, seed, indices and distributions
    sample_batch: Callable[[Any, int, Sequence[int], Any], tuple[Any, list[Fault]]]
    parameters: tuple[tuple[str, str], ...]  # what is stored of a trial: group and field
    assembly: str = SNAP
    robot: str = HIRO
    states: tuple[str, ...] = STATES  # whose starts a rollout reports
    spec: Callable[..., Any] = DomainRandomization  # distributions, by keyword
    tabs: tuple[str, ...] = TABS  # names of the tabs that pass lips, whose passes are stored; none = nothing snaps

    @property
    def recorded(self) -> bool:
        """Whether it is the assembly that was recorded, whose stores have its tracks and columns."""
        return self.assembly == SNAP

    def draw(self, seed: int, index: int, spec: Any) -> tuple[Any, Fault]:
        """Parameters of one trial, without a batch axis, and its fault."""
        params, (fault,) = self.draw_batch(seed, (index,), spec)
        return jax.tree.map(lambda leaf: leaf[0], params), fault

    def draw_batch(self, seed: int, indices: Sequence[int], spec: Any) -> tuple[Any, list[Fault]]:
        """Parameters and faults of trials; see ``sim_mjx.randomization.trials.sample_batch``."""
        return self.sample_batch(self.preset, seed, indices, spec)


def get_scenario(name: str) -> Scenario:
    """The scenario of a name.

    Raises:
        InputError: unknown preset, assembly or robot.

    >>> get_scenario("two").arms, get_scenario("peg-in-hole@panda").states
    (('R', 'L'), ('approach', 'search', 'insertion', 'rest'))
    """
    if halves := _halves(name):
        assembly, robot = halves
        if assembly != SNAP:
            return pair(named(assembly, ASSEMBLIES, Assembly, "assembly"), named(robot, ROBOTS, Robot, "robot"))
        if robot != HIRO:
            raise InputError(f"{SNAP} cannot use the robot {robot!r}; expected {HIRO!r}, or another assembly.")
        name = DEFAULT
    constants = preset(name)
    if isinstance(constants, TwoArmPreset):
        return Scenario(constants, ARMS, two_arm, randomization_two_arm.sample_batch, TWO_ARM_PARAMETERS)
    names = HOOKED_PARAMETERS if isinstance(constants.parts, HookedParams) else PARAMETERS
    return Scenario(constants, ("R",), constants.scene, trials.sample_batch, names)


def _halves(name: str) -> tuple[str, ...]:
    """Assembly and robot of ASSEMBLY@ROBOT, () of another name; a path before the "@" may have one itself."""
    found = re.fullmatch(r"(.*?\.py:[^@]+|[^@]*)@(.*)", name)
    return found.groups() if found else ()


@cache
def pair(assembly: Assembly, robot: Robot) -> Scenario:
    """The scenario of an assembly on a robot.

    Raises:
        InputError: the assembly is not what :mod:`sim_mjx.assemblies.checks` expects, or has impossible distributions.
    """
    if assembly.name == SNAP:
        raise InputError(f"The name {SNAP} is that of the recorded assembly; choose another.")
    checks.check_assembly(assembly)
    with own_code(f"The variation of {assembly.name}"):
        variation = assembly.variation()
    draw.check(variation, assembly)
    task, own = draw.drawn(assembly, variation, trials.stream(0, 0))
    checks.check_drawn(assembly, task, own)
    states = tuple(phase.name for phase in assembly.phases)
    names = [("task", field.name) for field in fields(task)] + [("parts.own", field.name) for field in fields(own)]
    names += [("parts.mount", field.name) for field in fields(Mount)]
    names += [("parts", "grip"), ("", "hand"), ("", "timeout"), ("sensor", "noise"), ("sensor", "bias")]
    return Scenario(
        draw.Pairing(assembly, robot), ("R",), partial(scene.scene, assembly, robot), draw.sample_batch, tuple(names),
        assembly.name, robot.name, states, assembly.variation, assembly.tabs,
    )  # fmt: skip


def named(name: str, known: dict[str, Any], kind: type, what: str) -> Any:
    """A known object by its name, or the object NAME of a file for "FILE.py:NAME".

    Raises:
        InputError: there is none of that name, or it has another type.
    """
    if name in known:
        return known[name]
    path, colon, attribute = name.rpartition(":")
    if not colon:
        names = [*known, SNAP] if what == "assembly" else list(known)
        raise InputError(f"There is no {what} {name!r}; expected one of {', '.join(names)}, or FILE.py:NAME.")
    found = getattr(run_file(path).module, attribute, None)
    if not isinstance(found, kind):
        raise InputError(f"{path} has no {what} named {attribute}.")
    return found


def own_files(name: str) -> list[OwnFile]:
    """The Python files in a name, whose content decides what is simulated.

    Raises:
        InputError: a file cannot be run.
    """
    return [run_file(half.rpartition(":")[0]) for half in _halves(name) if ":" in half]
