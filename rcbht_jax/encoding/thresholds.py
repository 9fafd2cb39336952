"""Gradient thresholds per axis: robot presets and the ordered parametrisation used by calibration."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array

# Impulse, big, medium, small limits for forces, N/s (specification, sections 2.3 online and 3 offline).
_FORCE_LIMITS = {
    "hiro": (70.0, 46.0, 23.0, 1.0),
    "baxter": (70.0, 46.0, 23.0, 1.0),
    "pa10": (1000.0, 100.0, 10.0, 1.0),
}
ROBOTS = tuple(_FORCE_LIMITS)
MOMENT_SCALE = 10.0  # moments of a hand-sized lever are about a tenth of the forces


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GradientThresholds:
    """Gradient limits, largest first, mirrored for negative slopes.

    Attributes:
        limits: float ``[..., axis, 4]``, impulse >= big >= medium >= small > 0, N/s for forces, Nm/s for moments.
    """

    limits: Array

    def __post_init__(self) -> None:
        if isinstance(self.limits, np.ndarray):
            validate(self.limits)


def validate(limits: NDArray[np.floating]) -> None:
    """Check a host array of limits ``[..., axis, 4]``.

    Raises:
        InputError: wrong shape, not finite, not positive or not ordered.
    """
    if limits.ndim < 2 or limits.shape[-1] != 4:
        raise InputError(f"GradientThresholds have shape {limits.shape}; expected [..., axis, 4].")
    if not np.all(np.isfinite(limits)) or not np.all(limits > 0):
        raise InputError("GradientThresholds must be finite and positive numbers.")
    if not np.all(limits[..., :-1] >= limits[..., 1:]):
        raise InputError("GradientThresholds must be ordered: impulse >= big >= medium >= small.")


def preset(robot: str = "hiro") -> GradientThresholds:
    """Hand-set thresholds of the authors for a robot, ``[6, 4]``; moments are a tenth of the forces.

    Args:
        robot: one of ``ROBOTS``.

    Raises:
        InputError: unknown robot.
    """
    if robot not in _FORCE_LIMITS:
        raise InputError(f"Robot {robot!r} has no thresholds; expected one of {', '.join(ROBOTS)}.")
    force = np.array(_FORCE_LIMITS[robot])
    return GradientThresholds(np.stack([force] * 3 + [force / MOMENT_SCALE] * 3))


def from_free(free: Array) -> GradientThresholds:
    """GradientThresholds from unconstrained numbers ``[..., axis, 4]``: log of the small limit, then log of each step up.

    Any real input gives ordered, positive limits; the inverse is :func:`to_free`.
    """
    steps = jnp.exp(free)
    return GradientThresholds(jnp.cumsum(steps, axis=-1)[..., ::-1])


def to_free(thresholds: GradientThresholds) -> Array:
    """Unconstrained parametrisation of strictly ordered thresholds (inverse of :func:`from_free`)."""
    ascending = jnp.asarray(thresholds.limits)[..., ::-1]
    steps = jnp.diff(ascending, axis=-1, prepend=jnp.zeros_like(ascending[..., :1]))
    return jnp.log(steps)
