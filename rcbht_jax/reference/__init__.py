"""The offline taxonomy of the original RCBHT programs, label-exact, in NumPy: the reference of all tests.

A recording becomes line segments (primitives), ordered pairs of those (motion compositions) and ordered pairs
of those (low-level behaviours), each layer filtered by merging (Rojas et al., section III). ``version`` selects a
version of the original programs, quirks included. ``clean=True`` corrects these quirks and no others:

====  ========================================  ==================================================
Quirk original program                          clean
====  ========================================  ==================================================
Q2    domain: sum of the widened extremes       domain: largest minus smallest (4th of each)
Q4    calibrated limits: forces are adapted     forces are not adapted; all four limits of a
      too, only the impulse limit is scaled     moment are divided by ten
Q5    slope of minus the impulse limit: error   negative impulse
Q7    segment has slope and extremes of the     segment is fitted to its own samples; segments
      rejected fit                              without duration are dropped
Q9    runs of three or more primitives: sums    divided by k + 1
      of k + 1 values divided by k
Q14   composition of one primitive has the      its own span
      amplitude of the rejected pair
Q15   tolerances scale with the signed maximum  they scale with the larger magnitude
Q19   amplitude tolerance of 1.5 is always met  0.5 in both; push and pull also need averages
      (constants; push and pull)                within 0.5
Q26   adjustment before push or pull only       in either order
====  ========================================  ==================================================

The value 0.5 of Q19 is this project's choice. The floor of the fit test (Q6) is the parameter ``floor``. The
endless loop on zero amplitudes (Q24) ends in both modes. Further quirks are numbered where they are reproduced.
Passes are numbered in the order in which the programs run them: 5.x primitives, 7.x compositions, 9.x behaviours.
"""

from rcbht_jax.reference.encode import MIN_SAMPLES, OfflineLabels, encode, sample_times, state_onsets, state_vector
from rcbht_jax.reference.tracks import to_tracks

__all__ = [
    "MIN_SAMPLES",
    "OfflineLabels",
    "encode",
    "sample_times",
    "state_onsets",
    "state_vector",
    "to_tracks",
]
