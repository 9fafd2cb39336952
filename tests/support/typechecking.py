"""The run-time type checker that the tests hook into the package."""

from __future__ import annotations

import numpy as np
from beartype import BeartypeConf, FrozenDict, beartype
from numpy.typing import NDArray

# Every string width is its own dtype, so no real array would match the annotation of string arrays.
# An int is a float, as in PEP 484.
check = beartype(conf=BeartypeConf(is_pep484_tower=True, hint_overrides=FrozenDict({NDArray[np.str_]: np.ndarray})))
