"""Proven feature sets, by the information that they use.

Time and absolute level are informative but can mislead: elapsed time identifies a controller, and a constant offset of
the wrench identifies a session. Sets without them transfer between sessions.

>>> from rcbht_jax.features import FeatureSpec, recipes
>>> FeatureSpec(recipes.RICHER).families
('histogram', 'parts', 'spread', 'together', 'order')
"""

from __future__ import annotations

from rcbht_jax.features.spec import ABSOLUTE, FeatureSpec

PLAIN = ("histogram", "ngram", "attributes")  # labels, their order and strength; neither time nor absolute level
FULL = (*PLAIN, "duration", "offset")  # the same with time and absolute level
SIGNAL = ("parts", "spread", "together", "order")  # shape of the signal; neither time nor absolute level
RICHER = ("histogram", *SIGNAL)  # labels and shape; neither time nor absolute level
LEVELS = (*RICHER, "levels")  # with absolute level, for a sensor that is tared alike in training and use
ALL = (*RICHER, "attributes", "course", "levels", "edges", "offset", "duration")  # everything but "sentence"
UNTIMED = (*PLAIN, "course", *SIGNAL, *ABSOLUTE)  # all but time

# A sub-task in a stream: labels, shape, level and time; without the families that cost time and help no task here.
SUBTASK = ("histogram", "parts", "levels", "elapsed")
SUBTASK_RELATIVE = ("histogram", "parts")  # neither time nor absolute level
# A whole trial in a stream: without time, which identifies sessions and controllers.
TRIAL = ("histogram", "attributes", "offset", "course", "edges")
TRIAL_RELATIVE = ("histogram", "attributes", "course")  # neither time nor absolute level

# Faults in a sub-task: primitives alone, whose levels and slopes are the force itself; a missing tab changes the force
# by less than a label.
MONITORING = FeatureSpec(families=(*TRIAL, "duration"), layers=("primitive",))
