"""Trials by the thousand into a store: sharded, resumable, reproducible."""
