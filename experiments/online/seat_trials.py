"""Simulated trials of which about half of every kind of fault fail: severities drawn finely about the boundary.

The ranges were found with 32 or 48 trials of each kind and session (seeds 77 to 79), so that 20 to 80 % fail; the sets
that are scored were drawn afterwards. A missing tab is a worn one whose hook has nothing left: a continuous severity,
of which the half that is below zero fails. The kind "no contact" stands apart: its parts never touch, all of it fails.

Of every record only the first seconds are used, the same number in all trials of a session, at least one second before
the planned end of nearly all: neither the length of a record nor what follows can reveal the outcome.
"""

from __future__ import annotations

from pathlib import Path

from experiments.online.fault_trials import Lot, Trials, drawn_from, made
from rcbht_jax.introspection.fault_monitor import NOMINAL

Ranges = dict[str, tuple[float, float]]
# Session -> kind of fault -> the ranges of the distributions from which its severity is drawn.
SEVERITIES: dict[str, dict[str, Ranges]] = {
    "hooked-A": {
        "jamming": {"jam_overlap": (1.4e-3, 1.85e-3), "jam_friction": (3.0, 7.0)},
        "wedging": {"wedge_roll": (0.0, 0.07), "wedge_tilt": (0.0, 0.035)},
        "missing-tab": {"missing_overlap": (-1.0, 1.0)},
        "moved-part": {"moved_by": (0.5e-3, 7e-3)},
        "early-stop": {"stop_at": (0.98, 1.04)},  # its hooks let go as mating begins
    },
    "hooked-B": {
        "jamming": {"jam_overlap": (1.05e-3, 1.5e-3), "jam_friction": (1.5, 4.0)},
        "wedging": {"wedge_roll": (0.01, 0.09), "wedge_tilt": (0.005, 0.05)},
        "missing-tab": {"missing_overlap": (-1.0, 1.0)},
        "moved-part": {"moved_by": (0.5e-3, 8e-3)},
        "early-stop": {"stop_at": (1.0, 1.7)},  # its hooks let go seconds into mating
    },
}
SESSIONS = tuple(SEVERITIES)
KINDS = tuple(SEVERITIES[SESSIONS[0]])
APART = "no contact"
OUT_OF_REACH: dict[str, Ranges] = {"moved-part": {"moved_by": (0.021, 0.040)}, "early-stop": {"stop_at": (0.2, 0.35)}}
LENGTH = {"hooked-A": 20.7, "hooked-B": 30.7}  # s of each record that are seen, by session
SHARD = 64


def sets(session: str, per_kind: int) -> list[tuple[str, str, Ranges, int]]:
    """Name of the kind, fault, severities and number of trials of every store of a session."""
    touching = [(kind, kind, ranges, per_kind) for kind, ranges in SEVERITIES[session].items()]
    apart = [(APART, fault, ranges, max(1, per_kind // 5)) for fault, ranges in OUT_OF_REACH.items()]
    return [(NOMINAL, NOMINAL, {}, per_kind), *touching, *apart]


def seat_trials(folder: Path, session: str, per_kind: int, seed: int) -> Trials:
    """Simulate what is not in the folder yet, and read it all; an interrupted run goes on."""
    lots = [
        Lot(f"seat-{session}-{kind.replace(' ', '-')}-{fault}", kind, 0, count, drawn_from(fault, ranges))
        for kind, fault, ranges, count in sets(session, per_kind)
    ]
    return made(folder, session, lots, seed, shard=SHARD)
