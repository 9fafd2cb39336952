"""Annotations that Label Studio exports in JSON: tasks, each with the name of a file and marked regions."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any

_UPLOAD = re.compile(r"^[0-9a-f]{8}-")  # that it puts before the names of uploaded files
DEPTH = 4  # of lists and objects in a task


def regions_in(content: Any) -> list[dict[str, str | float]]:
    """The regions of an export as rows of file, label, start and end; none if it is something else.

    Both forms are read: with all that the program knows ("JSON"), and the short one ("JSON-MIN").

    >>> mark = {"start": 0.5, "end": 1.0, "timeserieslabels": ["push"]}
    >>> task = {"data": {"csv": "/data/upload/1/0a1b2c3d-run1.csv"}, "annotations": [{"result": [{"value": mark}]}]}
    >>> regions_in([task])
    [{'file': 'run1.csv', 'label': 'push', 'start': 0.5, 'end': 1.0}]
    >>> regions_in([{"csv": "run1.csv", "label": [mark]}]) == regions_in([task])
    True
    """
    tasks = [task for task in content if isinstance(task, dict)] if isinstance(content, list) else []
    found: list[dict[str, str | float]] = []
    for task in tasks:
        data = task["data"] if isinstance(task.get("data"), dict) else task
        texts = (one for one in data.values() if isinstance(one, str))
        file = next((PurePosixPath(text).name for text in texts if PurePosixPath(text).suffix), "")
        found += [{"file": _UPLOAD.sub("", file), **row} for row in _regions(task) if file]
    return found


def _regions(value: Any, depth: int = 0) -> Iterator[dict[str, str | float]]:
    """Label, start and end of every region within a value."""
    if depth > 2 * DEPTH:
        return
    if isinstance(value, list):
        for one in value:
            yield from _regions(one, depth + 1)
    elif isinstance(value, dict):
        labels = next((one for key, one in value.items() if key.endswith("labels") and isinstance(one, list)), [])
        times = [value.get("start"), value.get("end")]
        if labels and all(isinstance(time, int | float) and not isinstance(time, bool) for time in times):
            for label in labels:
                yield {"label": str(label), "start": float(value["start"]), "end": float(value["end"])}
            return
        for one in value.values():
            yield from _regions(one, depth + 1)
