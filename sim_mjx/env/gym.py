"""Environments for learners that use Gymnasium; needs the extra ``gym``.

:class:`VectorEnv` steps many environments in one compiled call, and begins the next episode where one has ended;
:class:`SingleEnv` is a single environment.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax.errors import InputError
from sim_mjx.engines.common import select_lanes
from sim_mjx.env.environment import Environment, State
from sim_mjx.env.loading import jit
from sim_mjx.own_code import whole

with needs_extra("gym"):
    import gymnasium
    from gymnasium.vector import AutoresetMode
    from gymnasium.vector.utils import batch_space

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]
Seeds = int | Sequence[int | None] | NDArray[np.integer]  # one of all environments, or one of each


def spaces(env: Environment) -> tuple[Any, Any]:
    """Gymnasium's spaces of one environment's observations and actions."""
    low, high = env.senses.bounds
    actions = gymnasium.spaces.Box(-1.0, 1.0, (env.action_size,), np.float32)
    return gymnasium.spaces.Box(low, high, dtype=np.float32), actions


class _WithoutPictures:
    """What both kinds of environments have in common."""

    def render(self) -> NoReturn:
        """Refused with an InputError: there are no pictures."""
        raise InputError('Environments draw no pictures; "rcbht view" shows trials of a store.')


class VectorEnv(_WithoutPictures, gymnasium.vector.VectorEnv):
    """Environments that step together; where an episode has ended, a new one begins.

    Args:
        env: made by :func:`sim_mjx.env.load`.
        num_envs: number of environments.
        seed: of the first episodes, unless :meth:`reset` is given another; a list has one for each environment.
        autoreset_mode: when a new episode begins, as Gymnasium names it: "NextStep" = with the step after the end;
            "SameStep" = with the last step, whose observation and infos are the infos "final_obs" and "final_info";
            "Disabled" = when :meth:`reset` is called.

    Raises:
        InputError: ``env`` is none, fewer than one environment, a negative seed, another number of seeds, or an unknown
            mode.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012  # Gymnasium wants a plain class attribute

    def __init__(
        self,
        env: Environment,
        num_envs: int,
        seed: Seeds = 0,
        autoreset_mode: Any = AutoresetMode.NEXT_STEP,
    ) -> None:
        if not whole(num_envs, 1):
            raise InputError(f"num_envs is {num_envs!r}; expected a whole number, 1 or more.")
        self.env, self.num_envs = _environment(env), int(num_envs)
        self._keys = _keys(seed, jax.random.split(_key(0), self.num_envs))
        self._mode = _mode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self._mode}
        self.single_observation_space, self.single_action_space = spaces(env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._reset, self._step = jit(_reset, static_argnums=0), jit(_step, static_argnums=(0, 1))
        self._select = jit(select_lanes)
        self._state: State | None = None

    def reset(
        self, *, seed: Seeds | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode in every environment, or in some.

        Args:
            seed: of these and all later episodes of the environments that begin one; None = go on with the present
                one. A list has one for each environment, whose episodes then depend on it and their number alone.
            options: "reset_mask" = where to begin an episode, bool [num_envs]; the others go on.
                Other options are not used.

        Raises:
            InputError: after :meth:`close`, a negative seed, or another number of seeds; a mask with a wrong shape or
                type, or true nowhere; or one that is not true everywhere before the first reset.
        """
        self._check_open()
        mask = _mask(options, self.num_envs)
        kept = None if mask is None else _started(self._state)
        keys = self._keys if seed is None else _keys(seed, self._keys)
        super().reset(seed=None if seed is None or isinstance(seed, Sequence | np.ndarray) else int(seed))
        begun = self._reset(self.env, keys)
        self._keys, self._state = begun if mask is None else self._select(mask, begun, (self._keys, kept))
        return _host(self._state.obs), _infos(self._state)

    def step(self, actions: ArrayLike) -> tuple[Floats, Floats, Bools, Bools, dict[str, Any]]:
        """Step all environments.

        With the mode "NextStep", the action is ignored where an episode had ended: the next episode begins.

        Raises:
            InputError: before the first :meth:`reset` or after :meth:`close`, actions with a wrong shape or NaN, or no
                numbers, or with the mode "Disabled" an episode that has ended.
        """
        self._check_open()
        state, values = _started(self._state), _checked(actions, (self.num_envs, self.env.action_size))
        if self._mode is AutoresetMode.DISABLED and (over := np.flatnonzero(_host(state.done) > 0.5)).size:
            raise InputError(
                f"The episodes of the environments {over.tolist()} have ended; give reset their reset_mask first."
            )
        self._keys, self._state, reached = self._step(self.env, self._mode, state, values, self._keys)
        obs, reward, ended, truncated, infos = jax.tree.map(_host, reached)
        if self._mode is AutoresetMode.SAME_STEP:
            final = _final(obs, infos, ended) if ended.any() else {}
            obs, infos = _host(self._state.obs), _infos(self._state) | final
        return obs, reward, ended & ~truncated, truncated, infos

    def _check_open(self) -> None:
        if self.closed:
            raise InputError("The environments are closed; make new ones.")


class SingleEnv(_WithoutPictures, gymnasium.Env):
    """One environment.

    Args:
        env: made by :func:`sim_mjx.env.load`.
        seed: seed of the first episode, unless :meth:`reset` is given another.

    Raises:
        InputError: ``env`` is none, or a negative seed.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # Gymnasium wants a plain class attribute

    def __init__(self, env: Environment, seed: int = 0) -> None:
        self.env, self._key = _environment(env), _key(seed)
        self.observation_space, self.action_space = spaces(env)
        self._reset, self._step = jit(env.reset), jit(env.step)
        self._state: State | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode; ``options`` are not used."""
        if seed is not None:
            self._key, seed = _key(seed), int(seed)
        super().reset(seed=seed)
        self._key, key = jax.random.split(self._key)
        self._state = self._reset(key)
        return _host(self._state.obs), _infos(self._state)

    def step(self, action: ArrayLike) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """One step.

        Raises:
            InputError: before the first :meth:`reset`, or an action with a wrong shape or NaN, or no numbers.
        """
        self._state = self._step(_started(self._state), _checked(action, (self.env.action_size,)))
        truncated = bool(self._state.info["truncation"] > 0.5)
        ended = bool(self._state.done > 0.5) and not truncated
        return _host(self._state.obs), float(self._state.reward), ended, truncated, _infos(self._state)


def _reset(env: Environment, keys: Any) -> tuple[Any, State]:
    """New episodes, and the keys of those after them."""
    pairs = jax.vmap(jax.random.split)(keys)
    return pairs[:, 0], jax.vmap(env.reset)(pairs[:, 1])


def _step(env: Environment, mode: Any, state: State, actions: Any, keys: Any) -> tuple[Any, State, tuple[Any, ...]]:
    """Keys, the state from which the next step goes on, and what this step has reached (another with "SameStep")."""
    after = reached = jax.vmap(env.step)(state, actions)
    # a key advances only where an episode begins, so that the next one does not depend on how long this one takes
    if mode is AutoresetMode.SAME_STEP:
        keys, after = select_lanes(reached.done > 0.5, _reset(env, keys), (keys, reached))
    elif mode is AutoresetMode.NEXT_STEP:
        keys, after = select_lanes(state.done > 0.5, _reset(env, keys), (keys, reached))
        reached = after
    ended, truncated = reached.done > 0.5, reached.info["truncation"] > 0.5
    return keys, after, (reached.obs, reached.reward, ended, truncated, _named(reached))


def _final(obs: Floats, infos: dict[str, Any], ended: Bools) -> dict[str, Any]:
    """What has been reached where episodes have ended, in the form of Gymnasium's infos."""
    last = np.full(len(ended), None, object)
    for lane in np.flatnonzero(ended):
        last[lane] = obs[lane]
    each = infos | {f"_{name}": ended.copy() for name in infos}
    return {"final_obs": last, "_final_obs": ended.copy(), "final_info": each, "_final_info": ended.copy()}


def _mode(mode: Any) -> Any:
    """Gymnasium's mode, which may be given by its name."""
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        known = ", ".join(repr(one.value) for one in AutoresetMode)
        raise InputError(f"autoreset_mode is {mode!r}; expected one of {known}.") from error


def _mask(options: dict[str, Any] | None, count: int) -> Bools | None:
    """Where a reset begins an episode; None = everywhere."""
    if not options or options.get("reset_mask") is None:
        return None
    mask = np.asarray(options["reset_mask"])
    if mask.dtype != np.bool_ or mask.shape != (count,) or not mask.any():
        raise InputError(f"reset_mask is {options['reset_mask']!r}; expected bool [{count}], true once or more.")
    return None if mask.all() else mask


def _keys(seed: Seeds, present: Any) -> Any:
    """The keys of environments ``[num_envs]``, of one seed or of one each; None in a list = the present one."""
    if not isinstance(seed, Sequence | np.ndarray):
        return jax.random.split(_key(seed), len(present))
    if len(seed) != len(present):
        raise InputError(f"There are {len(seed)} seeds for {len(present)} environments.")
    return jnp.stack([key if one is None else _key(one) for one, key in zip(seed, present, strict=True)])


def _key(seed: Any) -> Any:
    """The key of a seed of any size, whose lowest 32 bits JAX would take alone."""
    if not whole(seed, 0):
        raise InputError(f"seed is {seed!r}; expected a whole number, zero or more.")
    rest, low = divmod(int(seed), 2**32)
    key = jax.random.key(low)
    while rest:
        rest, low = divmod(rest, 2**32)
        key = jax.random.fold_in(key, np.uint32(low))
    return key


def _environment(env: Any) -> Environment:
    if not isinstance(env, Environment):
        raise InputError(f"The environment is {env!r}; expected what sim_mjx.env.load returns.")
    return env


def _started(state: State | None) -> State:
    if state is None:
        raise InputError("The environment has no episode yet; call reset first.")
    return state


def _checked(actions: ArrayLike, shape: tuple[int, ...]) -> Floats:
    try:
        values = np.asarray(actions, np.float32)
    except (TypeError, ValueError) as error:
        raise InputError(f"The actions are no array of numbers; expected float32 {list(shape)}.") from error
    if values.shape != shape:
        raise InputError(f"The actions have shape {values.shape}; expected {shape}.")
    if np.isnan(values).any():
        raise InputError("An action is NaN; expected numbers within -1 and 1.")
    return values


def _host(values: Any) -> NDArray[Any]:
    return np.array(values)  # a copy: learners write into what they are given


def _infos(state: State) -> dict[str, Any]:
    return {name: _host(value) for name, value in _named(state).items()}


def _named(state: State) -> dict[str, Any]:
    return {**state.metrics, **state.info}
