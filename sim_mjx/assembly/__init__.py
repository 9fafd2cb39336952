"""The simulated assembly: robot, parts, scenes, controllers, state machine and wrist sensor; no physics step."""

from rcbht_jax._util.optional import require

require("mujoco", "sim")
