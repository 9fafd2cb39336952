"""The rules by which words are made, as what batches and streams run: the paper's, and the one that fits lines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.encoding import encoder, fit
from rcbht_jax.encoding.encoder import EncoderConfig, EncoderState
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.thresholds import Thresholds, limits_of, validate
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.types import LabelTracks

AnyConfig = EncoderConfig | FitConfig
AnyLimits = Thresholds | FitLimits


class Rule(NamedTuple):
    """Pure functions of one rule; see :mod:`rcbht_jax.encoding.encoder` for what they take and give."""

    init: Callable[..., EncoderState]  # of (config, lanes, dtype)
    step: Callable[..., Any]
    flush: Callable[..., LabelTracks]
    scan_lanes: Callable[..., tuple[EncoderState, LabelTracks]]
    drain: Callable[..., LabelTracks]  # of (config, limits [number, lane], state)


def _init(_config: EncoderConfig, lanes: tuple[int, ...], dtype: Any) -> EncoderState:
    return encoder.init(lanes, dtype)


def _drain(config: EncoderConfig, _limits: Any, state: EncoderState) -> LabelTracks:
    return encoder.drain(config, state)


PAPER = Rule(_init, encoder.step, encoder.flush, encoder.scan_lanes, _drain)
FIT = Rule(fit.init, fit.step, fit.flush, fit.scan_lanes, fit.drain)


def rule_of(config: AnyConfig) -> Rule:
    """The functions that a configuration belongs to."""
    return FIT if isinstance(config, FitConfig) else PAPER


def checked_limits(config: AnyConfig, limits: AnyLimits) -> NDArray[np.floating]:
    """Limits of every axis as one host array: ``[..., axis, 4]`` of the paper's rule, ``[..., axis, 5]`` of the fit.

    Raises:
        InputError: limits of the other rule, of another shape, or out of order.

    Example:
        >>> from rcbht_jax.encoding.thresholds import preset
        >>> checked_limits(EncoderConfig(), preset("hiro", ["Fz"])).tolist()
        [[70.0, 46.0, 23.0, 1.0]]
    """
    if isinstance(limits, FitLimits):
        if not isinstance(config, FitConfig):
            raise InputError("The limits have a tolerance; the paper's rule takes gradient thresholds alone.")
        return limits.stacked()
    if isinstance(config, FitConfig):
        raise InputError("The fit rule needs a tolerance for every axis; pass FitLimits.")
    values = np.asarray(limits_of(limits))
    validate(values)
    return values
