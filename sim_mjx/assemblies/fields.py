"""Building parts: geoms that touch only through pairs, and the fields of a compiled model that differ per trial."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array
from sim_mjx.assembly.parts import Fields, add_box, add_pair

Vector = tuple[float, float, float]
MALE, FEMALE, MARK = (0.25, 0.45, 0.75, 1.0), (0.45, 0.45, 0.45, 1.0), (0.9, 0.5, 0.1, 1.0)  # colours


def ball(body: mujoco.MjsBody, name: str, place: Vector, radius: float, rgba: Any = MALE) -> None:
    """A sphere without mass that touches only the geoms it is paired with."""
    body.add_geom(name=name, size=(radius, 0.0, 0.0), pos=place, mass=0.0, contype=0, conaffinity=0, rgba=rgba)


def box(body: mujoco.MjsBody, name: str, place: Vector, half: Vector, turn: float = 0.0, rgba: Any = FEMALE) -> None:
    """A box without mass that touches only the geoms it is paired with.

    Args:
        body: the body that carries it. name: of the geom.
        place: position of its centre, m. half: half its sizes, m.
        turn: rotation about z, rad.
        rgba: colour.
    """
    add_box(body, name, half, place, (np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)), rgba)


def mark(body: mujoco.MjsBody, name: str, place: Vector = (0.0, 0.0, 0.0)) -> None:
    """A place of a part by which success is decided; it is not drawn and touches nothing."""
    ball(body, name, place, 1e-4, (0.0, 0.0, 0.0, 0.0))


def touch(spec: mujoco.MjSpec, first: str, second: str) -> None:
    """Let two geoms touch: a sphere and a box, because every engine agrees on those."""
    add_pair(spec, first, second)


class FieldWriter:
    """Collects the fields of a compiled model that a trial, or a batch of them, replaces.

    Args:
        model: compiled.
        lead: shape of the batch; () = one trial.

    Raises:
        InputError: by its methods, the model has no element of a name.
    """

    def __init__(self, model: mujoco.MjModel, lead: tuple[int, ...]) -> None:
        self._model, self._lead = model, lead
        self.fields: Fields = {}

    def nominal(self, field: str, kind: str, name: str) -> Any:
        """The compiled value of a field of MjModel, for one "geom", "body" or "joint"."""
        return getattr(self._model, field)[self._row(kind, name).id].copy()

    def place(self, geom: str, place: Float[Array, "*batch 3"]) -> None:
        """Centre of a geom in its body's frame, m; the body's mass stays where it is."""
        self._set("geom_pos", "geom", geom, place)

    def turn(self, geom: str, quat: Float[Array, "*batch 4"]) -> None:
        """Quaternion of a geom in its body's frame."""
        self._set("geom_quat", "geom", geom, quat)

    def body(self, body: str, place: Float[Array, "*batch 3"], quat: Float[np.ndarray, "*batch 4"]) -> None:
        """Frame of a body in its parent's, m and quaternion.

        Raises:
            InputError: it is a free body, whose place is a state and not a parameter.
        """
        row = self._row("body", body)
        if row.jntnum[0] and self._model.jnt_type[row.jntadr[0]] == mujoco.mjtJoint.mjJNT_FREE:
            raise InputError(
                f"The free body {body!r} begins where it was compiled, so that no trial can place it; give it sliding "
                "joints in place of the free one."
            )
        self._set("body_pos", "body", body, place)
        self._set("body_quat", "body", body, quat)

    def spring(self, joint: str, stiffness: Any, damping: Any) -> None:
        """Stiffness, N/m, and damping, Ns/m, of a sliding joint."""
        row = self._row("joint", joint)
        self._field("jnt_stiffness")[..., row.id] = stiffness
        self._field("dof_damping")[..., row.dofadr[0]] = damping

    def friction(self, sliding: Float[Array, "*batch"]) -> None:
        """Sliding friction of all contacts: of pairs, and of geoms that touch by MuJoCo's rules."""
        self._field("pair_friction")[..., :2] = np.asarray(sliding)[..., None, None]
        touching = (self._model.geom_contype | self._model.geom_conaffinity) != 0
        if touching.any():
            self._field("geom_friction")[..., touching, 0] = np.asarray(sliding)[..., None]

    def _row(self, kind: str, name: str) -> Any:
        """An element of the compiled model."""
        try:
            return getattr(self._model, kind)(name)
        except KeyError as error:
            raise InputError(f"The scene has no {kind} {name!r}, which a trial's parameters are written to.") from error

    def _field(self, name: str) -> Any:
        if name not in self.fields:
            field = getattr(self._model, name)
            self.fields[name] = np.broadcast_to(field, self._lead + field.shape).copy()
        return self.fields[name]

    def _set(self, field: str, kind: str, name: str, value: Any) -> None:
        self._field(field)[..., self._row(kind, name).id, :] = value
