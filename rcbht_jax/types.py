"""Frozen pytree dataclasses shared by every room of the house; each field states its shape and unit.

Axes are always Fx Fy Fz Mx My Mz, forces in newtons, moments in newton metres, times in seconds
unless a field says samples. Padding is stated per class.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

Array = Any  # jax.Array or numpy.ndarray: host and device code share these containers


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Segment:
    """A labelled span inside the encoder; every field has the same batch shape ``[...]``, its lanes.

    Sums are kept instead of means so that merging only adds: no product feeds an addition, hence no
    compiler may contract one into a fused multiply-add, hence streaming and batch agree bit for bit.
    An empty slot has label 0; its other fields mean nothing.
    """

    label: Array  # int32, code of rcbht_jax.labels
    t0: Array  # int32, first sample
    t1: Array  # int32, one past the last sample
    vmax: Array  # float, largest value of the fitted lines
    vmin: Array  # float, smallest value of the fitted lines
    area: Array  # float, sum of the samples = mean x duration in samples
    rise: Array  # float, slope x duration in samples


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LabelTrack:
    """Published labels of one layer, in publication order, which is time order.

    Every array has the same shape ``[..., slot]``. Padding: unused slots (at the end in the compact
    form, anywhere in the dense form with one slot per step) hold label 0 and zeros elsewhere.
    """

    label: Array  # int8, code of rcbht_jax.labels; 0 = empty slot
    t0: Array  # int32, first sample of the span
    t1: Array  # int32, one past the last sample of the span
    emit: Array  # int32, number of samples received when the label was published; -1 = not online
    vmax: Array  # float, largest value of the fitted lines, N or Nm
    vmin: Array  # float, smallest value of the fitted lines, N or Nm
    avg: Array  # float, duration-weighted mean, N or Nm
    grad: Array  # float, duration-weighted slope, N/s or Nm/s


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LabelTracks:
    """The three layers of labels for the same lanes."""

    primitive: LabelTrack
    mc: LabelTrack
    llb: LabelTrack


@dataclass(frozen=True)
class Recordings:
    """A data set in memory: one row per recording (one arm of one trial). Host arrays.

    Padding: ``wrench`` beyond ``length`` is zero.
    """

    wrench: NDArray[np.float32]  # [recording, time, 6]
    length: NDArray[np.int32]  # [recording] samples
    dt: float  # seconds between samples
    onset: NDArray[np.float64]  # [recording, 4] start of approach, rotation, insertion, mating; NaN = missing
    onset_harmonised: NDArray[np.float64]  # [recording, 4] as above with the harmonised rotation boundary
    trial: NDArray[np.str_]  # [recording] name of the trial; both arms of a trial share it
    arm: NDArray[np.str_]  # [recording] "R" or "L"
    source: NDArray[np.str_]  # [recording] data set, for example REAL_HIRO_ONE_SA_SUCCESS
    session: NDArray[np.str_]  # [recording] recording session: A, B, C, ... or the data set's own
    outcome: NDArray[np.str_]  # [recording] "success", "failure" or "unknown"
    failure_type: NDArray[np.str_]  # [recording] sign pattern such as "+x-y+r"; "" = none
    deviation: NDArray[np.float64]  # [recording, 3] x (m), y (m), roll (rad) from the nominal pose; NaN = unknown
    note: NDArray[np.str_]  # [recording] what the importer had to say: semicolon-separated flags

    def __len__(self) -> int:
        return int(self.length.shape[0])

    def take(self, rows: NDArray[Any]) -> Recordings:
        """The chosen recordings, by their numbers in the order wished or by a mask ``[recording]``."""
        names = [field.name for field in fields(self) if field.name != "dt"]
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    @staticmethod
    def join(parts: Sequence[Recordings]) -> Recordings:
        """Several data sets as one, padded to the longest recording.

        Raises:
            InputError: there are none, or their sampling periods differ.
        """
        periods = sorted({part.dt for part in parts})
        if len(periods) != 1:
            raise InputError(f"data sets to be joined need one sampling period, these have {periods or 'none'}.")
        longest = max(part.wrench.shape[1] for part in parts)
        wide = [np.pad(part.wrench, ((0, 0), (0, longest - part.wrench.shape[1]), (0, 0))) for part in parts]
        names = [field.name for field in fields(parts[0]) if field.name not in ("dt", "wrench")]
        columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return replace(parts[0], wrench=np.concatenate(wide), **columns)
