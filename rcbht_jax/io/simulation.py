"""What a store says of the simulation of its recordings, if they were simulated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.io.store import SIMULATION, open_store, read_recordings, read_simulation_batches
from rcbht_jax.types import Recordings

ORIGINS = ("recorded", "simulated", "recorded and simulated")
FAULT = "fault"  # array of the kind of fault that each trial was given, "none" = none


def origin_of(attrs: Mapping[str, Any]) -> str:
    """One of ``ORIGINS``, by the attributes of a store; "" = not known, of a store joined by version 0.2 or before.

    >>> origin_of({"simulated": {}}), origin_of({"importer": "csv"}), origin_of({"joined": []})
    ('simulated', 'recorded', '')
    """
    if "simulated" in attrs:
        return "simulated"
    origin = attrs.get("origin", "" if "joined" in attrs else "recorded")
    return origin if origin in ORIGINS else ""


def simulation_batches(store: Path, *names: str) -> Iterator[dict[str, NDArray[Any]]]:
    """As :func:`rcbht_jax.io.store.read_simulation_batches`; nothing of recordings that were not simulated."""
    return read_simulation_batches(store, *names) if SIMULATION in open_store(store) else iter(())


def recordings_with_faults(store: Path) -> Recordings:
    """All recordings of a store, with the kind of their simulated fault; see :func:`with_faults`."""
    return with_faults(read_recordings(store), simulation_batches(store, FAULT))


def with_faults(recordings: Recordings, simulation: Iterable[Mapping[str, NDArray[Any]]]) -> Recordings:
    """Recordings with the kind of their simulated fault as the column "fault", unless they have one already.

    >>> given = [{"fault": np.full(8, "jamming")}]
    >>> with_faults(Recordings.example(), given).columns["fault"][0].item()
    'jamming'

    Args:
        recordings: all of a store.
        simulation: of the same recordings, in batches; empty = they were not simulated.
    """
    if FAULT in recordings.columns or not (faults := [batch[FAULT] for batch in simulation if FAULT in batch]):
        return recordings
    return replace(recordings, columns={**recordings.columns, FAULT: np.concatenate(faults)})
