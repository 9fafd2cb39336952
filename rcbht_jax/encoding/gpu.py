"""The published rules as two GPU kernels: a thread walks a lane's windows with the encoder's state in registers.

A scan on a GPU launches kernels for every window and keeps its state in memory; the first kernel does the same
arithmetic, with the same functions, in one launch, and the second one publishes what is held at the end. They write
labels in order of time first, so that neighbouring lanes write side by side; or, packed, each lane's labels one after
the other, with the fields of a label side by side, which spares a compaction afterwards. Written in Pallas for Triton.
The labels are those of the scan on a CPU bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton
from jaxtyping import Float, Int

from rcbht_jax.encoding import segments
from rcbht_jax.encoding.encoder import FLUSH_SLOTS, EncoderConfig, Push, chain, drain_segments, track_of
from rcbht_jax.encoding.segments import Divide
from rcbht_jax.types import Array, LabelTrack, LabelTracks, Segment

BLOCK = 128  # lanes of one program
WARPS = 4  # one lane a thread
_HELD = 8
_ROWS = max(_HELD, *FLUSH_SLOTS)  # of a queue: what is held at first, then what a layer publishes at the end
_AHEAD = 32  # windows up to this many samples are read one window ahead
_INTEGERS = ("label", "t0", "t1", "emit")
_FIELDS = tuple(field.name for field in fields(LabelTrack))
_LARGEST = 2**31 - 1  # elements that 32-bit offsets reach


def fits(config: EncoderConfig, wrench: Array, packed: bool = False) -> bool:
    """Whether the kernels can encode recordings ``[trial, time, axis]``: single precision, 32-bit offsets."""
    windows = -(-wrench.shape[1] // config.window)
    rows = max((windows + max(FLUSH_SLOTS)) * (len(_FIELDS) if packed else 1), 4 * _ROWS)
    return wrench.dtype == jnp.float32 and max(rows * wrench.shape[0] * wrench.shape[2], wrench.size) <= _LARGEST


Scan = Callable[[EncoderConfig, Array, Array, Array], LabelTracks]


def encode_where_gpu(config: EncoderConfig, scan: Scan, limits: Array, wrench: Array, length: Array) -> LabelTracks:
    """Labels ``[trial, axis, slot]``: by the kernels on a CUDA GPU, by ``scan`` elsewhere and for derivatives."""
    columns = iter(_leaves_where_gpu(config, scan, limits, wrench, length))
    return LabelTracks(*(LabelTrack(*(next(columns) for _ in _FIELDS)) for _ in FLUSH_SLOTS))


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _leaves_where_gpu(
    config: EncoderConfig, scan: Scan, limits: Array, wrench: Array, length: Array
) -> tuple[Array, ...]:
    """The columns of the tracks: tangents of integers could not be tracks."""
    trials, _, axes = wrench.shape

    def kernel(limits: Array, wrench: Array, length: Array) -> tuple[Array, ...]:
        columns = jax.tree.leaves(encode(config, limits, wrench, length))
        return tuple(jnp.moveaxis(column.reshape(-1, trials, axes), 0, -1) for column in columns)

    return jax.lax.platform_dependent(limits, wrench, length, cuda=kernel, default=partial(_scanned, config, scan))


def _scanned(config: EncoderConfig, scan: Scan, limits: Array, wrench: Array, length: Array) -> tuple[Array, ...]:
    return tuple(jax.tree.leaves(scan(config, limits, wrench, length)))


@_leaves_where_gpu.defjvp
def _differentiate(config: EncoderConfig, scan: Scan, at: Any, along: Any) -> Any:
    return jax.jvp(partial(_scanned, config, scan), at, along)


def encode(
    config: EncoderConfig,
    limits: Float[Array, "4 lane"],
    wrench: Float[Array, "trial time axis"],
    length: Int[Array, " trial"],
    *,
    block: int = BLOCK,
    interpret: bool = False,
) -> LabelTracks:
    """Dense labels of whole recordings, as :func:`rcbht_jax.encoding.encoder.encode` gives them.

    Args:
        config: static configuration.
        limits: of every lane (axis of a trial), N/s or Nm/s.
        wrench: float32, N and Nm, padded with anything finite.
        length: int32, samples that count.
        block: lanes of one program; a power of two.
        interpret: run without a GPU, slowly, for tests.

    Returns:
        labels ``[slot, lane]``, one slot per window and then those of the end, as many as the layer can hold.
    """
    found, counts = _encoded(config, limits, wrench, length, False, block, interpret)
    flat = (column.reshape(-1, counts.shape[-1]) for column in found)
    return LabelTracks(*(LabelTrack(*(next(flat) for _ in _FIELDS)) for _ in FLUSH_SLOTS))


def encode_packed(
    config: EncoderConfig,
    limits: Float[Array, "4 lane"],
    wrench: Float[Array, "trial time axis"],
    length: Int[Array, " trial"],
    *,
    block: int = BLOCK,
    interpret: bool = False,
) -> tuple[list[Int[Array, "lane _row field"]], Int[Array, "3 lane"]]:
    """As :func:`encode`, each lane's labels one after the other from the first row on.

    Returns:
        of each layer the labels, whose fields are those of a track in their order, real ones as the bits of an int32;
        and how many labels each lane has. Other rows hold anything.
    """
    found, counts = _encoded(config, limits, wrench, length, True, block, interpret)
    lanes = counts.shape[-1]
    return [words.reshape(lanes, -1, len(_FIELDS)) for words in found], counts


def unpacked(words: Int[Array, "*lane field"]) -> LabelTrack:
    """The fields of packed labels."""
    fields = (words[..., place] for place in range(len(_FIELDS)))
    return LabelTrack(*(
        field.astype(_dtype(name)) if name in _INTEGERS else jax.lax.bitcast_convert_type(field, jnp.float32)
        for name, field in zip(_FIELDS, fields, strict=True)
    ))  # fmt: skip


def _encoded(
    config: EncoderConfig, limits: Array, wrench: Array, length: Array, packed: bool, block: int, interpret: bool
) -> tuple[list[Array], Array]:
    """Columns of all layers, or the packed labels of each, flat; and the number of labels, in the packed form."""
    trials, samples, axes = wrench.shape
    lanes, windows = trials * axes, -(-samples // config.window)
    sizes = [(windows + extra) * lanes for extra in FLUSH_SLOTS]
    if packed:
        columns = [jax.ShapeDtypeStruct((size * len(_FIELDS),), jnp.int32) for size in sizes]
    else:
        columns = [jax.ShapeDtypeStruct((size,), _dtype(name)) for size in sizes for name in _FIELDS]
    queue = [
        jax.ShapeDtypeStruct((3 * _ROWS * lanes,), jnp.int32),
        jax.ShapeDtypeStruct((4 * _ROWS * lanes,), jnp.float32),
    ]
    count = jax.ShapeDtypeStruct((len(FLUSH_SLOTS) * lanes,), jnp.int32)
    divide = jnp.true_divide if interpret else _divide
    call = partial(
        pl.pallas_call,
        grid=(pl.cdiv(lanes, block),),
        compiler_params=triton.CompilerParams(num_warps=WARPS, num_stages=1),
        interpret=interpret,
    )
    walk = call(
        partial(_walk, config, samples, axes, lanes, block, divide, packed),
        out_shape=[*columns, *queue, count, jax.ShapeDtypeStruct((lanes,), jnp.int32)],
        name="rcbht_encode",
    )
    # loaded, not compiled in: a compiler must not regroup products of what it knows
    table = jnp.asarray([*segments.squared_offsets(config.window, config.dt), config.dt], jnp.float32)
    *begun, time = walk(limits.reshape(-1), table, length, wrench.reshape(-1))
    # A kernel of its own: in the first one it would cost registers of the walk, and half a minute of compilation.
    end = call(
        partial(_end, config, windows, lanes, block, divide, packed),
        out_shape=[*columns, *queue, count],
        input_output_aliases={number: number for number in range(len(begun))},
        name="rcbht_drain",
    )
    *found, counts = end(*begun, time)
    return found[: len(columns)], counts.reshape(-1, lanes)


def _dtype(name: str) -> Any:
    return jnp.int8 if name == "label" else jnp.int32 if name in _INTEGERS else jnp.float32


class _Lanes:
    """The lanes of one program, and their rows in flat arrays ``[row * lane]``."""

    def __init__(self, lanes: int, block: int) -> None:
        self.number = pl.program_id(0) * block + jnp.arange(block, dtype=jnp.int32)
        self._lanes, self._inside = lanes, self.number < lanes

    def load(self, ref: Any, where: Array) -> Array:
        """Elements of a flat array."""
        return triton.load(ref.at[where], mask=self._inside, other=0)

    def row(self, ref: Any, row: Any) -> Array:
        """The lanes' elements of a row."""
        return self.load(ref, row * self._lanes + self.number)

    def store(self, ref: Any, row: Any, values: Array) -> None:
        """Write the lanes' elements of a row."""
        triton.store(ref.at[row * self._lanes + self.number], values.astype(ref.dtype), mask=self._inside)

    def write(self, refs: Sequence[Any], row: Any, track: LabelTrack) -> Any:
        """Write a layer's labels, or the zeros of none, into its columns; returns the row of the next ones."""
        for ref, name in zip(refs, _FIELDS, strict=True):
            self.store(ref, row, getattr(track, name))
        return row + 1

    def append(self, ref: Any, rows: int, row: Array, track: LabelTrack) -> Array:
        """Write the labels of those lanes that have one, each into its own row; returns the rows of the next ones."""
        there = track.label != 0
        first = (self.number * rows + row) * len(_FIELDS)
        for place, name in enumerate(_FIELDS):
            values = getattr(track, name)
            bits = values.astype(jnp.int32) if name in _INTEGERS else jax.lax.bitcast_convert_type(values, jnp.int32)
            triton.store(ref.at[first + place], bits, mask=self._inside & there)
        return row + there.astype(jnp.int32)


