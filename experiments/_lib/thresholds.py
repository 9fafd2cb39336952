"""Thresholds by gradients with the settings that all experiments share."""

from __future__ import annotations

from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.gradient import GradientOptions, calibrate
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset

OPTIONS = GradientOptions(steps=60, rate=0.1, temperature=(0.7, 0.1))


def trained_thresholds(data: CalibrationData, config: EncoderConfig) -> GradientThresholds:
    """Trained from the preset."""
    return calibrate(data, config, preset(), OPTIONS).thresholds
