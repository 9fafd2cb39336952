"""Calibration: thresholds from context, by search and by gradients. It sees only the trials it is given."""
