"""Pictures of simulated and replayed trials, as matplotlib figures without any global state."""
