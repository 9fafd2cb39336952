"""HIRO's snap assembly in simulation: robot, parts, controllers, sensor and engines; trials with their ground truth."""
