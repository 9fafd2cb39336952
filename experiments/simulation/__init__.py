"""Physics engines, synthesis and the simulated sessions."""
