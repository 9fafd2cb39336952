"""Observations: joints, wrench, the latest words, and beliefs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from rcbht_jax.encoding.encoder import EncoderConfig, unpack
from rcbht_jax.encoding.rules import checked_limits
from rcbht_jax.encoding.thresholds import Thresholds, preset
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.chain import StreamState, begin_stream
from rcbht_jax.introspection.introspector import Chain, infer
from rcbht_jax.introspection.model import HeadArrays, IntrospectionModel, head_arrays
from rcbht_jax.labels import AXES, LAYER_SIZES, UNITS
from rcbht_jax.types import Array
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines.common import LARGEST
from sim_mjx.env.config import EnvConfig

WIDEST_ANGLE = 100.0  # rad; bound of observed angles


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SensesState:
    """State of the encoder and of the classifiers."""

    stream: StreamState
    words: Int[Array, "*batch 3 axis"]  # codes of the latest published words of each layer, 0 = none yet
    beliefs: Float[Array, "*batch probability"]  # of all classifiers, one after the other
    began: Int[Array, "*batch"]  # samples before the present sub-task


@dataclass(frozen=True)
class Senses:
    """Encoder and classifiers of an environment; pure functions of one trial."""

    parts: tuple[str, ...]  # of the observation
    axes: int
    joints: int
    chain: Chain
    limits: Float[np.ndarray, "axis limit"]
    heads: tuple[HeadArrays, ...]

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each part of the observation, in its order."""
        sizes = {
            "joints": self.joints, "wrench": self.axes, "words": self.axes * sum(LAYER_SIZES), "beliefs": self._beliefs,
        }  # fmt: skip
        return {part: sizes[part] for part in self.parts}

    @property
    def bounds(self) -> Float[np.ndarray, "2 size"]:
        """Lowest and highest value of each number of an observation."""
        low = {"joints": -WIDEST_ANGLE, "wrench": -LARGEST, "words": 0.0, "beliefs": 0.0}
        high = {"joints": WIDEST_ANGLE, "wrench": LARGEST, "words": 1.0, "beliefs": 1.0}
        columns = [np.full((2, size), [[low[part]], [high[part]]], np.float32) for part, size in self.sizes.items()]
        return np.concatenate(columns, axis=1)

    @property
    def _beliefs(self) -> int:
        return sum(head.classes for head in self.chain.heads)

    @property
    def begun(self) -> SensesState:
        """The state before the first sample: no words, and uniform beliefs."""
        uniform = [np.full(head.classes, 1.0 / head.classes, np.float32) for head in self.chain.heads]
        return SensesState(
            begin_stream(self.chain.config, self.chain.views, self.axes),
            jnp.zeros((len(LAYER_SIZES), self.axes), jnp.int32),
            jnp.asarray(np.concatenate([*uniform, np.zeros(0, np.float32)])),
            jnp.int32(0),
        )

    def take(
        self, state: SensesState, wrench: Float[Array, "time axis"], phase: Int[Array, " time"], before: Int[Array, ""]
    ) -> SensesState:
        """Process the samples of one step.

        Args:
            state: before.
            wrench: whole windows, N and Nm.
            phase: of the controller at each sample. before: at the last sample of the step before.

        Returns:
            the state after it. A sub-task begins with the window after the one in which its phase began.
        """
        if not {"words", "beliefs"} & set(self.parts):
            return state
        window = self.chain.config.window
        for first in range(0, len(wrench), window):
            state = self._window(state, wrench[first : first + window])
            last = phase[first + window - 1]
            samples = state.stream.encoder.time[0]
            state = replace(state, began=jnp.where(last != before, samples, state.began))
            before = last
        return state

    def _window(self, state: SensesState, window: Float[Array, "window axis"]) -> SensesState:
        begins = [state.began if scope == "subtask" else jnp.zeros_like(state.began) for scope in self.chain.scopes]
        stacked = jnp.stack(begins) if begins else jnp.zeros(0, jnp.int32)
        stream, beliefs, published = infer(
            self.chain, jnp.asarray(self.limits), self.heads, state.stream, window, jnp.int32(len(window)), stacked
        )
        tracks = unpack(published)
        new = jnp.stack([tracks.primitive.label, tracks.mc.label, tracks.llb.label]).astype(jnp.int32)
        words = jnp.where(new > 0, new, state.words)
        return SensesState(stream, words, jnp.concatenate([*beliefs, state.beliefs[:0]]), state.began)

    def observe(
        self, state: SensesState, joints: Float[Array, " joint"], wrench: Float[Array, " axis"]
    ) -> Float[Array, " size"]:
        """The observation: finite and within :attr:`bounds`, whatever the physics returned.

        Args:
            state: of the senses.
            joints: rad, measured last. wrench: N and Nm, measured last.
        """
        codes = [jax.nn.one_hot(row - 1, size).ravel() for row, size in zip(state.words, LAYER_SIZES, strict=True)]
        values = {"joints": joints, "wrench": wrench, "words": jnp.concatenate(codes), "beliefs": state.beliefs}
        low, high = self.bounds
        whole = jnp.concatenate([values[part].astype(jnp.float32) for part in self.parts])
        return jnp.clip(jnp.nan_to_num(whole), jnp.asarray(low), jnp.asarray(high))


