"""Validation of the simulation: solver convergence, engine parity, similarity to recorded sessions."""

from rcbht_jax._util.optional import require

require("mujoco", "sim")
