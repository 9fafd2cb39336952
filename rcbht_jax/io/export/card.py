"""The data card: what the data is, where it comes from, and what must not be concluded from it."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

import numpy as np

import rcbht_jax
from rcbht_jax._util.digest import content_hash
from rcbht_jax.io.export.dataset import DataSet
from rcbht_jax.io.export.tables import COLUMNS
from rcbht_jax.labels import LAYERS, MEANING, name
from rcbht_jax.learning.tasks import CONFOUNDS
from rcbht_jax.types import Recordings

_HIDDEN = ("import_report", "diverged", "format", "format_version", "dt")  # long, or said elsewhere


def description(data: DataSet) -> dict[str, Any]:
    """The data set as JSON values: period, columns with units, alphabets, provenance."""
    return {
        "made_by": f"rcbht-jax {rcbht_jax.__version__}",
        "dt": data.recordings.dt,
        "recordings": len(data.recordings),
        "columns": COLUMNS,
        "alphabets": {
            layer: {
                name(layer, code): {"code": code, "meaning": meaning} for code, meaning in enumerate(MEANING[layer], 1)
            }
            for layer in LAYERS
        },
        "labels": {"name": data.tracks_name, **data.tracks_attrs},
        "store": {key: value for key, value in data.attrs.items() if key not in _HIDDEN},
        "confounds": confounds(data),
    }


def card(data: DataSet, layout: str, front: str = "") -> str:
    """The text of README.md.

    Args:
        data: what is exported.
        layout: Markdown about the files of this format.
        front: YAML between ``---`` lines, for hosts that read it.
    """
    recordings = data.recordings
    samples = int(recordings.length.sum())
    origin = "simulated" if "simulated" in data.attrs else "recorded"
    parts = [
        f"{front}# Wrench recordings",
        f"{len(recordings)} recordings of {len(set(_keys(recordings)))} {origin} trials, {samples} samples at "
        f"{1 / recordings.dt:g} Hz ({samples * recordings.dt / 60:.1f} min). A recording is one arm of one trial.",
        "**Licence:** not stated yet; name it here before you pass this on. It is that of the recordings, not that of "
        "the program that wrote them.",
        f"## Files\n\n{layout}",
        "## Units and frames\n\nForces Fx Fy Fz in N, moments Mx My Mz in N m, times in s from the first sample of a "
        "recording, evenly spaced. The wrench is as the source logged it: not tared, filtered, resampled or rotated. "
        "HIRO's one-arm trials, recorded or simulated, are in the robot's base frame (x forward, y left, z up), its "
        "two-arm trials in each wrist's frame; moments are about a point of the wrist.",
        f"## Labels\n\n{_labels(data)}",
        f"## Counts\n\n{_counts(recordings)}",
        "## Known confounds\n\n" + "\n".join(f"* {sentence}" for sentence in confounds(data)),
        f"## Provenance\n\nWritten by rcbht-jax {rcbht_jax.__version__}.\n\n```json\n"
        + json.dumps(description(data)["store"], indent=1, ensure_ascii=False)
        + "\n```",
    ]
    return "\n\n".join(parts) + "\n"


def confounds(data: DataSet) -> list[str]:
    """What a careful reader should know before scoring anything on this data: one sentence each."""
    recordings, found = data.recordings, []
    outcomes = sorted(set(recordings.outcome.tolist()))
    if len(outcomes) > 1:
        mixed = [s for s in np.unique(recordings.session) if len(set(recordings.outcome[recordings.session == s])) > 1]
        if not mixed:
            found.append(
                "No session holds more than one outcome: whatever tells sessions apart seems to tell outcomes apart."
            )
        found += _durations(recordings)
    copies = _copies(recordings)
    if copies:
        found.append(f"Exact copies of another recording: {copies}; keep copies on one side of every split.")
    missing = int(np.isnan(recordings.onset_harmonised).any(1).sum())
    if missing:
        found.append(f"Recordings that lack the start of a state: {missing}.")
    if data.attrs.get("importer") == "hiro":
        found += CONFOUNDS.values()
    return found or ["None was found; that does not mean that there is none."]


def _durations(recordings: Recordings) -> list[str]:
    """Whether the best threshold on duration tells success from failure."""
    good, bad = (recordings.length[recordings.outcome == word] for word in ("success", "failure"))
    if not (len(good) and len(bad)):
        return []
    cuts = np.unique(recordings.length)[:, None]
    balanced = ((good >= cuts).mean(1) + (bad < cuts).mean(1)) / 2
    best = float(np.maximum(balanced, 1 - balanced).max())
    sentence = f"Duration alone, at its best threshold, tells success from failure in {best:.0%} (balanced)."
    return [sentence] if best > 0.7 else []


def _copies(recordings: Recordings) -> int:
    rows = zip(recordings.wrench, recordings.length, strict=True)
    hashes = Counter(content_hash([wrench[:length]]) for wrench, length in rows)
    return sum(count - 1 for count in hashes.values())


def _keys(recordings: Recordings) -> list[tuple[str, str]]:
    return list(zip(recordings.source.tolist(), recordings.trial.tolist(), strict=True))


def _labels(data: DataSet) -> str:
    if data.tracks is None:
        return "None are included."
    how = data.tracks_attrs
    window = f", windows of {how['window']} samples" if "window" in how else ""
    return (
        f"`{data.tracks_name}` ({how.get('semantics', 'unknown')} taxonomy{window}): three layers, primitives, motion "
        "compositions (mc) and low-level behaviours (llb), for each axis. A label describes the samples from `t0` to "
        "before `t1`; it was known once `emit` samples had been received, which is later. Do not feed a predictor "
        "labels before their `emit`."
    )


def _counts(recordings: Recordings) -> str:
    lines = [
        "| source | session | outcome | arm | recordings | seconds (min/median/max) |",
        "|---|---|---|---|---|---|",
    ]
    fields = (recordings.source, recordings.session, recordings.outcome, recordings.arm)
    rows = list(zip(*(field.tolist() for field in fields), strict=True))
    for key in dict.fromkeys(rows):
        seconds = recordings.length[[row == key for row in rows]] * recordings.dt
        low, middle, high = np.quantile(seconds, (0.0, 0.5, 1.0))
        cells = " | ".join(str(word).replace("|", "\\|").replace("\n", " ") for word in key)
        lines.append(f"| {cells} | {len(seconds)} | {low:.2f} / {middle:.2f} / {high:.2f} |")
    return "\n".join(lines)
