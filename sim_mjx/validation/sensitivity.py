"""Derivatives of the simulated wrench by parameters of the parts, in forward mode through MJX's physics.

Contact makes the wrench a rough function of the parts: an elliptic cone gives no derivative where it is entered, and
a contact that begins with its full stiffness makes the wrench jump by when it begins. In the *smooth setting* friction
cones are pyramids, every contact begins without stiffness and hardens within its first fifth of a millimetre, the hand
follows a given path (:mod:`sim_mjx.validation.driven`), and the sensor neither rounds nor adds noise. There the
derivatives exist, and those of forward mode are those of central differences.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float, Float64

from rcbht_jax._util.compiling import jit
from rcbht_jax.types import Array
from sim_mjx.assembly.parts import Fields, PartParams
from sim_mjx.assembly.scene import Scene
from sim_mjx.engines import device
from sim_mjx.engines.common import SETTLING
from sim_mjx.engines.device import Fixed
from sim_mjx.engines.quiet import mjx
from sim_mjx.randomization import overrides

SOFT = 1e-4  # impedance with which a contact begins; MuJoCo takes no less
Wrenches = Float[Array, "trial time 6"]
Statistics = Callable[[Wrenches], Float[Array, "trial statistic"]]


def smooth(scene: Scene) -> Scene:
    """A scene with hooks in the smooth setting; its hand should be :func:`sim_mjx.validation.driven.driven`.

    >>> from sim_mjx.assembly.scene import hooked
    >>> smooth(hooked(4)).model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    True
    """
    model = copy.copy(scene.model)
    model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    model.opt.tolerance = 1e-10
    model.pair_solimp[:, 0] = SOFT
    return replace(scene, model=model, fields=partial(_soft_fields, scene.fields))


def _soft_fields(fields: Callable[[Any], Fields], params: Any) -> Fields:
    out = fields(params)
    out["pair_solimp"][..., 0] = SOFT
    return out


def field_derivatives(scene: Scene, parts: Sequence[PartParams], name: str, step: float) -> Fields:
    """Derivatives of the model's fields by one parameter, [trial, ...].

    The fields are closed formulas of the parts: their central differences are exact to nine digits.

    Args:
        scene: what is simulated. parts: one trial's each.
        name: of the parameter, as in :mod:`sim_mjx.randomization.overrides`; without brackets all elements move.
        step: half the distance of the differences, in the parameter's unit.

    Raises:
        InputError: there is no such parameter.

    >>> from sim_mjx.assembly.scene import hooked
    >>> from sim_mjx.presets import HOOKED
    >>> tangent = field_derivatives(hooked(4), [HOOKED["hooked-B"].parts], "parts.mount_stiffness[2]", 1.0)
    >>> [name for name, value in tangent.items() if np.abs(value).max() > 0]
    ['jnt_stiffness']
    """
    ends = [[scene.fields(moved(one, name, by)) for one in parts] for by in (step, -step)]
    return {
        field: np.stack([(up[field] - down[field]) / (2 * step) for up, down in zip(*ends, strict=True)])
        for field in ends[0][0]
    }


def moved(parts: PartParams, name: str, by: float) -> PartParams:
    """Parts of one trial whose parameter ``name`` is larger by ``by``, in all elements that the name covers.

    >>> from sim_mjx.presets import HOOKED
    >>> parts = HOOKED["hooked-B"].parts
    >>> (moved(parts, "parts.mount_stiffness[2]", 5.0).mount_stiffness - parts.mount_stiffness).tolist()
    [0.0, 0.0, 5.0]
    """
    overrides.check(((name, by),))
    attribute, values, where = overrides.element(parts, name)
    values[where] += by
    return replace(parts, **{attribute: values})


def wrench_and_derivatives(
    scene: Scene, params: Any, tangents: Sequence[Fields], statistics: Statistics
) -> tuple[Float64[np.ndarray, "trial statistic"], Float64[np.ndarray, "trial statistic parameter"]]:
    """Statistics of the wrenches of a batch of trials, and their derivatives, in JAX's current precision.

    Args:
        scene: in the smooth setting. params: batch of driven trials.
        tangents: derivatives of the model's fields by each parameter; see :func:`field_derivatives`.
        statistics: of the wrenches; differentiable.

    >>> tangents = [field_derivatives(scene, [trial.parts], "parts.friction", 1e-4)]  # doctest: +SKIP
    >>> means = lambda wrench: jnp.mean(wrench, axis=1)  # doctest: +SKIP
    >>> wrench_and_derivatives(smooth(scene), stack([trial]), tangents, means)  # doctest: +SKIP
    """
    job = _Job(scene, params, statistics)
    names = tuple(tangents[0])
    along = {name: jnp.stack([jnp.asarray(one[name], job.real) for one in tangents]) for name in names}

    def forward(directions: dict[str, Array]) -> tuple[Array, Array]:
        still = {name: jnp.zeros_like(leaf) for name, leaf in job.fixed.fields.items() if name not in names}
        return jax.jvp(job.run, (job.fixed.fields,), (still | directions,))

    found, derivatives = jit()(jax.vmap(forward, out_axes=(None, -1)))(along)
    return np.asarray(found, np.float64), np.asarray(derivatives, np.float64)


def values(scene: Scene, params: Any, statistics: Statistics) -> Float64[np.ndarray, "trial statistic"]:
    """The statistics alone; arguments as of :func:`wrench_and_derivatives`."""
    job = _Job(scene, params, statistics)
    return np.asarray(jit()(job.run)(job.fixed.fields), np.float64)


class _Job:
    """A batch of driven trials as a function of the model's fields."""

    def __init__(self, scene: Scene, params: Any, statistics: Statistics) -> None:
        self.real = jnp.result_type(float)
        self.layout, self.statistics = device.layout_of(scene), statistics
        self.periods = int(np.asarray(params.periods).max())
        model, empty = mjx.put_model(scene.model, impl="jax"), mjx.make_data(scene.model, impl="jax")
        fields = {
            name: jnp.asarray(field, self.real) for name, field in device.fields_of(scene, params, np.float64).items()
        }
        self.fixed = Fixed(model, fields, jax.tree.map(self._cast, params), empty)

    def _cast(self, leaf: Any) -> Array:
        leaf = np.asarray(leaf)
        return jnp.asarray(leaf, self.real if leaf.dtype.kind == "f" else leaf.dtype)

    def run(self, fields: dict[str, Array]) -> Float[Array, "trial statistic"]:
        """Settle, follow the path, and compute the statistics of the wrench."""
        fixed = replace(self.fixed, fields=fields)
        settling = -(-SETTLING // self.layout.substeps)
        stretches = -(-(settling + self.periods) // device.STRETCH)
        start = device.start(self.layout, fixed)
        _, log = jax.lax.scan(lambda at, _: device.stretch(self.layout, fixed, at), start, length=stretches)
        wrench = log.wrench.reshape(-1, *log.wrench.shape[2:])[settling : settling + self.periods]
        return self.statistics(jnp.swapaxes(wrench, 0, 1))
