"""The two rules by which words are made, the paper's and the fit rule, as functions that batches and streams run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.untrusted import checked_fields
from rcbht_jax._util.values import expect
from rcbht_jax.encoding import encoder, fit, provisional
from rcbht_jax.encoding.encoder import EncoderConfig, EncoderState
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, Thresholds, host_limits, limits_of, of_lanes, validate
from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance, stacked_limits
from rcbht_jax.errors import InputError
from rcbht_jax.types import Array, LabelTracks

AnyConfig = EncoderConfig | FitConfig
AnyLimits = Thresholds | FitLimits

RULES = ("paper", "fit")
AUTO = "auto"  # a tolerance taken from recordings


class Rule(NamedTuple):
    """Pure functions of one rule; see :mod:`rcbht_jax.encoding.encoder` for arguments and results."""

    init: Callable[..., EncoderState]  # of (config, lanes, dtype)
    step: Callable[..., Any]
    step_partial: Callable[..., Any]
    flush: Callable[..., LabelTracks]
    provisional: Callable[..., LabelTracks]  # as flush, of a stream that goes on
    scan_lanes: Callable[..., tuple[EncoderState, LabelTracks]]
    drain: Callable[..., LabelTracks]  # of (config, limits [number, lane], state)


def _init(_config: EncoderConfig, lanes: tuple[int, ...], dtype: Any = np.float32) -> EncoderState:
    return encoder.init(lanes, dtype)


def _drain(config: EncoderConfig, _limits: Any, state: EncoderState) -> LabelTracks:
    return encoder.drain(config, state)


PAPER = Rule(_init, encoder.step, encoder.step_partial, encoder.flush, encoder.flush, encoder.scan_lanes, _drain)
FIT = Rule(fit.init, fit.step, fit.step_partial, fit.flush, provisional.labels, fit.scan_lanes, fit.drain)


def rule_of(config: AnyConfig) -> Rule:
    """The functions that a configuration belongs to.

    Raises:
        InputError: it is none.
    """
    expect("The config", config, EncoderConfig, FitConfig)
    return FIT if isinstance(config, FitConfig) else PAPER


def config_of(rule: str, window: int, dt: float) -> AnyConfig:
    """The configuration of a rule by its name, with the defaults of everything else.

    Raises:
        InputError: no such rule, or a value is out of range.

    Example:
        >>> config_of("fit", 2, 0.01).window
        2
    """
    if not isinstance(rule, str) or rule not in RULES:
        raise InputError(f"There is no rule {rule!r}; there are {' and '.join(RULES)}.")
    return FitConfig(window, dt) if rule == "fit" else EncoderConfig(window, dt)


def limits_for(
    config: AnyConfig,
    thresholds: AnyLimits,
    tolerance: ArrayLike | Sequence[float] | None,
    wrench: NDArray[np.floating],
    length: NDArray[np.integer],
) -> AnyLimits:
    """Limits for the encoder of a rule: the thresholds alone, or with a tolerance for every axis.

    Args:
        config: its type chooses the rule.
        thresholds: gradient limits ``[..., axis, 4]``; by the fit rule also FitLimits, as calibration finds them.
        tolerance: a number, or one for each axis; None or "auto" = that of FitLimits, else from the recordings. The
            paper's rule has none.
        wrench: recordings ``[recording, time, axis]`` that the tolerance is taken from, N and Nm.
        length: their samples that count ``[recording]``.

    Raises:
        InputError: a tolerance for the paper's rule, or limits or tolerances of wrong shape or out of range.

    Example:
        >>> ramp, limits = np.linspace(0, 100, 1001)[None, :, None], np.array([[70.0, 46.0, 23.0, 1.0]])
        >>> limits_for(FitConfig(), limits, "auto", ramp, np.array([1001])).tolerance.round(6).tolist()
        [1.47]
    """
    learned = tolerance is None or (isinstance(tolerance, str) and tolerance == AUTO)
    if not isinstance(config, FitConfig):
        if not learned:
            raise InputError('A tolerance belongs to the fit rule; add rule="fit", or leave it out.')
        if isinstance(thresholds, FitLimits):
            raise InputError('These limits have tolerances and belong to the fit rule; add rule="fit" (--rule fit).')
        return thresholds
    if isinstance(thresholds, FitLimits):
        if learned:
            thresholds.stacked()
            return thresholds
        thresholds = GradientThresholds(thresholds.gradients)
    gradients = of_lanes(host_limits(thresholds).astype(np.float64), 4, wrench.shape[::2])
    found = auto_tolerance(wrench, length, config.needed) if learned else _numbers(tolerance)
    return FitLimits(gradients, stacked_limits(gradients, found)[..., 4])


def _numbers(tolerance: Any) -> NDArray[np.float64]:
    try:
        return np.asarray(tolerance, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"The tolerance is {tolerance!r}; expected numbers, or {AUTO!r}.") from None


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
    values = host_limits(limits)
    validate(values)
    return values


def gradients_of(limits: AnyLimits) -> Any:
    """The gradient limits ``[..., axis, 4]`` of either rule."""
    return limits.gradients if isinstance(limits, FitLimits) else limits_of(limits)


def scaled(limits: AnyLimits, factor: float) -> AnyLimits:
    """Gradient limits times a factor; tolerances stay.

    >>> scaled(FitLimits(np.array([[8.0, 4.0, 2.0, 1.0]]), np.array([0.5])), 0.5).stacked().tolist()
    [[4.0, 2.0, 1.0, 0.5, 0.5]]
    """
    gradients = np.asarray(gradients_of(limits)) * factor
    return FitLimits(gradients, limits.tolerance) if isinstance(limits, FitLimits) else GradientThresholds(gradients)


def limit_values(limits: AnyLimits | Array) -> Array:
    """The numbers of every axis, unchecked: ``[..., axis, 4]``, or ``[..., axis, 5]`` with the tolerance last.

    Safe inside jit, vmap and grad; an array stays as it is.
    """
    if isinstance(limits, FitLimits):
        wide = jnp.broadcast_to(limits.tolerance, limits.gradients.shape[:-1])
        return jnp.concatenate([jnp.asarray(limits.gradients), wide[..., None]], axis=-1)
    return limits.limits if isinstance(limits, GradientThresholds) else limits


# --- as files have them -----------------------------------------------------------------------------------------------


def config_fields(config: AnyConfig) -> dict[str, Any]:
    """A configuration as JSON values; the rule "fit" names that of :class:`FitConfig`.

    >>> config_fields(FitConfig())["rule"], config_fields(EncoderConfig())["rule"]
    ('fit', 'paper')
    """
    return asdict(config) | ({"rule": "fit"} if isinstance(config, FitConfig) else {})


def config_from(values: Mapping[str, Any]) -> AnyConfig:
    """Undo :func:`config_fields`; files older than the fit rule hold the paper's.

    Raises:
        InputError: a value is of another type or out of range, or there is no field of that name.
    """
    if values.get("rule") == "fit":
        older = {"lead_below": None}  # files from before this choice
        given = {name: value for name, value in values.items() if name != "rule"}
        return FitConfig(**checked_fields(FitConfig, older | given))
    return EncoderConfig(**checked_fields(EncoderConfig, values))


def limit_arrays(limits: AnyLimits) -> dict[str, NDArray[np.float64]]:
    """Limits as named arrays: "limits" of the paper's rule, "limits.gradients" and others of the fit."""
    if not isinstance(limits, FitLimits):
        return {"limits": np.asarray(limits_of(limits), np.float64)}
    return {f"limits.{field.name}": np.asarray(getattr(limits, field.name), np.float64) for field in fields(limits)}


