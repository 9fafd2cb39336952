"""An assembly as data: two parts, phases with their motions and conditions, what counts as success, and faults.

Everything else follows for any robot: scene, controller loop, random trials, store with annotated phases. See
docs/howto/own_assembly.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int, UInt32

from rcbht_jax.types import Array
from sim_mjx.assemblies.fields import FieldWriter
from sim_mjx.assembly.sensor import SensorParams
from sim_mjx.controllers.moves import Sense, Twist

Range = tuple[float, float]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Mount:
    """The female part's mount; leaves of a batch have a leading trial axis."""

    position: Float[Array, "*batch 3"]  # m, shift from the nominal place, world
    turn: Float[Array, "*batch"]  # rad, about the vertical
    stiffness: Float[Array, "*batch 3"]  # N/m, x y z
    friction: Float[Array, "*batch"]  # sliding friction of all contacts


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Parts:
    """The parameters of a trial that the physics needs."""

    mount: Mount
    own: Any  # parameters of the assembly's own parts, a dataclass that is a pytree
    grip: Float[Array, "*batch 3"]  # rad, the male part's turn in the upright hand, a rotation vector in world axes


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AssemblyTrial:
    """All parameters of one trial; leaves of a batch have a leading trial axis."""

    task: Any  # parameters of the assembly's controller, a dataclass that is a pytree
    sensor: SensorParams
    parts: Parts
    hand: Float[Array, "*batch 3"]  # m, error of the mouth's assumed place
    home: Float[Array, "*batch joint"]  # rad, at time zero
    timeout: Float[Array, "*batch"]  # s, after which an unfinished trial ends
    command_delay: Int[Array, "*batch"]  # control periods between reference and servo
    seed: UInt32[Array, "*batch 2"]  # key of the sensor's noise


@dataclass(frozen=True, eq=False)
class Phase:
    """One phase of the controller: pure functions of what it senses and of the task's parameters."""

    name: str
    move: Callable[[Sense, Any], Twist]
    leave: Callable[[Sense, Any], Bool[Array, ""]]  # whether the next phase begins; after the last one the trial ends


@dataclass(frozen=True)
class Variation:
    """What varies between trials of any assembly; an assembly adds its own. Ranges are uniform (lowest, highest).

    All ranges are chosen: there are no recordings of these assemblies.
    """

    nominal_share: float = 0.5  # share of the trials without a fault
    faults: tuple[str, ...] = ()  # equally likely among the others; () = all faults of the assembly
    longest: float | None = None  # s, longest duration of a trial; None = the assembly's own timeout

    shift: Range = (-1e-3, 1e-3)  # m, error of the mouth's assumed place, x and y
    lean: Range = (-0.005, 0.005)  # rad, of the part in the hand, about x and y
    turn: Range = (-0.01, 0.01)  # rad, of the part in the hand, about the vertical
    friction: Range = (0.15, 0.25)  # of all contacts
    mount: Range = (0.8, 1.2)  # factor on the stiffness of the female part's mount
    gain: Range = (0.9, 1.1)  # factor on the controller's gains
    goal: Range = (0.95, 1.05)  # factor on the force that presses
    lag: tuple[int, int] = (1, 3)  # control periods from command to servo, both included
    noise: Range = (0.8, 1.25)  # factor on the sensor's noise
    force_bias: Range = (-0.2, 0.2)  # N, drift since the tare, each axis
    moment_bias: Range = (-0.01, 0.01)  # Nm, likewise

    moved_by: Range = (8e-3, 15e-3)  # m, fault moved-part: a shift that no search covers
    stop_at: Range = (0.5, 2.0)  # s, fault early-stop: when the robot and its logger stop


Draw = Callable[[Any, np.random.Generator], tuple[Any, Any]]  # variation -> parameters of task and parts of one trial
FaultOf = Callable[[AssemblyTrial, Any, np.random.Generator], AssemblyTrial]  # trial, variation -> the faulty trial


@dataclass(frozen=True, eq=False)
class Assembly:
    """A part pair with its controller, success, faults and randomisation.

    The parts' bodies have the same frame when the assembly is done right: x and y sideways, z against the insertion,
    origin in the middle of the mouth and at the male part's tip.
    """

    name: str
    male: Callable[[mujoco.MjSpec, mujoco.MjsBody], None]  # adds its geoms to the hand's body
    female: Callable[[mujoco.MjSpec, mujoco.MjsBody], None]  # adds its geoms to the mount, and the pairs that touch
    write: Callable[[FieldWriter, Any], None]  # writes a trial's parameters into the compiled model
    phases: tuple[Phase, ...]
    draw: Draw
    # pairs of geoms, of the male and of the female part; a trial succeeds when all are seated at its end
    marks: tuple[tuple[str, str], ...]
    seated: Callable[[Array], Array]  # male marks in their female marks' frames, m [..., mark, 3] -> [..., mark]
    faults: Mapping[str, FaultOf]
    variation: type[Variation] = Variation
    timeout: float = 20.0  # s
    reach: float = 0.10  # m, from the wrist to the tip
    start: float = 0.03  # m, of the tip above the mouth at time zero
    mount_stiffness: tuple[float, float, float] = (1e4, 1e4, 2e4)  # N/m, x y z
    substeps: int = 4  # physics steps per control period
    tabs: tuple[str, ...] = ()  # names of the marks if these are tabs and their lips; () = nothing snaps
