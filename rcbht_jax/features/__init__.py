"""Features of label tracks: one row of fixed length per time interval of a recording.

A label that crosses the boundary of an interval is clipped: it keeps its attributes and loses duration.
Families of features, each usable alone:

* ``sentence``: the labels resampled to a fixed number of slots; each slot holds the label with most time in it. The
  slots divide the interval itself, a gap has no label, and ties go to the smallest code
  (``rcbht_jax.reference.published_features`` has the authors' variant);
* ``histogram``: share of time and share of count per label;
* ``ngram``: share of each run of n successive labels; in both families labels may be weighed otherwise
  (``FeatureSpec.weighing``): by count, by time or by change of value;
* ``attributes``: mean amplitude, slope and level relative to the interval's mean level, per label group;
* ``duration``: seconds of the interval and of its labels;
* ``elapsed``: seconds since the start of the interval, one column;
* ``course``: first, last, highest and lowest value relative to the interval's mean level;
* ``offset``: absolute mean level per label group; a constant sensor bias changes it;
* ``edges``: first, last, highest and lowest value, absolute; a constant sensor bias changes them.

Families of the piecewise linear signal that the primitives describe, at equally spaced moments:

* ``parts``: level, slope, steepness, range and signs in three and in eight equal parts of the interval;
* ``spread``: quantiles of level and slope;
* ``together``: joint signs of two axes, and correlations of their levels and slopes; free of scale;
* ``order``: when the signal is highest, steepest, first and last rising or falling; free of scale;
* ``levels``: absolute level of each third; a constant sensor bias changes it.

Labels of several encoders (other windows, other thresholds) go side by side with ``concatenate_features``.
Host code, NumPy only; nothing here is trained.

Example:
    Shares of time in the behaviours of one recording, a push that lasts a second:

    >>> import numpy as np
    >>> from rcbht_jax.encoding.batch import encode_batch
    >>> from rcbht_jax.encoding.encoder import EncoderConfig
    >>> from rcbht_jax.encoding.thresholds import preset
    >>> wrench = np.zeros((1, 400, 6), np.float32)
    >>> wrench[0, :, 2] = np.clip(np.arange(400) - 100, 0, 200) * 0.1  # Fz, N
    >>> tracks = encode_batch(EncoderConfig(), preset("hiro"), wrench, np.array([400], np.int32))
    >>> whole = Intervals(np.array([0]), start=np.array([0]), end=np.array([400]), dt=0.005)
    >>> features = interval_features(tracks, whole, FeatureSpec(("histogram",), layers=("llb",)))
    >>> push = features.names.index("histogram.llb.Fz.time.PS")
    >>> features.meanings[push]
    'Fz llb: share of the labelled time spent in PS'
    >>> float(features.values[0, push].round(2))
    0.5
"""

from rcbht_jax.features.spans import Intervals
from rcbht_jax.features.spec import (
    ABSOLUTE,
    FAMILIES,
    WHOLE,
    Features,
    FeatureSpec,
    balanced_weights,
    concatenate_arms,
    concatenate_features,
    interval_features,
    longest,
)

__all__ = [
    "ABSOLUTE",
    "FAMILIES",
    "WHOLE",
    "FeatureSpec",
    "Features",
    "Intervals",
    "balanced_weights",
    "concatenate_arms",
    "concatenate_features",
    "interval_features",
    "longest",
]
