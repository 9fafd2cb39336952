"""Environments for learners that use Gymnasium; needs the extra ``gym``.

:class:`VectorEnv` steps many environments in one compiled call, and starts the next episode where one has ended;
:class:`SingleEnv` is a single environment.
"""

from __future__ import annotations

from typing import Any, NoReturn

import jax
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


def spaces(env: Environment) -> tuple[Any, Any]:
    """Gymnasium's spaces of one environment's observations and actions."""
    low, high = env.senses.bounds
    actions = gymnasium.spaces.Box(-1.0, 1.0, (env.action_size,), np.float32)
    return gymnasium.spaces.Box(low, high, dtype=np.float32), actions


class VectorEnv(gymnasium.vector.VectorEnv):
    """Environments that step together; where an episode has ended, the next step begins a new one.

    Args:
        env: made by :func:`sim_mjx.env.load`.
        num_envs: number of environments.
        seed: seed of the first episodes, unless :meth:`reset` is given another.

    Raises:
        InputError: ``env`` is none, fewer than one environment, or a negative seed.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012  # Gymnasium wants a plain class attribute

    def __init__(self, env: Environment, num_envs: int, seed: int = 0) -> None:
        if not whole(num_envs, 1):
            raise InputError(f"num_envs is {num_envs!r}; expected a whole number, 1 or more.")
        self.env, self.num_envs, self._key = _environment(env), int(num_envs), _key(seed)
        self.single_observation_space, self.single_action_space = spaces(env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._reset, self._step = jit(_reset, static_argnums=(0, 1)), jit(_step, static_argnums=0)
        self._state: State | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode in every environment; ``options`` are not used."""
        super().reset(seed=seed)
        if seed is not None:
            self._key = _key(seed)
        self._key, key = jax.random.split(self._key)
        self._state = self._reset(self.env, self.num_envs, key)
        return _host(self._state.obs), _infos(self._state)

    def step(self, actions: ArrayLike) -> tuple[Floats, Floats, Bools, Bools, dict[str, Any]]:
        """Step all environments; where an episode had ended, the action is ignored and the next episode begins.

        Raises:
            InputError: before the first :meth:`reset`, or actions with a wrong shape or NaN, or no numbers.
        """
        state, values = _started(self._state), _checked(actions, (self.num_envs, self.env.action_size))
        self._key, key = jax.random.split(self._key)
        self._state = self._step(self.env, state, values, key)
        ended, truncated = (_host(x) > 0.5 for x in (self._state.done, self._state.info["truncation"]))
        return (
            _host(self._state.obs), _host(self._state.reward), ended & ~truncated, truncated, _infos(self._state)
        )  # fmt: skip

    def render(self) -> NoReturn:
        """Refused: there are no pictures.

        Raises:
            InputError: always.
        """
        _refuse_pictures()


class SingleEnv(gymnasium.Env):
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
        super().reset(seed=seed)
        if seed is not None:
            self._key = _key(seed)
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

    def render(self) -> NoReturn:
        """Refused: there are no pictures.

        Raises:
            InputError: always.
        """
        _refuse_pictures()


def _reset(env: Environment, count: int, key: Any) -> State:
    return jax.vmap(env.reset)(jax.random.split(key, count))


def _step(env: Environment, state: State, actions: Any, key: Any) -> State:
    """Step the running episodes, and begin those that follow ended ones."""
    stepped, fresh = jax.vmap(env.step)(state, actions), _reset(env, len(actions), key)
    return select_lanes(state.done > 0.5, fresh, stepped)


def _key(seed: int) -> Any:
    """The key of a seed of any size, whose lowest 32 bits JAX would take alone.

    Raises:
        InputError: it is negative or no whole number.
    """
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


def _refuse_pictures() -> NoReturn:
    raise InputError('Environments draw no pictures; "rcbht view" shows trials of a store.')


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
    return {name: _host(value) for name, value in {**state.metrics, **state.info}.items()}
