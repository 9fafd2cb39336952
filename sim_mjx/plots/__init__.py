"""Pictures of simulated and replayed trials, as matplotlib figures without any global state."""

from rcbht_jax._util.optional import require

require("mujoco", "sim")
