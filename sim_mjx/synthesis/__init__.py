"""Trials by the thousand into a store: sharded, resumable, reproducible."""

from rcbht_jax._util.optional import require

require("mujoco", "sim")
