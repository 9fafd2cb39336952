"""Metadata in the names of the HIRO folders: data set, session, outcome and deviation of a trial."""

from __future__ import annotations

import re
from dataclasses import dataclass

# Data set -> (session, outcome). The real successes are of two sessions, distinguished by trial number.
SETS = {
    "REAL_HIRO_ONE_SA_SUCCESS": ("", "success"),
    "REAL_HIRO_ONE_SA_ERROR_CHARAC": ("C", "failure"),
    "SIM_HIRO_ONE_SA_SUCCESS": ("SIM1", "success"),
    "SIM_HIRO_ONE_SA_ERROR_CHARAC": ("SIM1F", "failure"),
    "SIM_HIRO_ONE_SA_ERROR_CHARAC_Prob": ("SIM1F", "failure"),
    "SIM_HIRO_TWO_SA_SUCCESS": ("SIM2", "success"),
}
LAST_TRIAL_OF_A, LAST_TRIAL_OF_B = 21, 46
# Session B counts these as successes although the part ends 11-38 mm away, or tilted by 1.4 degrees.
OFF_SEAT_B = (26, 31, 36, 39, 41, 44, 46)
OTHER_SETUP = "20120426-1732-SideApproach-S"
SUSPECT_SHIFT = 0.05  # m: the one shift of 0.100 is probably a typing error for 0.0100

_DEVIATION = re.compile(r"XX((?:[+-][xyr]\d*\.?\d+)*)")
_PART = re.compile(r"([+-])([xyr])(\d*\.?\d+)")


@dataclass(frozen=True)
class TrialName:
    """Metadata of a trial that need no file."""

    source: str
    session: str
    outcome: str  # "success", "failure" or "unknown"
    failure_type: str  # sign pattern such as "+x-y+r"; "" = none
    deviation: tuple[float, float, float] | None  # x (m), y (m), roll (rad); None = not in the name
    notes: tuple[str, ...]


def parse_trial(source: str, trial: str) -> TrialName:
    """Parse the names of the data set and the trial; the session of an unknown set is its name."""
    session, outcome = SETS.get(source, (source, _guess_outcome(source)))
    if session == "SIM1F":
        return _simulated_failure(source, trial)
    notes: tuple[str, ...] = ()
    deviation = None
    if source == "REAL_HIRO_ONE_SA_SUCCESS":
        session, notes = _real_success(trial)
        # Session A repeats one nominal pose; session B's offsets are in its pose file, not in its name.
        deviation = (0.0, 0.0, 0.0) if session == "A" else None
    if trial == OTHER_SETUP:
        notes = ("other-setup",)
    return TrialName(source, session, outcome, "", deviation, notes)


def _guess_outcome(source: str) -> str:
    name = source.upper()
    if "ERROR" in name or "FAIL" in name:
        return "failure"
    return "success" if "SUCCESS" in name else "unknown"


def _real_success(trial: str) -> tuple[str, tuple[str, ...]]:
    """Session and notes of a real success from its trial number."""
    match = re.search(r"-S-(\d+)$", trial)
    number = int(match[1]) if match else 0
    if 1 <= number <= LAST_TRIAL_OF_A:
        return "A", ()
    if LAST_TRIAL_OF_A < number <= LAST_TRIAL_OF_B:
        return "B", ("off-seat",) if number in OFF_SEAT_B else ()
    return "REAL_HIRO_ONE_SA_SUCCESS", ("session-unknown",)


def _simulated_failure(source: str, trial: str) -> TrialName:
    """A name such as ``XX+x0.0075-y0.0078+r0.0342``: signed deviations in metres and radians."""
    match = _DEVIATION.fullmatch(trial)
    parts = _PART.findall(match[1]) if match else []
    if match is None or len({axis for _, axis, _ in parts}) < len(parts):
        return TrialName(source, "SIM1F", "failure", "", None, ("deviation-unreadable",))
    value = {axis: float(sign + size) for sign, axis, size in parts}
    x, y, r = (value.get(axis, 0.0) for axis in "xyr")
    failure_type = "".join(("+" if value[axis] > 0 else "-") + axis for axis in "xyr" if value.get(axis))
    suspect = max(abs(x), abs(y)) > SUSPECT_SHIFT
    return TrialName(source, "SIM1F", "failure", failure_type, (x, y, r), ("deviation-suspect",) if suspect else ())
