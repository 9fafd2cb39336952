"""Frozen pytree dataclasses that all packages share; each field states its shape and unit.

Axes are usually Fx Fy Fz Mx My Mz, forces in N, moments in Nm, times in seconds unless a field states samples.
Padding is stated per class. Shapes are checked under pytest, by jaxtyping.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike, NDArray

from rcbht_jax import labels
from rcbht_jax._util.arms import UNNAMED
from rcbht_jax._util.columns import column_values, joined_columns
from rcbht_jax._util.optional import require
from rcbht_jax._util.printable import plural
from rcbht_jax._util.selection import number_of, rows_of
from rcbht_jax._util.signals import distinct, period, read_parts, warn_if_turned
from rcbht_jax._util.svg import Bar, bands
from rcbht_jax._util.values import ByValue
from rcbht_jax.annotations import Annotations
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    import pandas  # type: ignore[import-untyped]
    import xarray

Array = Any  # jax.Array or numpy.ndarray: host and device code share these containers


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Segment(ByValue):
    """A labelled span inside the encoder; every field has the same batch shape ``[*lanes]``.

    Sums are kept instead of means so that merging only adds: no product feeds an addition, so no compiler may fuse the
    two, and streaming and batch agree bit for bit. An empty slot has label 0; its other fields are undefined.
    """

    label: Int[Array, "*lanes"]  # int32, code of rcbht_jax.labels
    t0: Int[Array, "*lanes"]  # int32, first sample
    t1: Int[Array, "*lanes"]  # int32, one past the last sample
    vmax: Float[Array, "*lanes"]  # largest value of the fitted lines, N or Nm
    vmin: Float[Array, "*lanes"]  # smallest value of the fitted lines, N or Nm
    area: Float[Array, "*lanes"]  # sum of the samples = mean x duration in samples
    rise: Float[Array, "*lanes"]  # slope x duration in samples


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class LabelTrack(ByValue):
    """Published labels of one layer, in publication order, which is time order.

    Every array has the same shape ``[..., slot]``. Padding: unused slots (at the end in the compact
    form, anywhere in the dense form with one slot per step) hold label 0 and zeros elsewhere.
    """

    label: Int[Array, "*slots"]  # int8, code of rcbht_jax.labels; 0 = empty slot
    t0: Int[Array, "*slots"]  # int32, first sample of the span
    t1: Int[Array, "*slots"]  # int32, one past the last sample of the span
    emit: Int[Array, "*slots"]  # int32, number of samples received when the label was published; -1 = not online
    vmax: Float[Array, "*slots"]  # largest value of the fitted lines, N or Nm
    vmin: Float[Array, "*slots"]  # smallest value of the fitted lines, N or Nm
    avg: Float[Array, "*slots"]  # duration-weighted mean, N or Nm, from vmin to vmax
    grad: Float[Array, "*slots"]  # duration-weighted slope, N/s or Nm/s


@dataclass(frozen=True)
class TrackInfo:
    """What the labels of :func:`rcbht_jax.encode` belong to; static, so that label tracks stay a pytree.

    Attributes:
        rate: samples per second.
        axes: names of the axes.
        recordings: names of the recordings; empty = a single recording without a batch axis.
    """

    rate: float
    axes: tuple[str, ...]
    recordings: tuple[str | int, ...] = ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class LabelTracks(ByValue):
    """Labels of the same recordings in three layers: primitives, motion compositions, low-level behaviours.

    Every array is ``[axis, slot]`` for one recording, ``[recording, axis, slot]`` for several.

    Example:
        >>> import numpy as np, rcbht_jax as rj
        >>> push = np.clip(20 * (np.arange(400) / 200 - 1), 0, 10)  # N: rest, 20 N/s for half a second, rest
        >>> tracks = rj.encode(push[:, None], rate=200)
        >>> tracks.words(axis=0, layer="llb")
        ['FX', 'PS', 'FX']
        >>> tracks
        LabelTracks(1 recording, 1 axis at 200 Hz: 3 primitives, 3 compositions, 3 behaviours)
    """

    primitive: LabelTrack
    mc: LabelTrack
    llb: LabelTrack
    info: TrackInfo | None = field(default=None, kw_only=True, metadata={"static": True})

    def words(self, axis: int | str, layer: str = "llb", recording: int | str = 0) -> list[str]:
        """Names of the labels of one axis in order of time.

        Args:
            axis: number or name, for example 2 or "Fz".
            layer: "primitive", "mc" or "llb".
            recording: number, or name, where there are several.

        Raises:
            InputError: no such axis, layer or recording, or a name that several have.
        """
        number = number_of("axis", axis, self._axes())
        row = number_of("recording", recording, self._recordings().tolist())
        if layer not in labels.LAYERS:
            raise InputError(f"There is no layer {layer!r}; there are {', '.join(labels.LAYERS)}.")
        codes = _batched(getattr(self, layer).label)
        if not (-codes.shape[0] <= row < codes.shape[0] and -codes.shape[1] <= number < codes.shape[1]):
            raise InputError(
                f"Recording {recording}, axis {axis} is not there: {codes.shape[0]} recordings, {codes.shape[1]} axes."
            )
        return [labels.name(layer, code) for code in codes[row, number].tolist() if code]

    def take(self, rows: ArrayLike) -> LabelTracks:
        """The labels of some recordings, with their names: numbers in any order, or a mask ``[recording]``.

        Raises:
            InputError: no such recordings.
        """
        numbers = rows_of(rows, len(self._recordings()))
        names = tuple(self._recordings()[numbers].tolist())
        taken = jax.tree.map(lambda values: _batched(values)[numbers], self)
        return replace(taken, info=self.info and replace(self.info, recordings=names))

    def to_frame(self) -> pandas.DataFrame:
        """A pandas table with a row per word.

        Columns: recording, axis, layer, label, t0, t1, emit (samples), vmax, vmin, avg (N or Nm), grad (N/s or Nm/s).

        Raises:
            InputError: pandas is not installed.
        """
        pandas = require("pandas", "frames")
        names, recordings = np.array(self._axes()), self._recordings()
        parts = []
        for layer in labels.LAYERS:
            track = jax.tree.map(_batched, getattr(self, layer))
            where = np.nonzero(track.label)
            alphabet = np.array([labels.name(layer, code) for code in range(len(labels.MEANING[layer]) + 1)])
            columns = {"recording": recordings[where[0]], "axis": names[where[1]]}
            columns |= {"layer": np.full(len(where[0]), layer), "label": alphabet[track.label[where]]}
            values = ("t0", "t1", "emit", "vmax", "vmin", "avg", "grad")
            parts.append(pandas.DataFrame(columns | {name: getattr(track, name)[where] for name in values}))
        frame = pandas.concat(parts, ignore_index=True)
        frame.attrs["rate"] = None if self.info is None else self.info.rate
        return frame

    def to_xarray(self) -> xarray.Dataset:
        """An xarray data set: variables such as ``llb_label`` with the dimensions recording, axis, llb_slot.

        Raises:
            InputError: xarray is not installed.
        """
        xarray = require("xarray", "frames")
        variables = {}
        for layer in labels.LAYERS:
            dims = ("recording", "axis", f"{layer}_slot")
            for name, values in vars(getattr(self, layer)).items():
                variables[f"{layer}_{name}"] = (dims, _batched(values))
        attrs = {} if self.info is None else {"rate": self.info.rate}
        return xarray.Dataset(variables, {"recording": self._recordings(), "axis": self._axes()}, attrs)

    def __repr__(self) -> str:
        label = self.llb.label
        shape = np.shape(label)
        if len(shape) < 2 or not isinstance(label, np.ndarray | jax.Array) or isinstance(label, jax.core.Tracer):
            return f"LabelTracks({shape or label})"
        count = [int(np.count_nonzero(getattr(self, layer).label)) for layer in labels.LAYERS]
        size = f"{plural(len(self._recordings()), 'recording')}, {plural(shape[-2], 'axis', 'axes')}"
        rate = "" if self.info is None else f" at {self.info.rate:g} Hz"
        words = ", ".join(map(plural, count, ("primitive", "composition", "behaviour")))
        return f"LabelTracks({size}{rate}: {words})"

    def _repr_html_(self) -> str:
        """Picture for notebooks: the first recording's words over time, a row per axis and layer, few of tiny ones."""
        scale = 1.0 if self.info is None else 1 / self.info.rate
        rows = []
        if not len(self._recordings()):
            return f"<div>{self!r}</div>"
        for number, axis in enumerate(self._axes()):
            for layer in labels.LAYERS[::-1]:
                track = jax.tree.map(lambda leaf, row=number: _batched(leaf)[0, row], getattr(self, layer))
                words = zip(track.label.tolist(), track.t0.tolist(), track.t1.tolist(), strict=True)
                bars = [
                    Bar(t0 * scale, t1 * scale, labels.COLORS[layer][code - 1], labels.MEANING[layer][code - 1])
                    for code, t0, t1 in words
                    if code
                ]
                rows.append((f"{axis} {layer}", bars))
        return f"<div>{self!r}</div>{bands(rows, 'samples' if self.info is None else 's')}"

    def _axes(self) -> list[str]:
        count = np.shape(self.llb.label)[-2]
        names = self.info.axes if self.info else axis_names(count)
        return list(names) if len(names) == count else [f"axis{number}" for number in range(count)]  # some were cut

    def _recordings(self) -> NDArray[Any]:
        count = int(np.prod(np.shape(self.llb.label)[:-2]))  # arrays that were cut do not fit their names
        names = self.info.recordings if self.info else ()
        return np.array(names) if count and len(names) == count else np.arange(count)


