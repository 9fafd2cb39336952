"""Offline label tables as label tracks."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from rcbht_jax.errors import InputError
from rcbht_jax.reference import behaviours as llb
from rcbht_jax.reference import motion as mc
from rcbht_jax.reference import primitives as prim
from rcbht_jax.reference.encode import OfflineLabels, Tables
from rcbht_jax.types import LabelTrack, LabelTracks

Rows = Float64[np.ndarray, " _row"]
Table = Float64[np.ndarray, "_row _column"]


def _span(labels: OfflineLabels, start: Rows, end: Rows, dt: float) -> tuple[Rows, Rows]:
    """Half-open sample spans: the sample shared by two neighbours belongs to the later one."""
    n = labels.samples
    first = np.clip(np.rint((start - labels.time_start) / dt), 0, n - 1)
    last = np.rint((end - labels.time_start) / dt)
    last = np.where(last >= n - 1, n, last)
    return first, np.maximum(last, first + 1)


def _integral(table: Table, labels: OfflineLabels, dt: float) -> Float64[np.ndarray, " boundary"]:
    """Cumulative sum over samples of the slopes of filtered primitives."""
    first, last = _span(labels, table[:, prim.START], table[:, prim.END], dt)
    slope = np.zeros(labels.samples)
    for t0, t1, value in zip(first.astype(int), last.astype(int), table[:, prim.SLOPE], strict=True):
        slope[t0:t1] = value
    return np.concatenate([[0.0], np.cumsum(slope)])


def _primitive_columns(table: Table, labels: OfflineLabels, dt: float) -> list[Rows]:
    span = _span(labels, table[:, prim.START], table[:, prim.END], dt)
    columns = (prim.MAX, prim.MIN, prim.AVG, prim.SLOPE)
    return [table[:, prim.LABEL], *span, *(table[:, column] for column in columns)]


def _upper_columns(
    table: Table,
    integral: Float64[np.ndarray, " boundary"],
    labels: OfflineLabels,
    dt: float,
    columns: tuple[int, ...],
) -> list[Rows]:
    label, start, end, highest, amplitude, average = (table[:, column] for column in columns)
    first, last = _span(labels, start, end, dt)
    slope = (integral[last.astype(int)] - integral[first.astype(int)]) / (last - first)
    return [label, first, last, highest, highest - amplitude, average, slope]


def _stack(axes: list[list[Rows]]) -> LabelTrack:
    slots = max(len(columns[0]) for columns in axes)
    block = np.zeros((7, 6, slots))
    for axis, columns in enumerate(axes):
        block[:, axis, : len(columns[0])] = columns
    label = block[0].astype(np.int8)
    values = block[3:].astype(np.float32)
    emit = np.where(label > 0, -1, 0).astype(np.int32)
    return LabelTrack(label, block[1].astype(np.int32), block[2].astype(np.int32), emit, *values)


def to_tracks(labels: OfflineLabels, dt: float) -> LabelTracks:
    """Filtered labels of the three layers as tracks ``[6, slot]``, padded to the longest axis.

    Spans are rounded to samples: from the start to the end of a primitive, and from the start of the first to the
    end of the second part of the others. ``emit`` is -1. Of compositions and behaviours, ``vmax`` is the stored
    maximum, ``vmin`` lies one amplitude below it, and ``grad`` is the duration-weighted slope of their primitives.

    Args:
        labels: of one recording.
        dt: seconds between its samples.

    Raises:
        InputError: ``dt`` is not a positive number.
    """
    if not (np.isfinite(dt) and dt > 0):
        raise InputError(f"The sample period is {dt} s; expected a positive number.")
    integrals = [_integral(table, labels, dt) for table in labels.prim]

    def upper(tables: Tables, columns: tuple[int, ...]) -> LabelTrack:
        pairs = zip(tables, integrals, strict=True)
        return _stack([_upper_columns(table, area, labels, dt, columns) for table, area in pairs])

    return LabelTracks(
        primitive=_stack([_primitive_columns(table, labels, dt) for table in labels.prim]),
        mc=upper(labels.mc, (mc.LABEL, mc.T1S, mc.T2E, mc.MX, mc.AMP, mc.AVG)),
        llb=upper(labels.llb, (llb.LABEL, llb.T1S, llb.T2E, llb.MX, llb.AMP, llb.AVG)),
    )
