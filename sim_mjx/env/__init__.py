"""Learning environments on the simulator: pure functions ``reset`` and ``step`` for ``jax.vmap`` and :func:`jit`.

>>> from sim_mjx import env
>>> sorted(env.ALIASES)
['camera-snap', 'clip', 'peg-in-hole', 'plug', 'square-peg']
"""

from __future__ import annotations

from rcbht_jax._util.optional import require

require("mujoco", "sim")

from sim_mjx.env.config import EnvConfig  # noqa: E402
from sim_mjx.env.environment import Environment, State  # noqa: E402
from sim_mjx.env.loading import ALIASES, jit, load  # noqa: E402

__all__ = ["ALIASES", "EnvConfig", "Environment", "State", "jit", "load"]
