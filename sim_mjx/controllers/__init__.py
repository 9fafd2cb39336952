"""Motions of a hand that holds a part, and what turns them into joint references; pure functions, the same for any arm.

A motion takes what the controller senses in one control period (:class:`Sense`) and returns a twist: velocity of the
part's tip, m/s, and angular velocity, rad/s, world axes. Twists add up: pressing and searching at the same time is
``admittance(...) + spiral(...)``.
"""

from sim_mjx.controllers.moves import Sense, admittance, go_to, keep_turn, spiral, tilt
from sim_mjx.controllers.resolved import resolved_rates

__all__ = ["Sense", "admittance", "go_to", "keep_turn", "resolved_rates", "spiral", "tilt"]
