"""Halving of batches that do not fit into the device's memory: a trial's bytes do not depend on its batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.printable import plural
from rcbht_jax.io import label_parts
from rcbht_jax.types import LabelTracks
from sim_mjx.assembly.rollout import Rollouts, batch_size

_OUT_OF_MEMORY = ("resource_exhausted", "out of memory", "failed to allocate")  # of XLA, CUDA, Warp
_PADDED = {"wrench": 1, "joints": 1, "past": 1}  # field of Rollouts -> its dimension of time


class Halving:
    """Simulates batches whole, or in halves, quarters and so on once one was too large for the device.

    Args:
        simulate: a batch of trials.
        notice: called with a sentence when the batch is halved.
    """

    def __init__(
        self,
        simulate: Callable[[Any], tuple[Rollouts, LabelTracks | None]],
        notice: Callable[[str], None] | None = None,
    ) -> None:
        self.simulate, self.notice = simulate, notice
        self.most: int | None = None  # trials at once; None = as many as there are

    def __call__(self, params: Any) -> tuple[Rollouts, LabelTracks | None]:
        """A batch of trials, as ``simulate`` returns it."""
        trials = batch_size(params)
        while True:
            most = trials if self.most is None else min(self.most, trials)
            try:
                return joined([self.simulate(part) for part in _parts(params, trials, most)])
            except Exception as error:
                if most == 1 or not any(text in str(error).lower() for text in _OUT_OF_MEMORY):
                    raise
            # outside of the handler, whose traceback would keep the arrays on the device
            self.most = -(-most // 2)
            if self.notice is not None:
                self.notice(
                    f"The device's memory does not hold {plural(most, 'trial')} at once; going on with {self.most}."
                )


def joined(parts: Sequence[tuple[Rollouts, LabelTracks | None]]) -> tuple[Rollouts, LabelTracks | None]:
    """Batches as one, padded with zeros to the longest."""
    if len(parts) == 1:
        return parts[0]
    outs, tracks = [out for out, _ in parts], [labels for _, labels in parts if labels is not None]
    names = [field.name for field in fields(Rollouts)]
    whole = {name: _joined([getattr(out, name) for out in outs], _PADDED.get(name)) for name in names}
    return Rollouts(**whole), label_parts.joined(tracks) if tracks else None


def _parts(params: Any, trials: int, most: int) -> list[Any]:
    if most == trials:
        return [params]
    rows = [slice(at, at + most) for at in range(0, trials, most)]
    return [jax.tree.map(lambda leaf, part=part: np.asarray(leaf)[part], params) for part in rows]


def _joined(arrays: list[NDArray[Any]], padded: int | None) -> NDArray[Any]:
    """Arrays one after another, of the same size in the dimension ``padded``."""
    if padded is not None:
        longest = max(array.shape[padded] for array in arrays)
        arrays = [
            np.pad(array, [(0, longest - size if axis == padded else 0) for axis, size in enumerate(array.shape)])
            for array in arrays
        ]
    return np.concatenate(arrays)
