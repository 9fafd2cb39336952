"""The data card: what the data is, where it comes from, and which conclusions it does not allow."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import rcbht_jax
from rcbht_jax._util.columns import measured, with_units
from rcbht_jax._util.printable import plural
from rcbht_jax.io.export.dataset import DataSet
from rcbht_jax.io.export.tables import COLUMNS
from rcbht_jax.io.simulation import origin_of
from rcbht_jax.labels import LAYERS, MEANING, name
from rcbht_jax.learning import confounds as learning
from rcbht_jax.learning.task_choice import task_names
from rcbht_jax.learning.tasks import TaskSpec
from rcbht_jax.types import Recordings

_OMITTED = ("import_report", "diverged", "format", "format_version", "dt")  # too long, or stated elsewhere

OWN = "of the store, which has a column of this name; the computed one is left out"


def write_card(data: DataSet, folder: Path, layout: str, front: str = "") -> None:
    """Write ``dataset.json`` and ``README.md``; the arguments are those of :func:`card`."""
    about = description(data)  # once: it reads all wrenches
    text = json.dumps(about, indent=1, ensure_ascii=False)
    (folder / "dataset.json").write_text(text + "\n", encoding="utf-8")
    (folder / "README.md").write_text(card(data, layout, front, about), encoding="utf-8")


def description(data: DataSet) -> dict[str, Any]:
    """The data set as JSON values: period, columns with units, alphabets, provenance."""
    return {
        "made_by": f"rcbht-jax {rcbht_jax.__version__}",
        "dt": data.recordings.dt,
        "axes": dict(zip(data.recordings.axes, data.recordings.units, strict=True)),
        "annotations": {track: list(names) for track, names in data.recordings.annotations.labels.items()},
        "column_types": {
            column: "text" if values.dtype.kind == "U" else str(values.dtype)
            for column, values in data.recordings.columns.items()
        },
        "recordings": len(data.recordings),
        "columns": COLUMNS | {column: OWN for column in ("samples", "seconds") if column in data.recordings.columns},
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


def card(data: DataSet, layout: str, front: str = "", about: dict[str, Any] | None = None) -> str:
    """The text of README.md.

    Args:
        data: what is exported.
        layout: Markdown about the files of this format.
        front: YAML between ``---`` lines, for hosts that read it.
        about: of :func:`description`; default made here.
    """
    about = description(data) if about is None else about
    recordings = data.recordings
    samples = int(recordings.length.sum())
    trials = set(zip(recordings.source.tolist(), recordings.trial.tolist(), strict=True))
    origin = origin_of(data.attrs)
    parts = [
        f"{front}# {measured(recordings.axes, recordings.units).capitalize()} recordings",
        f"{plural(len(recordings), 'recording')} of {plural(len(trials), f'{origin} trial'.lstrip())}, "
        f"{plural(samples, 'sample')} at {1 / recordings.dt:g} Hz "
        f"({samples * recordings.dt / 60:.1f} min). A recording is one arm of one trial."
        + ("" if origin else " Whether the trials were recorded or simulated is not known."),
        "**Licence:** not stated yet; add it here before you share this data. It is the licence of the recordings, not "
        "that of the program that wrote these files.",
        f"## Files\n\n{layout}",
        f"## Units and frames\n\n{with_units(about['axes'])}; times in s from the first sample of a "
        "recording, evenly spaced. "
        + str(data.attrs.get("frames", "The source does not state the frame of the axes.")),
        f"## Labels\n\n{_labels(data)}",
        f"## Counts\n\n{_counts(recordings)}",
        "## Known confounds\n\n" + "\n".join(f"* {sentence}" for sentence in about["confounds"]),
        f"## Provenance\n\nWritten by rcbht-jax {rcbht_jax.__version__}.\n\n```json\n"
        + json.dumps(about["store"], indent=1, ensure_ascii=False)
        + "\n```",
    ]
    return "\n\n".join(parts) + "\n"


def confounds(data: DataSet) -> Sequence[str]:
    """Confounds: what may be mistaken for a result on this data, one sentence each, derived from the data."""
    recordings, facts, tasks_of = data.recordings, data.facts(), dict[str, list[str]]()
    for task in task_names(recordings):
        spec, title = TaskSpec(task), task
        if task in recordings.annotations.tracks:  # as the files hold it
            spec, title = TaskSpec(task, "recorded", outcomes=()), f"{task} (all outcomes)"
        for sentence in learning.examined(recordings, spec, facts)[1]:
            tasks_of.setdefault(sentence, []).append(title)
    sentences = [f"Task{'s' * (len(of) > 1)} {', '.join(of)}: {sentence}" for sentence, of in tasks_of.items()]
    copies = learning.copies(data.digests)  # also of recordings that are in no task
    if copies and copies not in tasks_of:
        sentences.append(copies)
    sentences = sentences or ["None was detected; that does not mean that there is none."]
    if facts is None:
        sentences.append("The first seconds of the recordings were not compared, since the store is large.")
    return sentences


def _labels(data: DataSet) -> str:
    if not data.tracks_name:
        return "None are included."
    attrs = data.tracks_attrs
    window = f", windows of {attrs['window']} samples" if "window" in attrs else ""
    if attrs.get("config", {}).get("rule") == "fit":
        window += ", words by the fit rule"
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
    durations: dict[tuple[str, ...], list[float]] = {}
    for key, samples in zip(zip(*(field.tolist() for field in fields), strict=True), recordings.length, strict=True):
        durations.setdefault(key, []).append(samples * recordings.dt)
    for key, seconds in durations.items():
        low, middle, high = np.quantile(seconds, (0.0, 0.5, 1.0))
        cells = " | ".join(str(cell).replace("|", "\\|").replace("\n", " ") for cell in key)
        lines.append(f"| {cells} | {len(seconds)} | {low:.2f} / {middle:.2f} / {high:.2f} |")
    return "\n".join(lines)
