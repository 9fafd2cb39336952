"""What can be simulated by name: the one-arm sessions and the two-arm task, each with its scene and its trials."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from sim_mjx.assembly.rollout import stack
from sim_mjx.assembly.scene import Scene, one_arm
from sim_mjx.assembly.two_arm_scene import ARMS, two_arm
from sim_mjx.presets import preset
from sim_mjx.presets.two_arm import TwoArmPreset
from sim_mjx.randomization import trials
from sim_mjx.randomization import two_arm as randomization_two_arm
from sim_mjx.randomization.trials import DomainRandomization, Fault

# Stored parameters of a trial: their group ("" = none) and field.
PARAMETERS = (
    ("task", "force_gain"), ("task", "moment_gain"), ("task", "force"), ("task", "moment"), ("task", "way_time"),
    ("task", "way_position"), ("task", "way_rpy"), ("task", "timeout"), ("task", "stop"),
    ("sensor", "noise"), ("sensor", "bias"), ("sensor", "tared"),
    ("parts", "tab_stiffness"), ("parts", "hook_overlap"), ("parts", "friction"), ("parts", "mount_stiffness"),
    ("parts", "position"), ("parts", "roll"),
)  # fmt: skip
TWO_ARM_PARAMETERS = (
    *PARAMETERS, ("task", "mating_time"), ("", "offset"), ("", "chatter"), ("hold", "force"), ("hold", "moment"),
    ("hold", "force_gain"), ("hold", "moment_gain"),
)  # fmt: skip


@dataclass(frozen=True)
class Scenario:
    """A preset with its scene, what is logged of it and how its trials are drawn."""

    preset: Any  # SessionPreset, which ``sample`` takes
    arms: tuple[str, ...]  # whose wrenches are logged, in this order
    scene: Callable[..., Scene]  # takes substeps, iterations, ls_iterations
    sample: Callable[[Any, int, int, DomainRandomization], tuple[Any, Fault]]  # preset, seed, index, distributions
    parameters: tuple[tuple[str, str], ...]  # what is stored of a trial: group and field

    def draw(self, seed: int, index: int, spec: DomainRandomization) -> tuple[Any, Fault]:
        """One trial's parameters and fault; see ``sim_mjx.randomization.trials.sample``."""
        return self.sample(self.preset, seed, index, spec)

    def draw_batch(self, seed: int, indices: Iterable[int], spec: DomainRandomization) -> tuple[Any, list[Fault]]:
        """Several trials as one batch, equal to ``draw`` trial by trial."""
        drawn = [self.draw(seed, index, spec) for index in indices]
        return stack([params for params, _ in drawn]), [fault for _, fault in drawn]


def get_scenario(name: str) -> Scenario:
    """What a preset simulates.

    Raises:
        InputError: unknown preset.

    >>> get_scenario("two").arms
    ('R', 'L')
    """
    constants = preset(name)
    if isinstance(constants, TwoArmPreset):
        return Scenario(constants, ARMS, two_arm, randomization_two_arm.sample, TWO_ARM_PARAMETERS)
    return Scenario(constants, ("R",), one_arm, trials.sample, PARAMETERS)
