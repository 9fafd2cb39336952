"""Options that turn a scenario into an environment."""

from __future__ import annotations

from dataclasses import dataclass

from rcbht_jax.errors import InputError
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.own_code import finite, whole, with_tuples

ACTIONS = ("set-points", "joint", "cartesian")
CONTROLLERS = ("recorded", "none")
OBSERVATIONS = ("joints", "wrench", "words", "beliefs")


@dataclass(frozen=True)
class EnvConfig:
    """What an action does, what is observed, and when an episode has succeeded; hashable.

    Attributes:
        action: "set-points" = added to the force law's set-points F* and M* during the step, in their frame; "joint" =
            increments of the joint references; "cartesian" = increments of the hand's pose in world axes, which a
            damped inverse of the Jacobian turns into joint increments. Each number is between -1 and 1; the attributes
            below set the scale.
        controller: "recorded" = the action is added to the output of the scenario's controller, so that a zero action
            changes nothing; "none" = only the action moves the references away from home.
        periods: control periods of 5 ms per step, all with the same action; a multiple of the encoder's window.
        observe: parts of the observation, in this order.
        hold: time for which all tabs must have been seated without interruption for success, s.
        force: N, set-point that an action of 1 adds. moment: Nm, likewise.
        angle: rad, joint increment per step. shift: m, of the hand per step. turn: rad, of the hand per step.

    Raises:
        InputError: an unknown choice, or a number that is not positive.

    Example:
        >>> EnvConfig(action="cartesian").dt
        0.025
    """

    action: str = "set-points"
    controller: str = "recorded"
    periods: int = 5
    observe: tuple[str, ...] = OBSERVATIONS
    hold: float = 0.5
    force: float = 20.0
    moment: float = 40.0
    angle: float = 0.002
    shift: float = 5e-4
    turn: float = 0.005

    def __post_init__(self) -> None:
        with_tuples(self)
        _check_choice("action", self.action, ACTIONS)
        _check_choice("controller", self.controller, CONTROLLERS)
        observe = self.observe if isinstance(self.observe, tuple) else ()
        for part in observe:
            _check_choice("observation", part, OBSERVATIONS)
        if not observe or len(set(observe)) < len(observe):
            raise InputError(f"observe is {self.observe!r}; expected a tuple of one part or more, each once.")
        if self.action == "set-points" and self.controller == "none":
            raise InputError(
                'action="set-points" needs controller="recorded"; use that, or action="joint" or action="cartesian".'
            )
        if not whole(self.periods, 1):
            raise InputError(f"periods is {self.periods!r}; expected a whole number of control periods, 1 or more.")
        for name in ("hold", "force", "moment", "angle", "shift", "turn"):
            value = getattr(self, name)
            if not finite(value) or value <= 0:
                raise InputError(f"The environment's {name} is {value}; expected a positive, finite number.")

    @property
    def dt(self) -> float:
        """Seconds per step."""
        return self.periods * CONTROL_PERIOD

    @property
    def senses_words(self) -> bool:
        """Whether words are made, for themselves or for beliefs."""
        return bool({"words", "beliefs"} & set(self.observe))


def _check_choice(what: str, value: object, known: tuple[str, ...]) -> None:
    if value not in known:
        raise InputError(f"There is no {what} {value!r}; expected one of {', '.join(known)}.")
