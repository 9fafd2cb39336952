"""Recorded sessions as data: task, parts, sensor and placement grid of each."""
