"""A recorded session as data: task, parts, sensor, and how its trials vary."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from sim_mjx.assembly.hooked_parts import HookedParams
from sim_mjx.assembly.parts import PartParams
from sim_mjx.assembly.scene import HOOK_SUBSTEPS, IMPRATIO, SUBSTEPS, Scene, hooked, one_arm
from sim_mjx.assembly.sensor import SensorParams
from sim_mjx.assembly.task import TaskParams

Vector = tuple[float, float, float]
Range = tuple[float, float]  # lowest and highest
Plane = Float64[np.ndarray, "2 3"]


@dataclass(frozen=True, kw_only=True)
class GateLimits:
    """Limits within which a simulation of a session is faithful; see ``sim_mjx.validation.gate``."""

    coverage: float  # least
    w1_over_sd: float  # largest
    dtw_over_sd: float  # largest
    auc: float  # largest, of the classifier that separates simulated from recorded
    spread: float = 2.0  # largest factor between the spreads of trials
    impact: float = 1.25  # of the first impact
    ring: float = 1.05  # of the ringing's frequency
    ring_peak: float = 1.15  # of its peak
    damping: float = 1.5  # of its damping
    fewer_snaps: float = 0.1  # by which the share of trials with a snap may be lower
    late: float = 0.3  # s, error of the median start of a state


@dataclass(frozen=True, kw_only=True)
class SessionPreset:
    """One session's constants, before anything varies; arrays are those of a single trial."""

    name: str
    task: TaskParams
    parts: PartParams  # effective values from a search on the recorded wrenches
    sensor: SensorParams
    mating_begins: float  # s, median of the recordings
    impratio: float = IMPRATIO  # of the scene; see ``sim_mjx.assembly.scene.one_arm``
    real: bool = True  # recorded on the robot, whose servos lag and sensor drifts; False = in OpenHRP
    across: Plane = field(default_factory=lambda: np.eye(3)[:2])  # world directions of the part's x and y
    # roll, pitch, yaw per radian of the hand's turn and of its tilt
    turns: Plane = field(default_factory=lambda: np.eye(3)[:2])

    # The recordings.
    recorded_as: str = ""  # session in the imported store
    last_joint_offset: float = 0.0  # rad, in the recorded angle of the last joint
    pose_lag: int = 1  # samples by which tool poses are recorded after the joint angles
    placements: tuple[tuple[int, int], ...] = ()  # mm, x and y of the hand, one trial each; () = always in one place
    off_seat: frozenset[tuple[int, int]] = frozenset()  # placements that ended off the seat
    repeats: dict[str, Range] = field(default_factory=dict)  # randomisation with which the session repeated itself

    # Limits of a faithful simulation; None = not checked.
    pose_limits: Range | None = None  # rms distance, mm, and turn, degrees, of computed and recorded tool poses
    gate: GateLimits | None = None  # what the simulated wrench must have in common with the recorded one

    def scene(self, finer: int = 1, **solver: int) -> Scene:
        """The scene of one arm with these parts and the session's ``impratio``.

        Args:
            finer: factor on the number of physics steps.
            solver: ``iterations`` and ``ls_iterations`` in place of the usual ones.
        """
        make, steps = (hooked, HOOK_SUBSTEPS) if isinstance(self.parts, HookedParams) else (one_arm, SUBSTEPS)
        return make(steps * finer, impratio=self.impratio, **solver)


def jr3_sensor(reference: Vector, bias: tuple[float, ...]) -> SensorParams:
    """The real wrist sensor.

    Args:
        reference: m, wrist frame, the point that moments refer to.
        bias: [6] N and Nm, read in free space since the tare.
    """
    return SensorParams(
        a=np.array(0.8541), b=np.array(0.2064), c=np.array(0.6555), d=np.array(0.2064),
        delay=np.array(11, np.int32),  # as the ringing after mating shows
        noise=np.array([0.105, 0.077, 0.065, 0.0017, 0.0042, 0.0038]),
        step=np.array([0.024, 0.008, 0.008, 0.0008, 0.0008, 0.0008]),
        bias=np.array(bias), tared=np.array(1.0), reference=np.array(reference),
    )  # fmt: skip


def openhrp_sensor(reference: Vector, tared: float = 0.0) -> SensorParams:
    """OpenHRP's sensor: 2.4 Hz, DC gain 1, hardly any noise; arguments as of :class:`SensorParams`."""
    return SensorParams(
        a=np.array(0.92681), b=np.array(0.073196), c=np.array(1.0), d=np.array(0.0), delay=np.array(1, np.int32),
        noise=np.full(6, 1e-5), step=np.full(6, 1e-6), bias=np.zeros(6), tared=np.array(tared),
        reference=np.array(reference),
    )  # fmt: skip
