"""The data card: what the data is, where it comes from, and which conclusions it does not allow."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import rcbht_jax
from rcbht_jax._util.digest import content_hash
from rcbht_jax.io.export.dataset import DataSet
from rcbht_jax.io.export.tables import COLUMNS
from rcbht_jax.labels import LAYERS, MEANING, name
from rcbht_jax.types import Recordings

_OMITTED = ("import_report", "diverged", "format", "format_version", "dt")  # too long, or stated elsewhere


def write_card(data: DataSet, folder: Path, layout: str, front: str = "") -> None:
    """Write ``dataset.json`` and ``README.md``; the arguments are those of :func:`card`."""
    text = json.dumps(description(data), indent=1, ensure_ascii=False)
    (folder / "dataset.json").write_text(text + "\n", encoding="utf-8")
    (folder / "README.md").write_text(card(data, layout, front), encoding="utf-8")


def description(data: DataSet) -> dict[str, Any]:
    """The data set as JSON values: period, columns with units, alphabets, provenance."""
    return {
        "made_by": f"rcbht-jax {rcbht_jax.__version__}",
        "dt": data.recordings.dt,
        "axes": dict(zip(data.recordings.axes, data.recordings.units, strict=True)),
        "annotations": {track: list(names) for track, names in data.recordings.annotations.labels.items()},
        "recordings": len(data.recordings),
        "columns": COLUMNS,
        "alphabets": {
            layer: {
                name(layer, code): {"code": code, "meaning": meaning} for code, meaning in enumerate(MEANING[layer], 1)
            }
            for layer in LAYERS
        },
        "labels": {"name": data.tracks_name, **data.tracks_attrs},
        "store": {key: value for key, value in data.attrs.items() if key not in _OMITTED},
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
    trials = set(zip(recordings.source.tolist(), recordings.trial.tolist(), strict=True))
    origin = "simulated" if "simulated" in data.attrs else "recorded"
    about = description(data)
    parts = [
        f"{front}# Wrench recordings",
        f"{len(recordings)} recordings of {len(trials)} {origin} trials, {samples} samples at "
        f"{1 / recordings.dt:g} Hz ({samples * recordings.dt / 60:.1f} min). A recording is one arm of one trial.",
        "**Licence:** not stated yet; add it here before you share this data. It is the licence of the recordings, not "
        "that of the program that wrote these files.",
        f"## Files\n\n{layout}",
        f"## Units and frames\n\n{_axes(recordings)}; times in s from the first sample of a recording, evenly spaced. "
        + str(data.attrs.get("frames", "The source does not state the frame of the axes.")),
        f"## Labels\n\n{_labels(data)}",
        f"## Counts\n\n{_counts(recordings)}",
        "## Known confounds\n\n" + "\n".join(f"* {sentence}" for sentence in about["confounds"]),
        f"## Provenance\n\nWritten by rcbht-jax {rcbht_jax.__version__}.\n\n```json\n"
        + json.dumps(about["store"], indent=1, ensure_ascii=False)
        + "\n```",
    ]
    return "\n\n".join(parts) + "\n"


def _axes(recordings: Recordings) -> str:
    pairs = zip(recordings.axes, recordings.units, strict=True)
    return ", ".join(f"{axis} in {unit}" if unit else f"{axis} (unit not stated)" for axis, unit in pairs)


def confounds(data: DataSet) -> Sequence[str]:
    """What may be mistaken for a result on this data: one sentence each, derived from the data."""
    recordings = data.recordings
    sentences = _outcome_confounds(recordings) + _state_confounds(recordings)
    if copies := _copies(recordings):
        sentences.append(f"Exact copies of another recording: {copies}; keep copies on one side of every split.")
    return sentences or ["None was detected; that does not mean that there is none."]


def _outcome_confounds(recordings: Recordings) -> list[str]:
    if len(set(recordings.outcome.tolist())) < 2:
        return []
    sentences = []
    sessions = (recordings.outcome[recordings.session == session] for session in np.unique(recordings.session))
    if all(len(set(outcomes)) == 1 for outcomes in sessions):
        sentences.append("No session has more than one outcome: what separates sessions seems to separate outcomes.")
    accuracy = _duration_accuracy(recordings)
    if accuracy > 0.7:
        sentences.append(
            f"Duration alone separates success from failure with a balanced accuracy of {accuracy:.0%} at its best "
            "threshold."
        )
    return sentences


def _state_confounds(recordings: Recordings) -> list[str]:
    track = recordings.annotations.choose()
    if not track:
        return []
    sentences = []
    marks = recordings.annotations.of(track)
    names = marks.labels[track]
    if missing := int(np.isnan(recordings.starts(track)).any(1).sum()):
        sentences.append(f"Recordings that lack a label of the track {track}: {missing}.")
    seconds = marks.end - marks.start
    medians = [float(np.nanmedian(seconds[marks.code == code])) for code in np.unique(marks.code[seconds > 0])]
    if medians and max(medians) > 2 * min(medians):
        sentences.append(
            f"The {len(names)} classes of {track} differ in length: compare scores with those of duration alone."
        )
    first = recordings.annotations.of(recordings.annotations.tracks[0])
    if single := int((first.end - first.start < 1.5 * recordings.dt).sum()):
        sentences.append(f"Intervals of {next(iter(first.labels))} that last one sample or less: {single}.")
    return sentences


def _duration_accuracy(recordings: Recordings) -> float:
    """Balanced accuracy of the best threshold on duration; NaN without successes or without failures."""
    success, failure = (recordings.length[recordings.outcome == outcome] for outcome in ("success", "failure"))
    if not (len(success) and len(failure)):
        return float("nan")
    thresholds = np.unique(recordings.length)[:, None]
    balanced = ((success >= thresholds).mean(1) + (failure < thresholds).mean(1)) / 2
    return float(np.maximum(balanced, 1 - balanced).max())


def _copies(recordings: Recordings) -> int:
    rows = zip(recordings.wrench, recordings.length, strict=True)
    hashes = Counter(content_hash([wrench[:length]]) for wrench, length in rows)
    return sum(count - 1 for count in hashes.values())


def _labels(data: DataSet) -> str:
    if data.tracks is None:
        return "None are included."
    attrs = data.tracks_attrs
    window = f", windows of {attrs['window']} samples" if "window" in attrs else ""
    return (
        f"`{data.tracks_name}` ({attrs.get('semantics', 'unknown')} taxonomy{window}): three layers, primitives, "
        "motion compositions (mc) and low-level behaviours (llb), for each axis. A label describes the samples from "
        "`t0` to before `t1`; it was known once `emit` samples had been received, which is later. Do not give a "
        "predictor labels before their `emit`."
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
        cells = " | ".join(str(cell).replace("|", "\\|").replace("\n", " ") for cell in key)
        lines.append(f"| {cells} | {len(seconds)} | {low:.2f} / {middle:.2f} / {high:.2f} |")
    return "\n".join(lines)
