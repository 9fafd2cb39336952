"""Offline labels from a store are those of the authors' program on the original text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.reference.dataset import as_written, encode_dataset
from rcbht_jax.types import Recordings

ROWS = 3


@given(st.lists(st.floats(1e-9, 1e4) | st.floats(-1e4, -1e-9) | st.just(0.0), min_size=1, max_size=20))
def test_numbers_come_back_as_they_were_written(values: list[float]) -> None:
    written = np.array([float(f"{value:.6g}") for value in values])
    np.testing.assert_array_equal(as_written(written.astype(np.float32)), written)


def test_store_labels_equal_the_golden_tables(hiro_recordings: Recordings, golden_dir: Path) -> None:
    source = "REAL_HIRO_ONE_SA_SUCCESS"
    golden = dict(np.load(golden_dir / f"offline/{source}.npz"))
    rows = np.flatnonzero(hiro_recordings.source == source)[:ROWS]
    tracks = encode_dataset(hiro_recordings.take(rows))
    for layer, column in (("primitive", 6), ("mc", 0), ("llb", 0)):
        key = "prim" if layer == "primitive" else layer
        for row, index in enumerate(rows):
            trial = golden["trial"].tolist().index(str(hiro_recordings.trial[index]))
            for axis in range(6):
                table = trial * 6 + axis
                span = slice(golden[f"{key}_off"][table], golden[f"{key}_off"][table + 1])
                label = getattr(tracks, layer).label[row, axis]
                np.testing.assert_array_equal(label[label > 0], golden[key][span, column])


def test_axes_in_another_order_and_no_recordings_are_refused() -> None:
    push = np.linspace(0, 20, 400)[:, None] * np.ones(6)
    turned = Recordings.from_arrays([push], 200.0, axes=("Mx", "My", "Mz", "Fx", "Fy", "Fz"))
    with pytest.raises(InputError, match=r"axes are Mx My Mz Fx Fy Fz; .* expects Fx Fy Fz Mx My Mz, in this order"):
        encode_dataset(turned)
    with pytest.raises(InputError, match="There is no recording"):
        encode_dataset(turned.take([]))
