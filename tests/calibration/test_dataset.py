"""Calibration data: which recordings and sentences they hold, in which order, and what names them."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.annotations import Annotations
from rcbht_jax.calibration.dataset import CalibrationData, calibration_data, device_calibration_data
from rcbht_jax.calibration.label_durations import fit_windows
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.errors import InputError
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings

CONFIG = EncoderConfig(window=5, dt=0.005)


@pytest.fixture(scope="module")
def made() -> CalibrationData:
    wrench, length = np.random.default_rng(3).normal(size=(4, 60, 6)).astype(np.float32), np.full(4, 60, np.int32)
    edges, y = np.tile(np.array([0, 20, 60], np.int32), (4, 1)), np.tile(np.arange(2, dtype=np.int32), (4, 1))
    windows = fit_windows(CONFIG, wrench, length)
    return CalibrationData(wrench, windows, edges, y, ("a", "b"), np.array(list("wxyz")))


def test_data_are_in_the_order_of_their_sentences_and_whole():
    """Sentences of the second recording first; the recordings go on after their last sentence."""
    recordings = Recordings.from_arrays(np.random.default_rng(0).normal(size=(2, 300, 6)), rate=200)
    rows = [(r, "t", name, *times) for r in (0, 1) for name, times in (("ab"[r], (0.1, 0.5)), ("c", (0.5, 1.0)))]
    recordings = replace(recordings, annotations=Annotations.from_rows(rows))
    items = labelled_intervals(recordings, TaskSpec("t"))
    turned = np.array([2, 3, 0, 1])
    items = replace(
        items, y=items.y[turned], trial=items.trial[turned], session=items.session[turned],
        intervals=tuple(spans.take(turned) for spans in items.intervals),
    )  # fmt: skip
    data = calibration_data(recordings, items, CONFIG)
    assert data.trial.tolist() == recordings.trial[[1, 0]].tolist()
    assert [[data.classes[k] for k in row] for row in data.y] == [["b", "c"], ["a", "c"]]
    np.testing.assert_array_equal(data.wrench, recordings.wrench[[1, 0]])
    np.testing.assert_array_equal(data.windows.length, [300, 300])
    assert data.edges.tolist() == [[20, 100, 200]] * 2
    with pytest.raises(InputError, match=r"sampling period of 0.01 s, the recordings of 0.005 s"):
        calibration_data(recordings, items, EncoderConfig(window=5, dt=0.01))
    with pytest.raises(InputError, match="of 2 arms"):
        calibration_data(recordings, replace(items, intervals=items.intervals * 2), CONFIG)
    with pytest.raises(InputError, match=r"have 1 to 2 intervals; .*; the method rest needs no intervals, and a task"):
        calibration_data(recordings, items.take(np.arange(3)), CONFIG)


def test_the_fingerprint_depends_on_all_that_decides(made):
    other = {"wrench": made.wrench + 1, "edges": made.edges + 1, "y": 1 - made.y}
    changed = [replace(made, **{name: value}) for name, value in other.items()]
    changed += [
        replace(made, windows=replace(made.windows, **{name: getattr(made.windows, name) + 1}))
        for name in ("slope", "vmax", "vmin", "length")
    ]
    prints = [data.fingerprint() for data in (made, *changed)]
    assert len(set(prints)) == len(prints)
    assert made.take(np.arange(4)).fingerprint() == prints[0]


def test_trials_on_the_device_are_filled_up_to_whole_windows():
    wrench = np.random.default_rng(0).normal(size=(2, 12, 6)).astype(np.float32)
    edges, y = np.array([[0, 5, 12], [0, 5, 9]], np.int32), np.zeros((2, 2), np.int32)
    data = device_calibration_data(CONFIG, *map(jnp.asarray, (wrench, edges, y)), ("a",))
    expected = np.zeros((2, 15, 6), np.float32)
    expected[0, :12], expected[1, :9] = wrench[0], wrench[1, :9]
    np.testing.assert_array_equal(data.wrench, expected)
    made = fit_windows(CONFIG, expected, np.array([12, 9], np.int32))
    np.testing.assert_allclose(data.windows.slope, made.slope, rtol=1e-6)
