"""How tests compile: with little optimisation, unless they ask for what users have."""

from __future__ import annotations

import os
from importlib.metadata import version

UNOPTIMISED = {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}
if tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 11):  # later ones know no such flag, and stop at it
    UNOPTIMISED["XLA_FLAGS"] = "--xla_cpu_use_fusion_emitters=false"


def as_users_compile() -> dict[str, str]:
    """The environment without these variables, for a process that a test starts."""
    return {name: value for name, value in os.environ.items() if name not in UNOPTIMISED}
