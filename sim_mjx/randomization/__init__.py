"""Domain randomization: distributions, faults and overrides of physical parameters."""
