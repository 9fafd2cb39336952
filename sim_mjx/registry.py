"""What can be simulated by name: the one-arm sessions and the two-arm task, each with its scene and its trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rcbht_jax.errors import InputError
from sim_mjx.assembly.rollout import stack
from sim_mjx.assembly.scene import Scene, one_arm
from sim_mjx.assembly.two_arm_scene import ARMS, two_arm
from sim_mjx.presets import sessions
from sim_mjx.presets import two_arm as two_presets
from sim_mjx.randomization import trials
from sim_mjx.randomization import two_arm as two_randomize
from sim_mjx.randomization.trials import DomainRandomization, Fault

# Group of a trial's parameters, "" = none, and its field.
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
NAMES = (*sessions.PRESETS, *two_presets.PRESETS)


@dataclass(frozen=True)
class Scenario:
    """A scene, what is logged of it and how its trials are drawn."""

    arms: tuple[str, ...]  # whose wrenches are logged, in this order
    scene: Callable[..., Scene]  # takes substeps, iterations, ls_iterations
    draw: Callable[[str, int, int, DomainRandomization], tuple[Any, Fault]]  # preset, seed, index, distributions
    parameters: tuple[tuple[str, str], ...]  # what is stored of a trial: group and field

    def draw_batch(
        self, preset: str, seed: int, indices: Sequence[int], spec: DomainRandomization
    ) -> tuple[Any, list[Fault]]:
        """Several trials as one batch, equal to ``draw`` trial by trial."""
        drawn = [self.draw(preset, seed, index, spec) for index in indices]
        return stack([params for params, _ in drawn]), [fault for _, fault in drawn]


ONE_ARM = Scenario(("R",), one_arm, trials.sample, PARAMETERS)
TWO_ARM = Scenario(ARMS, two_arm, two_randomize.draw, TWO_ARM_PARAMETERS)


def get_scenario(preset: str) -> Scenario:
    """What a preset simulates.

    Raises:
        InputError: unknown preset.
    """
    if preset not in NAMES:
        raise InputError(f"There is no preset {preset!r}; expected one of {', '.join(NAMES)}.")
    return TWO_ARM if preset in two_presets.PRESETS else ONE_ARM
