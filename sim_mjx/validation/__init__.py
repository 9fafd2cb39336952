"""How far the simulation can be trusted: solver convergence, engine parity, likeness to recorded sessions."""
