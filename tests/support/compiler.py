"""How tests compile: with little optimisation, unless they ask for what users have."""

from __future__ import annotations

import os
from importlib.metadata import version

UNOPTIMISED = {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}
if tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 11):  # later ones know no such flag, and stop at it
    # workers share the cores: to split a program over threads only adds to what there is to compile
    UNOPTIMISED["XLA_FLAGS"] = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"


def as_users_compile() -> dict[str, str]:
    """The environment without these variables, for a process that a test starts."""
    return {name: value for name, value in os.environ.items() if name not in UNOPTIMISED}
