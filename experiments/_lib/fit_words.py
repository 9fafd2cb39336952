"""Rows of the fit rule: how its words are made and weighed, and the tolerances, learned without labels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from experiments._lib.benchmarks import REAL, SIM1
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, config_fields
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance
from rcbht_jax.types import Recordings

WINDOW = 5
WEIGHED = ("time", "change")
FIT_RULE = config_fields(FitConfig(WINDOW))  # for results: rows made by another rule are made again


@dataclass(frozen=True)
class Words:
    """How the words of one row are made."""

    rule: str = "paper"
    weighing: tuple[str, ...] = ()
    factor: float = 1.0  # on the learned tolerance

    def encoder(self, tolerance: Float[np.ndarray, " axis"], dt: float) -> tuple[AnyConfig, AnyLimits]:
        """Configuration, and the preset's limits; those of the fit rule with ``factor`` times the tolerance."""
        if self.rule == "paper":
            return EncoderConfig(WINDOW, dt), preset()
        return FitConfig(WINDOW, dt), FitLimits(np.asarray(preset().limits), self.factor * tolerance)


# Encoders side by side, finer by the factors of the limits; added when other rows of the fit rule had been seen.
THREE = (1.0, 1 / 4, 1 / 16)
# Fixed before the first score of a row below the paper's; the quarter is what fit_classification.json suggests.
PAPER = "paper"
WORDS = {
    PAPER: Words(),
    "fit": Words("fit"),
    "fit, weighed": Words("fit", WEIGHED),
    "fit, tolerance / 4": Words("fit", factor=1 / 4),
}


def learned_tolerance(recordings: Recordings) -> Float[np.ndarray, " axis"]:
    """A tolerance for every axis, of all samples of some recordings."""
    return auto_tolerance(recordings.wrench, recordings.length, FitConfig(WINDOW, recordings.dt).needed)


def tolerances(recordings: Recordings) -> dict[str, Float[np.ndarray, " axis"]]:
    """Of the robot from session A alone, of the authors' simulation from its own trials; by data set."""
    training = {REAL: (recordings.source == REAL) & (recordings.session == "A"), SIM1: recordings.source == SIM1}
    return {source: learned_tolerance(recordings.take(rows)) for source, rows in training.items() if rows.any()}
