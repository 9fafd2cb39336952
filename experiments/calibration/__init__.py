"""What calibrated gradient thresholds are worth, and what they cost."""
