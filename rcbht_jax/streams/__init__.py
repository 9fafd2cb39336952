"""Wrench streams in (JSON lines, trials, stores, bags) and events out (JSON lines, MCAP)."""
