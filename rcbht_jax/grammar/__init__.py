"""Grammar: label tracks and time intervals -> one row of fixed-length features per sentence.

A *sentence* is what the labels say about one recording between two samples (a sub-task, or a whole
record). A span that crosses a boundary is clipped there: it keeps its attributes and loses duration.
Families of features, each usable alone:

* ``sentence``: the labels resampled to L slots by duration majority (offline specification, section 13,
  in clean form: the slots divide the interval itself rather than first start to last end, a gap belongs
  to nobody rather than to the label after it, arithmetic is exact, and ties go to the smallest code
  rather than to a hash order; ``rcbht_jax.published`` keeps the authors' form);
* ``histogram``: share of time and share of count per label;
* ``ngram``: share of each run of n successive labels;
* ``attributes``: mean amplitude, slope and level relative to the sentence's mean level, per label group;
* ``duration``: seconds, the family that gives away how long a state lasted;
* ``course``: first, last, highest and lowest value relative to the sentence's mean level;
* ``offset``: absolute mean level per label group, a family that gives away sensor bias;
* ``edges``: first, last, highest and lowest value, absolute, which give it away as well.

Host code, NumPy only; nothing here trains.
"""

from rcbht_jax.grammar.features import FAMILIES, Features, FeatureSpec, both_arms, features, longest
from rcbht_jax.grammar.words import Intervals

__all__ = ["FAMILIES", "FeatureSpec", "Features", "Intervals", "both_arms", "features", "longest"]
