"""Derivatives through the physics: forwards they pass, backwards one sentence says so."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from sim_mjx.engines import device
from sim_mjx.engines.common import forward_only
from sim_mjx.registry import get_scenario


def chain(x: Any) -> Any:
    """Something scanned, of which a pytree with whole numbers is passed on."""

    def step(at: Any, _: None) -> tuple[Any, None]:
        return forward_only({"x": at["x"] * at["x"], "count": at["count"] + 1}), None

    return jax.lax.scan(step, {"x": x, "count": 0}, length=3)[0]["x"].sum()


def test_forward_derivatives_are_those_without_it() -> None:
    x = jnp.array([1.1, 0.9])
    for function in (chain, jax.jit(chain)):
        np.testing.assert_allclose(jax.jacfwd(function)(x), 8 * x**7, rtol=1e-5)
    batch = jnp.stack([x, 2 * x])
    slopes = jax.vmap(jax.jacfwd(chain))(batch)
    np.testing.assert_allclose(slopes, 8 * batch**7, rtol=1e-5)
    moved = jax.jvp(jax.vmap(jax.jit(chain)), (batch,), (jnp.ones_like(batch),))[1]
    np.testing.assert_allclose(moved, (8 * batch**7).sum(1), rtol=1e-5)
    assert "forwards" not in str(jax.make_jaxpr(chain)(x))  # programs without derivatives are as they were


@pytest.mark.parametrize("function", [chain, jax.jit(chain), lambda x: jax.vmap(chain)(jnp.stack([x, x])).sum()])
def test_reverse_derivatives_are_refused(function: Any) -> None:
    with pytest.raises(InputError, match=r"in reverse mode .* use forward mode: jax\.jvp or jax\.jacfwd"):
        jax.grad(function)(jnp.array([1.1, 0.9]))


def test_a_step_of_the_physics_says_so() -> None:
    scenario = get_scenario("A")
    scene = scenario.scene()
    params = scenario.draw_batch(0, (0,), scenario.spec(nominal_share=1.0))[0]
    model, empty = device.put_scene(scene, 1, "jax")
    fields = {name: jnp.asarray(values[0]) for name, values in device.fields_of(scene, params).items()}

    def force(ctrl: Any) -> Any:
        return device.step_trial(model, empty, fields, device.body_of(empty), ctrl).sensordata.sum()

    loose = jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard")  # which MJX asks for
    with loose[0], loose[1], pytest.raises(InputError, match="in reverse mode"):
        jax.make_jaxpr(jax.grad(force))(jnp.zeros(scene.model.nu))  # traced, not compiled


def test_a_step_of_warp_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its buffers pass from step to step untouched; a function between two steps ended every program on a GPU."""

    def fail(values: Any) -> Any:
        raise AssertionError(values)

    model, empty = device.put_scene(get_scenario("A").scene(), 1, "jax")
    monkeypatch.setattr(device, "forward_only", fail)
    monkeypatch.setattr(device.mjx, "step", lambda _, data: data)
    monkeypatch.setattr(device.mjx.Model, "impl", device.mjx.Impl.WARP)
    after = device.step_trial(model, empty, {}, empty, empty.ctrl + 1)
    np.testing.assert_array_equal(after.ctrl, empty.ctrl + 1)
