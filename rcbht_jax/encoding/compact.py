"""Whole batches of recordings encoded on the device: wrench in, label tracks out, nothing through the host.

Same labels, bit for bit, as :func:`rcbht_jax.encoding.batch.encode_batch`, which is better where recordings differ much in
length or where memory is short: here all are scanned at once to the end of the longest.
"""

from __future__ import annotations

from dataclasses import fields
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rcbht_jax.encoding.encoder import EncoderConfig, encode
from rcbht_jax.types import Array, LabelTrack, LabelTracks

# Sizes are rounded up, so that few programs are compiled: slots of a compact track to this, ...
WIDTH = 32
STRETCH = 200  # ... recordings to this many windows, ...
ROWS = 64  # ... and batches to this many recordings


def encode_on_device(
    config: EncoderConfig, limits: Array, wrench: Array, length: Array, *, together: int = 2048
) -> LabelTracks:
    """Labels of a batch of recordings in the compact form.

    Args:
        config: static configuration.
        limits: float ``[6, 4]`` or ``[recording, 6, 4]``, see Thresholds.
        wrench: float32 ``[recording, time, 6]`` on the device, N and Nm, padded with anything finite.
        length: int32 ``[recording]``, samples that count.
        together: recordings that are scanned at once; bounds the memory, about 14 kB per recording and window.

    Returns:
        device arrays ``[recording, 6, slot]``; unused slots are at the end and zero.
    """
    count, samples = wrench.shape[:2]
    stretch = config.window * STRETCH
    limits = jnp.broadcast_to(jnp.asarray(limits, wrench.dtype), (count, *limits.shape[-2:]))
    spare = -count % (ROWS if count < together else together)
    wrench = jnp.pad(wrench, ((0, spare), (0, -samples % stretch), (0, 0)))
    limits, length = jnp.pad(limits, ((0, spare), (0, 0), (0, 0)), mode="edge"), jnp.pad(length, (0, spare))
    pieces = []
    for start in range(0, count, together):
        rows = slice(start, start + together)
        dense, used = _encode(config, limits[rows], wrench[rows], length[rows])
        widths = tuple(max(-(-int(n) // WIDTH), 1) * WIDTH for n in np.asarray(used))
        pieces.append(_compacted(widths, dense))
    return jax.tree.map(lambda *same: _stacked(*same)[:count], *pieces)


@partial(jax.jit, static_argnums=0)
def _encode(config: EncoderConfig, limits: Array, wrench: Array, length: Array) -> tuple[LabelTracks, Array]:
    """Dense labels and, of each layer, the most labels that a lane has."""
    dense = encode(config, limits, wrench, length)
    used = [(track.label != 0).sum(-1).max() for track in (dense.primitive, dense.mc, dense.llb)]
    return dense, jnp.stack(used)


@partial(jax.jit, static_argnums=0)
def _compacted(widths: tuple[int, int, int], dense: LabelTracks) -> LabelTracks:
    tracks = (dense.primitive, dense.mc, dense.llb)
    return LabelTracks(*(_compact(width, track) for width, track in zip(widths, tracks, strict=True)))


def _compact(width: int, track: LabelTrack) -> LabelTrack:
    """The used slots of every lane, in their order."""
    seen = jnp.cumsum(track.label != 0, axis=-1, dtype=jnp.int32)
    wanted = jnp.arange(1, width + 1, dtype=jnp.int32)
    search = partial(jnp.searchsorted, v=wanted, side="left")
    slot = jax.vmap(jax.vmap(search))(seen).astype(jnp.int32)
    there = wanted[None, None] <= seen[..., -1:]
    slot = jnp.where(there, slot, 0)

    def chosen(values: Array) -> Array:
        return jnp.where(there, jnp.take_along_axis(values, slot, axis=-1), jnp.zeros((), values.dtype))

    return LabelTrack(**{field.name: chosen(getattr(track, field.name)) for field in fields(LabelTrack)})


def _stacked(*pieces: Array) -> Array:
    width = max(piece.shape[-1] for piece in pieces)
    return jnp.concatenate([jnp.pad(piece, ((0, 0), (0, 0), (0, width - piece.shape[-1]))) for piece in pieces])
