"""HIRO's snap assembly in simulation: robot, parts, controllers, sensor and engines; trials with their truth."""

from importlib.util import find_spec

from rcbht_jax._util.optional import MissingPackage

if find_spec("mujoco") is None:  # it is slow to import, and not every command needs it
    raise MissingPackage("mujoco", "sim")