def new_senses(
    config: EnvConfig,
    axes: int,
    joints: int,
    model: IntrospectionModel | None = None,
    thresholds: Thresholds | None = None,
) -> Senses:
    """Senses of an environment; without a model there are no beliefs.

    Args:
        config: what is observed, and how often.
        axes: of all wrists' wrenches.
        joints: of the robot.
        model: makes beliefs, and the words with its own encoder.
        thresholds: of the words without a model, ``[6, 4]`` of every wrist or ``[axis, 4]``; None = HIRO's.

    Raises:
        InputError: a model and thresholds, thresholds of other axes or out of order, a model of other axes, units or
            period, a step that is no multiple of the encoder's window, or nothing to observe.
    """
    if model is not None and thresholds is not None:
        raise InputError("A model has its own thresholds; give a model or thresholds, not both.")
    chain, heads, limits = _chain(model, axes, preset() if thresholds is None else thresholds)
    if config.senses_words and config.periods % chain.config.window:
        raise InputError(
            f"periods is {config.periods}; with words or beliefs expected a multiple of the encoder's window, "
            f"{chain.config.window}."
        )
    if limits.shape[0] != axes or not np.isclose(chain.config.dt, CONTROL_PERIOD):
        raise InputError(
            f"The model expects {limits.shape[0]} axes every {chain.config.dt:g} s; this scenario has {axes} every "
            f"{CONTROL_PERIOD:g} s."
        )
    if model is not None and axes == len(AXES):
        model.check_wrench("The scenario's wrench")
    elif model is not None:
        model.check_axes(model.axes, UNITS * (axes // len(UNITS)), "The scenario's wrench")
    senses = Senses(config.observe, axes, joints, chain, limits.astype(np.float32), heads)
    if not sum(senses.sizes.values()):
        raise InputError("observe names only beliefs, which need a model; give one, or observe something else.")
    return senses


def _chain(model: IntrospectionModel | None, axes: int, thresholds: Thresholds) -> tuple[Chain, tuple[Any, ...], Any]:
    if model is not None:
        return Chain.of(model), tuple(head_arrays(head) for head in model.heads), model.stacked_limits
    config = EncoderConfig(dt=CONTROL_PERIOD)
    limits = checked_limits(config, thresholds)
    if limits.shape not in ((6, 4), (axes, 4)):
        raise InputError(f"Thresholds have shape {limits.shape}; expected [6, 4] of every wrist, or [{axes}, 4].")
    return Chain(config, (), (), ()), (), np.tile(limits, (axes // len(limits), 1))
