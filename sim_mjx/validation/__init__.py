"""How far the simulation can be trusted: solver convergence, engine parity, likeness to recorded sessions."""

from rcbht_jax._util.optional import require

require("mujoco", "sim")