def padded(parts: Sequence[NDArray[np.floating]]) -> tuple[NDArray[np.floating], NDArray[np.int32]]:
    """Recordings ``[time, axis]`` of the same axes under each other, zero at the end, and their lengths."""
    length = np.array([len(part) for part in parts], np.int32)
    shape, kinds = (len(parts), max(length.max(), 1), parts[0].shape[1]), {part.dtype for part in parts}
    wrench = np.zeros(shape, np.result_type(*kinds))  # whatever their order
    for row, part in zip(wrench, parts, strict=True):
        row[: len(part)] = part
    return wrench, length


def axis_names(count: int) -> tuple[str, ...]:
    """Default names of axes: those of a wrench if there are six, else axis0, axis1, ..."""
    return labels.AXES if count == len(labels.AXES) else tuple(f"axis{number}" for number in range(count))


def _batched(values: Array) -> NDArray[Any]:
    """Host array ``[recording, axis, slot]`` of ``[..., axis, slot]``."""
    array = np.asarray(values)
    return array.reshape(-1, *array.shape[-2:])


# What is written where nothing was given; further columns may have any name.
STANDARD_COLUMNS = {"arm": UNNAMED, "source": "mine", "session": "1", "outcome": "unknown", "note": ""}


@dataclass(frozen=True, eq=False)
class Recordings(ByValue):
    """A data set in memory: one row per recording (one sensor of one trial). Host arrays.

    Padding: ``wrench`` beyond ``length`` is zero.

    Example:
        >>> import numpy as np, rcbht_jax as rj
        >>> recordings = rj.Recordings.from_arrays([np.zeros((800, 6)), np.zeros((600, 6))], outcome="success")
        >>> len(recordings), recordings.take([1]).length.tolist(), recordings.trial.tolist()
        (2, [600], ['trial-0', 'trial-1'])
    """

    wrench: Float[np.ndarray, "recording time axis"]  # float32, in the units of the axes
    length: Int[np.ndarray, " recording"]  # samples
    dt: float  # seconds between samples
    trial: NDArray[np.str_]  # [recording] name of the trial; all arms of a trial share it
    arm: NDArray[np.str_]  # [recording] arm or sensor, for example "R" or "L"
    source: NDArray[np.str_]  # [recording] data set
    session: NDArray[np.str_]  # [recording] recording session, day or subject: what a test should hold out
    outcome: NDArray[np.str_]  # [recording] "success", "failure", "unknown", or the data set's own words
    note: NDArray[np.str_]  # [recording] remarks of the importer: flags separated by semicolons
    annotations: Annotations = field(default_factory=Annotations)  # labelled intervals
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)  # [recording] further classes, groups, numbers
    axes: tuple[str, ...] = labels.AXES  # [axis] names
    units: tuple[str, ...] = labels.UNITS  # [axis]

    def __len__(self) -> int:
        return int(self.length.shape[0])

    def __repr__(self) -> str:
        size = f"{plural(len(self), 'recording')}, {', '.join(self.axes)} at {1 / self.dt:g} Hz"
        tracks = ", ".join(self.annotations.tracks) or "none"
        return f"Recordings({size}; annotations: {tracks}; columns: {', '.join((*_TEXTS, *self.columns))})"

    @staticmethod
    def from_arrays(
        wrenches: Any,
        rate: float = 200.0,
        *,
        axes: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        annotations: Annotations | Iterable[Any] = (),
        **columns: Any,
    ) -> Recordings:
        """A data set from recordings ``[time, axis]`` of any lengths.

        Args:
            wrenches: NumPy, JAX, pandas or xarray, read as by :func:`rcbht_jax.encode`; any number of axes.
            rate: samples per second.
            axes: their names; default those of pandas or xarray, or Fx Fy Fz Mx My Mz if there are six.
            units: unit of each axis; default N and Nm for the axes of a wrench, else "".
            annotations: labelled intervals, or rows (recording, track, label, start in s, end in s).
            columns: trial, arm, source, session, outcome, note, which are texts, or columns of any other name; one
                value for all recordings or one for each. What is missing in a text is "", or what is not given.

        Raises:
            InputError: different axes, a time that disagrees with the rate, a column of another length or of neither
                texts nor numbers, or annotations about other recordings.
        """
        parts, named = read_parts(wrenches, dt := period(rate))
        if not parts or len({part.shape[1:] for part in parts}) > 1 or parts[0].ndim != 2 or not parts[0].shape[1]:
            shapes = sorted({part.shape for part in parts})
            raise InputError(f"Recordings have shapes {shapes}; expected a list of [time, axis] of the same axes.")
        wrench, length = padded(parts)
        if axes is None:
            warn_if_turned(wrenches, wrench.shape[1], wrench.shape[2], named)
        count, width = len(parts), wrench.shape[2]
        names = tuple(named or axis_names(width)) if axes is None else distinct(axes)
        if units is None:
            units = [labels.UNIT_OF.get(name, "") for name in names]
        if len(names) != width or len(units) != width:
            raise InputError(f"There are {len(names)} names and {len(units)} units for {width} axes.")
        values: dict[str, Any] = {name: np.full(count, text) for name, text in STANDARD_COLUMNS.items()}
        values["trial"] = np.array([f"trial-{number}" for number in range(count)])
        for name, column in columns.items():
            values[name] = column_values(name, column, count, values.get(name))
        extra = {name: values.pop(name) for name in list(values) if name not in (*STANDARD_COLUMNS, "trial")}
        marks = annotations if isinstance(annotations, Annotations) else Annotations.from_rows(annotations)
        marks.check(count)
        return Recordings(
            wrench, length, dt, annotations=marks, columns=extra, axes=names, units=tuple(units), **values
        )

    def column(self, name: str) -> NDArray[Any]:
        """A column ``[recording]`` by name: outcome, session, ... or one of ``columns``.

        Raises:
            InputError: there is no such column.
        """
        if name in _TEXTS:
            return np.asarray(getattr(self, name))
        if name not in self.columns:
            raise InputError(f"There is no column {name!r}; there are {', '.join([*_TEXTS, *self.columns])}.")
        return self.columns[name]

    def starts(self, track: str) -> Float[np.ndarray, "recording label"]:
        """First start of each label of a track in each recording, s; NaN = the recording has no such label.

        Raises:
            InputError: there is no such track.
        """
        return self.annotations.starts(track, len(self))

    @staticmethod
    def example() -> Recordings:
        """Eight made-up trials of 1.5 s at 200 Hz, for examples: four failures at rest, four successes with a push."""
        slope, rest = np.repeat([0.0, 8.0], 4), np.random.default_rng(0).normal(size=(8, 300, 6)) * 0.01
        wrench = rest + slope[:, None, None] * (np.arange(300) / 200)[:, None]
        return Recordings.from_arrays(wrench, outcome=np.where(slope > 0, "success", "failure"))

    def take(self, rows: ArrayLike) -> Recordings:
        """The recordings of some rows, as :meth:`LabelTracks.take`."""
        numbers = rows_of(rows, len(self))
        arrays = {name: getattr(self, name)[numbers] for name in ("wrench", "length", *_TEXTS)}
        columns = {name: values[numbers] for name, values in self.columns.items()}
        return replace(self, **arrays, columns=columns, annotations=self.annotations.take(numbers))

    @staticmethod
    def join(parts: Sequence[Recordings]) -> Recordings:
        """Several data sets as one, padded to the longest recording.

        A column that a part lacks is empty there: "", NaN or NaT.

        Raises:
            InputError: there are none, or their sampling periods, axes or kinds of columns differ.
        """
        periods = sorted({part.dt for part in parts})
        if len(periods) != 1:
            raise InputError(f"data sets to be joined need one sampling period, these have {periods or 'none'}.")
        if len(axes := {(part.axes, part.units) for part in parts}) > 1:
            raise InputError(f"data sets to be joined need the same axes in the same units, these have {sorted(axes)}.")
        longest = max(part.wrench.shape[1] for part in parts)
        wide = [np.pad(part.wrench, ((0, 0), (0, longest - part.wrench.shape[1]), (0, 0))) for part in parts]
        texts: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in ("length", *_TEXTS)
        }
        columns = joined_columns([part.columns for part in parts], [len(part) for part in parts])
        marks = Annotations.join([part.annotations for part in parts], [len(part) for part in parts])
        return replace(parts[0], wrench=np.concatenate(wide), columns=columns, annotations=marks, **texts)


_TEXTS = ("trial", *STANDARD_COLUMNS)
