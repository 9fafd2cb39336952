"""The run-time type checker that the tests hook into the package."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

import numpy as np
from beartype import BeartypeConf, FrozenDict, beartype
from numpy.typing import NDArray

# Every string width is its own dtype, so no real array would match the annotation of string arrays.
# An int is a float, as in PEP 484.
check = beartype(conf=BeartypeConf(is_pep484_tower=True, hint_overrides=FrozenDict({NDArray[np.str_]: np.ndarray})))


class Unhooked(MetaPathFinder):
    """Imports kernels in Warp's language as they are: it compiles no function that another one wraps."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return PathFinder.find_spec(fullname, path, target) if fullname.startswith("sim_mjx.engines.fused.") else None
