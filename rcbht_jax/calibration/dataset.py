"""Calibration data: the fitted windows of training trials, their sentences and the classes of these."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax._util.digest import content_hash
from rcbht_jax.calibration.label_durations import AXES, Samples, Windows, device_lines, fit_windows
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import AnyConfig
from rcbht_jax.errors import InputError
from rcbht_jax.learning.tasks import LabelledIntervals
from rcbht_jax.types import Array, Recordings

_WITHOUT = "the method rest needs no intervals, and a task of whole recordings, such as outcome, has one each"


@dataclass(frozen=True)
class CalibrationData:
    """One row per recording; every recording has the same number of consecutive sentences.

    The arrays are all on the host (:func:`calibration_data`) or all on the device (:func:`device_calibration_data`).
    """

    wrench: Float[Array, "recording time 6"]  # float32, N and Nm
    windows: Windows
    edges: Int[Array, "recording edge"]  # int32, samples
    y: Int[Array, "recording sentence"]  # int32, index into classes
    classes: tuple[str, ...]
    trial: NDArray[np.str_]  # [recording]

    def __len__(self) -> int:
        return len(self.trial)

    def take(self, rows: NDArray[np.integer[Any]]) -> CalibrationData:
        """The chosen recordings."""
        windows = self.windows.take(rows)
        return CalibrationData(
            self.wrench[rows], windows, self.edges[rows], self.y[rows], self.classes, self.trial[rows]
        )

    def signal(self, config: AnyConfig) -> Windows | Samples:
        """What :func:`rcbht_jax.calibration.label_durations.label_durations` reads by the rule of a configuration."""
        return Samples(self.wrench, self.windows.length) if isinstance(config, FitConfig) else self.windows

    def fingerprint(self) -> str:
        """SHA-256 of everything that the result of a calibration depends on."""
        windows = self.windows
        lines = [windows.slope, windows.vmax, windows.vmin, windows.length]
        return content_hash([self.wrench, *lines, self.edges, self.y])


def calibration_data(recordings: Recordings, items: LabelledIntervals, config: AnyConfig) -> CalibrationData:
    """The sentences of a task with the fitted windows of their recordings.

    Args:
        recordings: the data set.
        items: sentences of one arm, from :func:`rcbht_jax.learning.tasks.labelled_intervals`.
        config: window and sampling period.

    Raises:
        InputError: other than six axes, the sentences cover both arms, the sampling periods differ, or the recordings
            have different numbers of sentences, or time between them.
    """
    if len(items.intervals) != 1:
        raise InputError(
            f"The sentences are of {len(items.intervals)} arms; thresholds are calibrated on one; choose it (--arm)."
        )
    if len(recordings.axes) != AXES:
        raise InputError(
            f"Thresholds for classes are calibrated on the {AXES} axes of a wrench, not on {len(recordings.axes)}; the "
            "method rest takes any axes."
        )
    if config.dt != recordings.dt:
        raise InputError(f"The encoder has a sampling period of {config.dt} s, the recordings of {recordings.dt} s.")
    (spans,) = items.intervals
    rows, first = np.unique(spans.recording, return_index=True)
    rows = rows[np.argsort(first)]
    shape = (len(rows), len(spans) // len(rows))
    if not np.array_equal(spans.recording, np.repeat(rows, shape[1])):
        counts = np.unique(spans.recording, return_counts=True)[1]
        raise InputError(
            f"Recordings have {counts.min()} to {counts.max()} intervals; thresholds are calibrated on recordings that "
            f"all have the same number, and whose intervals are listed in order; {_WITHOUT}."
        )
    start, end = spans.start.reshape(shape), spans.end.reshape(shape)
    if len(gaps := np.argwhere(start[:, 1:] != end[:, :-1])):
        row, before = gaps[0].tolist()
        raise InputError(
            f"Thresholds are calibrated on intervals that follow each other; in recording {rows[row]} interval "
            f"{before + 1} begins at sample {start[row, before + 1]}, and the one before ends at {end[row, before]}; "
            f"{_WITHOUT}."
        )
    edges = np.concatenate([start, end[:, -1:]], axis=1).astype(np.int32)
    length = recordings.length[rows]
    wrench = recordings.wrench[rows, : length.max()]
    windows = fit_windows(config, wrench, length)
    y = items.y.reshape(shape).astype(np.int32)
    return CalibrationData(wrench, windows, edges, y, items.classes, recordings.trial[rows])


def device_calibration_data(
    config: AnyConfig,
    wrench: Float[Array, "trial time 6"],
    edges: Int[Array, "trial edge"],
    y: Int[Array, "trial sentence"],
    classes: tuple[str, ...],
) -> CalibrationData:
    """Calibration data of wrenches that are on a device, and stay there; trials are named by their number.

    Args:
        config: static configuration.
        wrench: N and Nm; values after the last edge of a trial are ignored.
        edges: samples; the last edge is the length of the trial.
        y: index into ``classes``.
        classes: names.
    """
    clean, windows = _fitted(config, wrench, edges)
    return CalibrationData(clean, windows, edges, y, classes, np.arange(len(wrench)).astype(np.str_))


@partial(jax.jit, static_argnums=0)
def _fitted(config: AnyConfig, wrench: Array, edges: Array) -> tuple[Array, Windows]:
    """The wrench with zeros after its end, in whole windows, and their fitted lines."""
    length = edges[:, -1]
    inside = jnp.arange(wrench.shape[1], dtype=jnp.int32)[None] < length[:, None]
    short = -wrench.shape[1] % config.window
    padded = jnp.pad(jnp.where(inside[..., None], wrench, 0), ((0, 0), (0, short), (0, 0)))
    slope, vmax, vmin = device_lines(config, padded, length)
    return padded, Windows(slope, vmax, vmin, length)
