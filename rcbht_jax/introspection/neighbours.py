"""Distances of a moment to nominal recordings at about the same time: the compiled part of the nominal monitor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Float32, Int
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

BLOCK = 32  # moments per compiled call
ROWS, TIMES, REACHES = 16, 64, 8  # sizes are rounded up to these, so that few programs are compiled
LEAST_SCALE = 0.05  # of the standard deviation of a feature over all nominal moments
LEAST_REFERENCE = 0.5  # of the median nominal distance of a channel
AROUND = 5  # moments before and after over which the usual distance is taken


@dataclass(frozen=True)
class Bank:
    """Nominal recordings, described, and what is usual among them.

    Padding: a recording that has ended stays as it ended; times before the beginning, and rows beyond the last
    recording, are infinite. A bank of ``recording`` rows and ``moment`` times stands in ``described`` with ``reach``
    times before and after.
    """

    described: Float32[np.ndarray, "_ row channel kind"]  # [reach + time + reach, ...], in units of the scale
    scale: Float[np.ndarray, "channel kind"]  # of each feature
    reference: Float[np.ndarray, "moment channel"]  # usual distance of a held-out nominal recording
    recordings: int
    reach: int  # longest time, in moments, by which a neighbour may be early or late
    slack: float  # moments
    drift: float  # share of the elapsed time
    neighbours: int


def make_bank(
    described: list[Float[np.ndarray, "_ channel kind"]],
    groups: Int[np.ndarray, " recording"],
    slack: float,
    drift: float,
    neighbours: int,
) -> Bank:
    """What a monitor learns.

    Args:
        described: nominal recordings ``[time, channel, kind]``.
        groups: of each; what differs between groups is not compared. A single group = each recording by itself.
        slack: moments by which a neighbour may be early or late.
        drift: the same, as a share of the elapsed time.
        neighbours: nearest recordings whose distance is averaged.

    Raises:
        InputError: fewer than two recordings, or bad numbers.
    """
    if len(described) < 2 or neighbours < 1 or slack < 0 or drift < 0:
        raise InputError(
            f"{len(described)} nominal recordings, {neighbours} neighbours, slack {slack:g}, drift {drift:g}; "
            "it takes two recordings, one neighbour, and no negative times."
        )
    groups = groups if len(np.unique(groups)) > 1 else np.arange(len(described))
    time = max(len(part) for part in described)
    held = np.stack([part[np.minimum(np.arange(time), len(part) - 1)] for part in described])
    squares = [
        np.mean((held[groups == name] - np.median(held[groups != name], 0)) ** 2, (0, 1)) for name in np.unique(groups)
    ]
    spread = held.std((0, 1))
    scale = np.maximum(np.sqrt(np.mean(squares, 0)), LEAST_SCALE * spread)
    scale = np.where(scale > 0, scale, 1.0)  # a feature that never changes
    reach = _up(int(np.ceil(slack + drift * time)), REACHES)
    shape = (_up(time, TIMES) + 2 * reach, _up(len(described), ROWS), *held.shape[2:])
    padded = np.full(shape, np.inf, np.float32)
    scaled = np.moveaxis(held / scale, 0, 1)
    padded[reach : reach + time, : len(described)] = scaled
    padded[reach + time :, : len(described)] = scaled[-1]
    bank = Bank(padded, scale, np.ones((time, held.shape[2])), len(described), reach, slack, drift, neighbours)
    return Bank(**{**vars(bank), "reference": _reference(bank, described, groups)})


def distances(
    bank: Bank, described: Float[np.ndarray, "time channel kind"], time: Int[np.ndarray, " time"]
) -> Float32[np.ndarray, "time recording channel"]:
    """Distance to the nearest moment of each nominal recording, root mean square over the kinds of features.

    Args:
        bank: the nominal recordings.
        described: moments of a recording, not scaled.
        time: of each, in moments since the beginning.
    """
    last = len(bank.reference) - 1
    scaled = (described / bank.scale).astype(np.float32)
    count = len(time)
    room = _up(count, BLOCK)
    rows = np.minimum(np.arange(room), max(count - 1, 0))
    out = [np.zeros((0, bank.recordings, described.shape[1]), np.float32)]
    rows_of_bank = jnp.asarray(bank.described)
    for start in range(0, count, BLOCK):
        part = rows[start : start + BLOCK]
        allowed = (bank.slack + bank.drift * time[part]).astype(np.float32)
        near = _nearest_moments(
            rows_of_bank, scaled[part], np.minimum(time[part], last).astype(np.int32), allowed, 2 * bank.reach + 1
        )
        out.append(np.asarray(near)[:, : bank.recordings])
    return np.concatenate(out)[:count]


def nearest(
    distance: Float[np.ndarray, "time recording channel"], neighbours: int
) -> Float[np.ndarray, "time channel"]:
    """Mean of the smallest distances over the recordings, as many as there are if there are fewer."""
    count = min(neighbours, distance.shape[1])
    return np.sort(distance, 1)[:, :count].mean(1, dtype=np.float64)


def _reference(
    bank: Bank, described: list[NDArray[np.float64]], groups: NDArray[np.int64]
) -> Float[np.ndarray, "moment channel"]:
    """Median distance of nominal recordings to those of other groups, around each time."""
    time = len(bank.reference)
    usual = np.full((len(described), time, bank.reference.shape[1]), np.nan)
    for row, part in enumerate(described):
        others = distances(bank, part, np.arange(len(part)))[:, groups != groups[row]]
        usual[row, : len(part)] = nearest(others, bank.neighbours)
    at_times = [
        np.nanmedian(usual[:, max(moment - AROUND, 0) : moment + AROUND + 1], (0, 1)) for moment in range(time)
    ]
    least = LEAST_REFERENCE * np.nanmedian(usual, (0, 1))
    return np.maximum(np.stack(at_times), np.where(least > 0, least, 1.0))


@partial(jax.jit, static_argnames="window")
def _nearest_moments(
    bank: Float[jax.Array, "padded row channel kind"],
    described: Float[jax.Array, "block channel kind"] | Float[np.ndarray, "block channel kind"],
    time: Int[jax.Array, " block"] | Int[np.ndarray, " block"],
    allowed: Float[jax.Array, " block"] | Float[np.ndarray, " block"],
    window: int,
) -> Float[jax.Array, "block row channel"]:
    """One moment after the other, so that each is computed alike wherever it stands in a block."""
    offset = jnp.abs(jnp.arange(window) - window // 2).astype(jnp.float32)

    def one(moment: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        here, now, slack = moment
        around = jax.lax.dynamic_slice_in_dim(bank, now, window)
        square = jnp.mean((around - here) ** 2, -1)
        return jnp.sqrt(jnp.min(jnp.where(offset[:, None, None] <= slack, square, jnp.inf), 0))

    return jax.lax.map(one, (jnp.asarray(described), jnp.asarray(time), jnp.asarray(allowed)))


def _up(count: int, multiple: int) -> int:
    return -(-count // multiple) * multiple