def _publish(
    own: _Lanes, columns: Sequence[Any], windows: int, packed: bool, layer: int, row: Any, track: LabelTrack
) -> Any:
    """Write a layer's labels, into a row per window or packed; returns the row of the next ones."""
    if packed:
        return own.append(columns[layer], windows + FLUSH_SLOTS[layer], row, track)
    return own.write(columns[layer * len(_FIELDS) : (layer + 1) * len(_FIELDS)], row, track)


def _walk(
    config: EncoderConfig, samples: int, axes: int, lanes: int, block: int, divide: Divide, packed: bool,
    limits_ref: Any, table_ref: Any, length_ref: Any, wrench_ref: Any, *outputs: Any,
) -> None:  # fmt: skip
    """One block of lanes from the first window to the last."""
    *columns, ints_ref, reals_ref, count_ref, time_ref = outputs
    own = _Lanes(lanes, block)
    publish = partial(_publish, own, columns, -(-samples // config.window), packed)
    trial = own.number // axes
    first = trial * (samples * axes) + (own.number - trial * axes)
    limits = tuple(own.row(limits_ref, row) for row in range(4))
    length = own.load(length_ref, trial)
    period = own.load(table_ref, jnp.full(block, config.window + 1, jnp.int32))

    def sample(index: int | Array) -> Array:
        at = jnp.minimum(index, samples - 1)  # beyond the array nothing counts
        return own.load(wrench_ref, first + at * axes)

    def window_from(begin: int | Array) -> list[Array]:
        """The samples of a window; of a long one none, which is read as it is summed."""
        return [sample(begin + index) for index in range(config.window)] if config.window <= _AHEAD else []

    def body(window: Array, carry: Any) -> Any:
        time, held, values, rows = carry
        begin = window * config.window
        following = window_from(begin + config.window)  # asked for now, needed a window later
        count = jnp.clip(length - begin, 0, config.window)
        most = jnp.maximum(count, 2)
        n = most.astype(jnp.float32)

        def add(index: Any, sums: tuple[Array, Array]) -> tuple[Array, Array]:
            y = values[index] if values else sample(begin + index)
            return segments.accumulate(sums, jnp.asarray(index, jnp.int32), y, count, (n - 1) / 2)

        sums = (jnp.zeros(block, jnp.float32), jnp.zeros(block, jnp.float32))
        if values:
            for index in range(config.window):
                sums = add(index, sums)
        else:
            sums = jax.lax.fori_loop(0, config.window, add, sums)
        slope, x = segments.line_of(*sums, n, own.load(table_ref, most), period, time, count, divide)
        label = jnp.where(count >= 2, segments.gradient_label(slope, limits), 0)
        size = jnp.where(label > 0, count, 0)
        x = Segment(label, time, time + size, x.vmax, x.vmin, x.area, x.rise)
        held, out = chain(config, held, x)
        rows = [
            publish(layer, row, track_of(segment, time + size, divide))
            for layer, (row, segment) in enumerate(zip(rows, out, strict=True))
        ]
        return time + size, held, following, rows

    whole, real = jnp.zeros(block, jnp.int32), jnp.zeros(block, jnp.float32)
    empty = [Segment(whole, whole, whole, real, real, real, real)] * _HELD
    begin = (whole, empty, window_from(0), [whole if packed else jnp.int32(0) for _ in FLUSH_SLOTS])
    time, held, _, rows = jax.lax.fori_loop(0, -(-samples // config.window), body, begin)
    _Queue(own, ints_ref, reals_ref).fill(held)
    for layer, row in enumerate(rows):
        own.store(count_ref, layer, jnp.broadcast_to(row, (block,)))
    own.store(time_ref, 0, time)


def _end(config: EncoderConfig, windows: int, lanes: int, block: int, divide: Divide, packed: bool, *refs: Any) -> None:
    """What one block of lanes still holds, each layer drained into the next."""
    time_ref, *outputs = refs[len(refs) // 2 :]  # before them the same memory as inputs
    *columns, ints_ref, reals_ref, count_ref = outputs
    own = _Lanes(lanes, block)
    publish = partial(_publish, own, columns, windows, packed)
    queue, time = _Queue(own, ints_ref, reals_ref), own.row(time_ref, 0)
    held = [queue.read(place) for place in range(_HELD)]
    for layer, ends in enumerate(drain_segments(config, held, queue.pushed)):
        queue.fill(ends)

        def each(place: Array, row: Array, layer: int = layer) -> Array:
            return publish(layer, row, track_of(queue.read(place), time, divide))

        count = jax.lax.fori_loop(0, len(ends), each, own.row(count_ref, layer))
        own.store(count_ref, layer, count)


class _Queue:
    """Segments of each lane in memory: Triton has no arrays to scan, and compiles repeated code slowly."""

    def __init__(self, lanes: _Lanes, ints_ref: Any, reals_ref: Any) -> None:
        self._lanes, self._ints, self._reals = lanes, ints_ref, reals_ref

    def fill(self, segments: Sequence[Segment]) -> None:
        """The rows from the first one on."""
        for place, x in enumerate(segments):
            self._write(place, x)

    def read(self, place: Any) -> Segment:
        """A row."""
        ints = (self._lanes.row(self._ints, 3 * place + field) for field in range(3))
        return Segment(*ints, *(self._lanes.row(self._reals, 4 * place + field) for field in range(4)))

    def pushed(self, push: Push, held: Any, arrivals: Sequence[Segment]) -> tuple[Any, list[Segment]]:
        """Arrivals one after the other, as :func:`rcbht_jax.encoding.encoder.pushed_in_scan`."""

        def body(place: Array, held: Any) -> Any:
            held, out = push(held, self.read(place))
            self._write(place, out)
            return held

        self.fill(arrivals)
        held = jax.lax.fori_loop(0, len(arrivals), body, held)
        return held, [self.read(place) for place in range(len(arrivals))]

    def _write(self, place: Any, x: Segment) -> None:
        for field, values in enumerate((x.label, x.t0, x.t1)):
            self._lanes.store(self._ints, 3 * place + field, values)
        for field, values in enumerate((x.vmax, x.vmin, x.area, x.rise)):
            self._lanes.store(self._reals, 4 * place + field, values)


def _divide(x: Array, y: Array) -> Array:
    """The quotient as IEEE 754 rounds it, and as a CPU does; Triton's own may be two digits off."""
    kind = jax.ShapeDtypeStruct(x.shape, jnp.float32)
    (out,) = triton.elementwise_inline_asm(
        "div.rn.f32 $0, $1, $2;", args=[x, y], constraints="=f,f,f", pack=1, result_shape_dtypes=[kind]
    )
    return out
