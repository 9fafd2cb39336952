"""The published rules as one GPU kernel: a thread walks a lane's windows with the encoder's state in registers.

A scan on a GPU launches kernels for every window and keeps its state in memory; this kernel does the same arithmetic,
with the same functions, in one launch. It writes labels in order of time first, so that neighbouring lanes write side
by side. Written in Pallas for Triton.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton
from jaxtyping import Float, Int

from rcbht_jax.encoding import segments
from rcbht_jax.encoding.encoder import (
    FLUSH_SLOTS,
    EncoderConfig,
    EncoderState,
    chain,
    drain,
    track_of,
)
from rcbht_jax.types import Array, LabelTrack, LabelTracks, Segment

BLOCK = 128  # lanes of one program
WARPS = 4  # one lane a thread
_HELD = 8
_INTEGERS = ("label", "t0", "t1", "emit")
_FIELDS = tuple(field.name for field in fields(LabelTrack))
_AHEAD = 32  # samples of windows up to this long are loaded one window ahead
_LARGEST = 2**31 - 1  # elements that 32-bit offsets reach


def fits(config: EncoderConfig, wrench: Array) -> bool:
    """Whether the kernel can encode recordings ``[trial, time, axis]``: single precision, 32-bit offsets."""
    windows = -(-wrench.shape[1] // config.window)
    slots = (windows + max(FLUSH_SLOTS)) * wrench.shape[0] * wrench.shape[2]
    return wrench.dtype == jnp.float32 and max(slots, wrench.size) <= _LARGEST


Divide = Callable[[Array, Array], Array]
Scan = Callable[[EncoderConfig, Array, Array, Array], LabelTracks]


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def encode_where_gpu(config: EncoderConfig, scan: Scan, limits: Array, wrench: Array, length: Array) -> LabelTracks:
    """Labels ``[trial, axis, slot]``: by the kernel where the program runs on a CUDA GPU, by ``scan`` elsewhere.

    Args:
        config: static configuration.
        scan: the same from (config, limits, wrench, length), also for derivatives.
        limits: ``[4, lane]``. wrench: ``[trial, time, axis]``. length: ``[trial]``.
    """
    trials, _, axes = wrench.shape

    def kernel(limits: Array, wrench: Array, length: Array) -> LabelTracks:
        tracks = encode(config, limits, wrench, length)
        return jax.tree.map(lambda leaf: jnp.moveaxis(leaf.reshape(-1, trials, axes), 0, -1), tracks)

    scanned = partial(scan, config)
    return jax.lax.platform_dependent(limits, wrench, length, cuda=kernel, default=scanned)


@encode_where_gpu.defjvp
def _differentiate(config: EncoderConfig, scan: Scan, at: Any, along: Any) -> tuple[LabelTracks, LabelTracks]:
    return jax.jvp(partial(scan, config), at, along)


def encode(
    config: EncoderConfig,
    limits: Float[Array, "4 lane"],
    wrench: Float[Array, "trial time axis"],
    length: Int[Array, " trial"],
    *,
    block: int = BLOCK,
    warps: int = WARPS,
    interpret: bool = False,
) -> LabelTracks:
    """Dense labels of whole recordings, as :func:`rcbht_jax.encoding.encoder.encode` gives them.

    Args:
        config: static configuration.
        limits: of every lane (axis of a trial), N/s or Nm/s.
        wrench: float32, N and Nm, padded with anything finite.
        length: int32, samples that count.
        block: lanes of one program; a power of two.
        warps: of one program.
        interpret: run without a GPU, slowly, for tests.

    Returns:
        labels ``[slot, lane]``, one slot per window and then those of the end, as many as the layer can hold.
    """
    trials, samples, axes = wrench.shape
    lanes, windows = trials * axes, -(-samples // config.window)
    shapes = [
        jax.ShapeDtypeStruct(((windows + extra) * lanes,), _dtype(name)) for extra in FLUSH_SLOTS for name in _FIELDS
    ]
    state = [
        jax.ShapeDtypeStruct((3 * _HELD * lanes,), jnp.int32),
        jax.ShapeDtypeStruct((4 * _HELD * lanes,), jnp.float32),
        jax.ShapeDtypeStruct((lanes,), jnp.int32),
    ]
    call = pl.pallas_call(
        partial(_kernel, config, samples, axes, lanes, block, jnp.true_divide if interpret else _divide),
        grid=(pl.cdiv(lanes, block),),
        out_shape=[*shapes, *state],
        compiler_params=triton.CompilerParams(num_warps=warps, num_stages=1),
        interpret=interpret,
        name="rcbht_encode",
    )
    spread = jnp.asarray(segments.squared_offsets(config.window, config.dt), jnp.float32)
    *columns, ints, reals, time = call(limits.reshape(-1), spread, jnp.repeat(length, axes), wrench.reshape(-1))
    state_after = EncoderState(time, ints.reshape(-1, lanes), reals.reshape(-1, lanes))
    ends = drain(config, state_after)
    tracks, width = [], len(_FIELDS)
    for number, end in enumerate((ends.primitive, ends.mc, ends.llb)):
        own = [column.reshape(-1, lanes) for column in columns[number * width : (number + 1) * width]]
        last = [getattr(end, name).T for name in _FIELDS]
        joined = (jax.lax.dynamic_update_slice(a, b, (windows, 0)) for a, b in zip(own, last, strict=True))  # in place
        tracks.append(LabelTrack(*joined))
    return LabelTracks(*tracks)


def _dtype(name: str) -> Any:
    return jnp.int8 if name == "label" else jnp.int32 if name in _INTEGERS else jnp.float32


def _kernel(
    config: EncoderConfig, samples: int, axes: int, lanes: int, block: int, divide: Divide,
    limits_ref: Any, spread_ref: Any, length_ref: Any, wrench_ref: Any, *outputs: Any,
) -> None:  # fmt: skip
    """One block of lanes from the first window to the last."""
    *columns, ints_ref, reals_ref, time_ref = outputs
    lane = pl.program_id(0) * block + jnp.arange(block, dtype=jnp.int32)
    inside = lane < lanes
    trial = lane // axes
    first = trial * (samples * axes) + (lane - trial * axes)

    def load(ref: Any, where: Any) -> Array:
        return triton.load(ref.at[where], mask=inside, other=0)

    def store(ref: Any, row: Any, values: Array) -> None:
        triton.store(ref.at[row * lanes + lane], values.astype(ref.dtype), mask=inside)

    limits = tuple(load(limits_ref, row * lanes + lane) for row in range(4))
    length = load(length_ref, lane)

    def sample(index: int | Array) -> Array:
        at = jnp.minimum(index, samples - 1)  # beyond the array nothing counts
        return load(wrench_ref, first + at * axes)

    def window_from(begin: int | Array) -> list[Array]:
        """The samples of a window; of a long one none, which is read as it is summed."""
        return [sample(begin + index) for index in range(config.window)] if config.window <= _AHEAD else []

    def body(window: Array, carry: Any) -> Any:
        time, held, values = carry
        begin = window * config.window
        following = window_from(begin + config.window)  # asked for now, needed a window later
        count = jnp.clip(length - begin, 0, config.window)
        most = jnp.maximum(count, 2)
        n = most.astype(jnp.float32)
        sums = (jnp.zeros(block, jnp.float32), jnp.zeros(block, jnp.float32))

        def add(index: Any, sums: tuple[Array, Array]) -> tuple[Array, Array]:
            y = values[index] if values else sample(begin + index)
            return segments.accumulate(sums, jnp.asarray(index, jnp.int32), y, count, (n - 1) / 2)

        if values:
            for index in range(config.window):
                sums = add(index, sums)
        else:
            sums = jax.lax.fori_loop(0, config.window, add, sums)
        spread, period = load(spread_ref, most), jnp.float32(config.dt)
        slope, x = segments.line_of(*sums, n, spread, period, time, count, divide)
        label = jnp.where(count >= 2, segments.gradient_label(slope, limits), 0)
        size = jnp.where(label > 0, count, 0)
        x = Segment(label, time, time + size, x.vmax, x.vmin, x.area, x.rise)
        held, out = chain(config, held, x)
        for number, segment in enumerate(out):
            track = track_of(segment, time + size, divide)
            for place, name in enumerate(_FIELDS):
                store(columns[number * len(_FIELDS) + place], window, getattr(track, name))
        return time + size, held, following

    whole, real = jnp.zeros(block, jnp.int32), jnp.zeros(block, jnp.float32)
    empty = [Segment(whole, whole, whole, real, real, real, real)] * _HELD
    time, held, _ = jax.lax.fori_loop(0, -(-samples // config.window), body, (whole, empty, window_from(0)))
    for number, segment in enumerate(held):
        for place, values in enumerate((segment.label, segment.t0, segment.t1)):
            store(ints_ref, 3 * number + place, values)
        for place, values in enumerate((segment.vmax, segment.vmin, segment.area, segment.rise)):
            store(reals_ref, 4 * number + place, values)
    store(time_ref, 0, time)


def _divide(x: Array, y: Array) -> Array:
    """The quotient as IEEE 754 rounds it, and as a CPU does; Triton's own may be two digits off."""
    kind = jax.ShapeDtypeStruct(x.shape, jnp.float32)
    (out,) = triton.elementwise_inline_asm(
        "div.rn.f32 $0, $1, $2;", args=[x, y], constraints="=f,f,f", pack=1, result_shape_dtypes=[kind]
    )
    return out
