"""Accuracy and cost of calibrated gradient thresholds."""
