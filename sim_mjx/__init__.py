"""Assemblies in simulation, HIRO's first: robots, parts, controllers, sensor and engines; trials with ground truth."""
