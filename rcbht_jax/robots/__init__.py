"""Robots as data: kinematic tables and forward kinematics."""