def limits_from(config: AnyConfig, arrays: Mapping[str, NDArray[Any]]) -> AnyLimits:
    """Undo :func:`limit_arrays`.

    Raises:
        KeyError: an array is missing.
    """
    if not isinstance(config, FitConfig):
        return np.asarray(arrays["limits"])
    return FitLimits(**{field.name: np.asarray(arrays[f"limits.{field.name}"]) for field in fields(FitLimits)})


def made_by(config: AnyConfig, limits: AnyLimits) -> dict[str, Any]:
    """How labels were made, as label tracks note it: JSON values "config" and "thresholds".

    >>> noted = made_by(FitConfig(), FitLimits(np.array([[70.0, 46.0, 23.0, 1.0]]), np.array([0.5])))
    >>> noted["config"]["tolerance"], noted["thresholds"]
    ([0.5], [[70.0, 46.0, 23.0, 1.0]])
    """
    arrays = {name.removeprefix("limits."): value.tolist() for name, value in limit_arrays(limits).items()}
    thresholds = arrays.pop("gradients" if isinstance(limits, FitLimits) else "limits")
    return {"config": config_fields(config) | arrays, "thresholds": thresholds}


def encoder_of(noted: Mapping[str, Any]) -> tuple[AnyConfig, AnyLimits]:
    """Undo :func:`made_by`.

    Raises:
        InputError: a value is of another type or out of range.
        KeyError: one is missing.

    >>> encoder_of(made_by(EncoderConfig(), np.array([[70.0, 46.0, 23.0, 1.0]])))[0] == EncoderConfig()
    True
    """
    own = dict(noted["config"])
    tolerance = own.pop("tolerance", None)
    limits = np.asarray(noted["thresholds"], np.float64)
    return config_from(own), limits if tolerance is None else FitLimits(limits, np.asarray(tolerance, np.float64))
