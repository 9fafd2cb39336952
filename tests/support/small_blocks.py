"""Programs in blocks that fit the tests' few short trials: results do not depend on the size of a block."""

from __future__ import annotations

from importlib import import_module

BLOCKS = {
    ("rcbht_jax.introspection.chain", "_STEPS"): 64,  # of a scan, in place of 512
    ("sim_mjx.engines.native", "LANES"): 16,  # trials of a thread, in place of 64
}


def shrink() -> None:
    """For this process; commands that tests start, and the tests of the standard compiler, have the users' blocks."""
    for (module, name), size in BLOCKS.items():
        block = import_module(module)
        assert hasattr(block, name), name
        setattr(block, name, size)
