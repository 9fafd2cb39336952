"""Recordings of other robots and laboratories: one method for all of them, with peers beside it."""
