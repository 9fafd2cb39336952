"""The simulated assembly: robot, parts, scenes, controllers, state machine and wrist sensor; no physics step."""
