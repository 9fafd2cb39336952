"""Labels made on the device are those of the host's schedule, bit for bit."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from rcbht_jax.encoding.batch import WIDTH, encode_batch, encode_on_device
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.types import LabelTrack


def test_labels_are_those_of_the_schedule() -> None:
    rng = np.random.default_rng(1)
    wrench = np.cumsum(rng.normal(0, 0.3, (8, 250, 6)), axis=1).astype(np.float32)
    wrench[0, 40:, 2] += 50.0
    length = np.array([250, 3, 0, 101, 249, 25, 7, 200], np.int32)
    config, thresholds = EncoderConfig(window=5), preset("hiro")
    found = encode_on_device(config, thresholds.limits, wrench, length, batch=4)
    expected = encode_batch(config, thresholds, wrench, length)
    for layer in ("primitive", "mc", "llb"):
        ours, theirs = getattr(found, layer), getattr(expected, layer)
        slots = theirs.label.shape[2]
        assert ours.label.shape[2] % WIDTH == 0
        assert not np.asarray(ours.label)[:, :, slots:].any()
        for field in fields(LabelTrack):
            np.testing.assert_array_equal(
                np.asarray(getattr(ours, field.name))[:, :, :slots], getattr(theirs, field.name)
            )
