"""The authors' offline taxonomy, label-exact, in NumPy: the oracle for everything else.

A recording becomes line segments (primitives), ordered pairs of those (motion compositions) and ordered pairs
of those (low-level behaviours), each layer filtered by merging. ``version`` selects one of the authors' code
versions, quirks included. ``clean=True`` corrects what the offline specification (section 12) advises to
correct, and nothing else:

====  ========================================  ==================================================
Quirk reference                                 clean
====  ========================================  ==================================================
Q2    domain is the sum of widened extremes     domain is largest minus smallest (4th of each)
Q4    calibrated limits: forces adapted too,    forces stay; all four limits of a moment are
      only the impulse limit divided by ten     divided by ten
Q5    slope of minus the impulse limit: error   negative impulse
Q7    segment has slope and extremes of the     segment is fitted to its own samples; segments of
      rejected fit                              no length are dropped
Q9    runs of three or more primitives: sums    divided by k + 1
      of k + 1 values divided by k
Q14   composition of one primitive keeps the    its own span
      amplitude of the rejected pair
Q15   tolerances scale with the signed maximum  they scale with the larger magnitude
Q19   amplitude tolerance of 1.5 always met     0.5, as in passes 7.6 and 9.5; pass 9.2 compares
      (7.7, 9.2); 9.2 compares amplitude twice  averages too, within 0.5, as pass 7.6
Q26   pass 9.5 in one order only                in either order
====  ========================================  ==================================================

The specification gives no value for Q19; 0.5 is this project's choice. The floor of the fit test (Q6) is the
parameter ``floor``. The endless loop on zero amplitudes (Q24) ends in both modes.
"""

from rcbht_jax.reference.encode import (
    MIN_SAMPLES,
    OfflineLabels,
    encode,
    sample_times,
    state_onsets,
    state_vector,
)
from rcbht_jax.reference.limits import CALIBRATED, spectrum
from rcbht_jax.reference.tracks import to_tracks
from rcbht_jax.reference.versions import VERSIONS, Version

__all__ = [
    "CALIBRATED",
    "MIN_SAMPLES",
    "VERSIONS",
    "OfflineLabels",
    "Version",
    "encode",
    "sample_times",
    "spectrum",
    "state_onsets",
    "state_vector",
    "to_tracks",
]
