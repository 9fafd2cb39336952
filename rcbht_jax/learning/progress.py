"""Calibration of beliefs by progress: how sure a stream may be depends on how much of the record has passed.

A sigmoid that is right on average is overconfident before anything can be known, and underconfident at the end; in a
pooled calibration error the two cancel. In every part of the planned time beliefs get a temperature (Guo, Pleiss, Sun
and Weinberger, "On calibration of modern neural networks", 2017) and are mixed with the frequencies of the classes,
both fitted by maximum likelihood to beliefs about trials that did not train the classifier. As for Platt's sigmoids,
targets are drawn inwards by one trial, so that classes that are separated without a mistake do not become certain.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Shaped
from scipy.optimize import minimize
from scipy.special import expit

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array

PARTS = 4  # quarters of the planned time
LEAST = 1e-6  # probability below which a logarithm is not taken
COLDEST, HOTTEST = 0.25, 20.0  # temperatures: few trials would make a step of the coldest


@dataclass(frozen=True)
class ProgressCalibration:
    """Temperature and share of the classes' frequencies in each part of the planned time.

    Raises:
        InputError: numbers out of range, or not one temperature and one share for each part.

    Example:
        >>> half = ProgressCalibration(10.0, temperature=(4.0, 1.0), share=(1.0, 0.0), prior=(0.5, 0.5))
        >>> half(np.array([[0.9, 0.1], [0.9, 0.1]]), np.array([2.0, 12.0])).round(3).tolist()  # at 2 s, and at 12 s
        [[0.5, 0.5], [0.9, 0.1]]
    """

    planned: float  # s, median length of a training record
    temperature: tuple[float, ...]  # [part]; 1 = beliefs as they are, more = less sure
    share: tuple[float, ...]  # [part] of the frequencies in the mixture, 0 to 1
    prior: tuple[float, ...]  # [class] frequencies

    def __post_init__(self) -> None:
        numbers = np.array([self.planned, *self.temperature, *self.share, *self.prior], np.float64)
        inside = np.isfinite(numbers).all() and numbers.min() >= 0 and self.planned > 0 and min(self.temperature) > 0
        fits = len(self.temperature) == len(self.share) > 0 and abs(sum(self.prior) - 1) < 1e-6
        if not (inside and fits and max(self.share) <= 1):
            raise InputError(
                f"a calibration by progress has planned {self.planned}, temperature {self.temperature}, share "
                f"{self.share} and prior {self.prior}; expected positive numbers, a share of 0 to 1 for each "
                "temperature, and a prior that sums to one."
            )

    @staticmethod
    def fit(
        p: Float[np.ndarray, "step class"],
        y: Int[np.ndarray, " step"],
        seconds: Float[np.ndarray, " step"],
        trial: Shaped[np.ndarray, " step"],
        planned: float,
        parts: int = PARTS,
    ) -> ProgressCalibration:
        """Learn from beliefs about trials that did not train the classifier.

        Args:
            p: beliefs; those of a training trial would make the calibration trust too much.
            y: class.
            seconds: since the record began.
            trial: of each step.
            planned: s, length of a usual record.
            parts: of the planned time, equally long; a part without a step leaves beliefs as they are.

        Raises:
            InputError: no steps, or a planned time that is not positive.
        """
        if not len(p) or not 0 < planned < np.inf:
            raise InputError(
                f"There are {len(p)} beliefs, and planned is {planned} s; expected at least one, and more than 0 s."
            )
        prior = np.bincount(y, minlength=p.shape[1]) / len(y)
        part = part_of(seconds / planned, parts)
        found = [_fit_part(p[part == k], y[part == k], prior, len(np.unique(trial[part == k]))) for k in range(parts)]
        temperature, share = zip(*found, strict=True)
        return ProgressCalibration(float(planned), temperature, share, tuple(prior.tolist()))

    def __call__(
        self, p: Float[np.ndarray, "step class"], seconds: Float[np.ndarray, " step"]
    ) -> Float[np.ndarray, "step class"]:
        """Calibrated beliefs.

        Args:
            p: probabilities of the classifier.
            seconds: since the record began.
        """
        part = part_of(seconds / self.planned, len(self.share))
        temperature, share = (np.array(values)[part, None] for values in (self.temperature, self.share))
        return mixed(p, temperature, share, np.array(self.prior))


def part_of(progress: Float[np.ndarray, " step"], parts: int = PARTS) -> Int[np.ndarray, " step"]:
    """Number of the part, from 0; whatever lasts longer than planned is in the last.

    >>> part_of(np.array([0.0, 0.3, 1.7])).tolist()
    [0, 1, 3]
    """
    return np.clip((progress * parts).astype(np.int64), 0, parts - 1)


def mixed(
    p: Float[np.ndarray, "step class"],
    temperature: Float[np.ndarray, "step 1"] | float,
    share: Float[np.ndarray, "step 1"] | float,
    prior: Float[np.ndarray, " class"],
) -> Float[np.ndarray, "step class"]:
    """Beliefs with a temperature, mixed with a share of the classes' frequencies.

    >>> mixed(np.array([[0.8, 0.2]]), 1.0, 0.5, np.array([0.5, 0.5])).round(2).tolist()
    [[0.65, 0.35]]
    """
    log = np.log(np.maximum(p, LEAST)) / temperature
    scaled = np.exp(log - log.max(1, keepdims=True))
    return (1 - share) * scaled / scaled.sum(1, keepdims=True) + share * prior


def _fit_part(
    p: Float[np.ndarray, "step class"], y: Int[np.ndarray, " step"], prior: Float[np.ndarray, " class"], trials: int
) -> tuple[float, float]:
    """Temperature and share that make the classes likeliest."""
    if not len(p):
        return 1.0, 0.0
    inwards, true = 1 / (trials + 2), np.arange(len(y))

    def loss(params: Float[np.ndarray, " 2"]) -> float:
        log = np.log(np.maximum(mixed(p, *_numbers(params), prior), LEAST))
        return -float(((1 - inwards) * log[true, y] + inwards * log.mean(1)).mean())

    return _numbers(minimize(loss, np.array([0.0, -2.0]), method="Nelder-Mead").x)


def _numbers(params: Float[np.ndarray, " 2"]) -> tuple[float, float]:
    temperature = np.exp(np.clip(params[0], np.log(COLDEST), np.log(HOTTEST)))
    return float(temperature), float(expit(params[1]))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ProgressArrays:
    """The same calibration in single precision, for a compiled stream."""

    planned: Array  # float32, s
    temperature: Array  # float32 [part]
    share: Array  # float32 [part]
    prior: Array  # float32 [class]


def progress_arrays(calibration: ProgressCalibration) -> ProgressArrays:
    """The calibration for :func:`mixed_jax`."""
    fields = (calibration.planned, calibration.temperature, calibration.share, calibration.prior)
    return ProgressArrays(*(np.asarray(values, np.float32) for values in fields))


def mixed_jax(arrays: ProgressArrays, p: Float[Array, " class"], seconds: Float[Array, ""]) -> Float[Array, " class"]:
    """Calibrated beliefs of one moment; ``jax.vmap`` for many.

    Args:
        arrays: of :func:`progress_arrays`.
        p: probabilities of the classifier.
        seconds: since the record began.
    """
    temperature, share = jnp.asarray(arrays.temperature), jnp.asarray(arrays.share)
    parts = share.shape[0]
    part = jnp.clip(jnp.floor(seconds / arrays.planned * parts).astype(jnp.int32), 0, parts - 1)
    scaled = jax.nn.softmax(jnp.log(jnp.maximum(p, jnp.float32(LEAST))) / temperature[part])
    return (1 - share[part]) * scaled + share[part] * arrays.prior
