"""Own kernel."""
