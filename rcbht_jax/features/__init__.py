"""Grammar: label tracks and time intervals -> one row of fixed-length features per sentence.

A *sentence* is what the labels say about one recording between two samples (a sub-task, or a whole
record). A span that crosses a boundary is clipped there: it keeps its attributes and loses duration.
Families of features, each usable alone:

* ``sentence``: the labels resampled to L slots by duration majority (offline specification, section 13,
  in clean form: the slots divide the interval itself rather than first start to last end, a gap belongs
  to nobody rather than to the label after it, arithmetic is exact, and ties go to the smallest code
  rather than to a hash order; ``rcbht_jax.reference.published_features`` keeps the authors' form);
* ``histogram``: share of time and share of count per label;
* ``ngram``: share of each run of n successive labels;
* ``attributes``: mean amplitude, slope and level relative to the sentence's mean level, per label group;
* ``duration``: seconds, the family that gives away how long a state lasted;
* ``elapsed``: seconds since the sentence began and nothing else, one column;
* ``course``: first, last, highest and lowest value relative to the sentence's mean level;
* ``offset``: absolute mean level per label group, a family that gives away sensor bias;
* ``edges``: first, last, highest and lowest value, absolute, which give it away as well.

Families that read the sentence back from its primitives at equally spaced moments:

* ``parts``: level, slope, steepness, range and signs in three and in eight equal parts of the sentence;
* ``spread``: quantiles of level and slope;
* ``together``: what two axes say at the same time, and how their levels and slopes are correlated; scale-free;
* ``order``: when the highest, steepest, first and last things happen; scale-free;
* ``levels``: absolute level of each third, which gives away sensor bias.

Labels of several encoders (other windows, other thresholds) may stand side by side, see ``concatenate_features``.

Host code, NumPy only; nothing here trains.
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
