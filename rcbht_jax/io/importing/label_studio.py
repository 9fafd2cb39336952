"""Annotations that Label Studio exports in JSON: tasks, each with the name of a file and marked regions."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any

_UPLOAD = re.compile(r"^[0-9a-f]{8}-")  # that it puts before the names of uploaded files
_QUERY = re.compile(r"[?&]\w+=|#")  # of an address
_UNFINISHED = ("predictions", "prediction", "drafts")
DEPTH = 4  # of lists and objects in a task


def regions_in(content: Any) -> list[dict[str, str | float]]:
    """The regions of an export as rows of file, track, label, start and end; none if it is something else.

    Both forms are read: with all that the program knows ("JSON"), and the short one ("JSON-MIN"). The regions of
    further people who annotated a file are tracks of their own; predictions and what was cancelled are no annotations.

    >>> mark = {"start": 0.5, "end": 1.0, "timeserieslabels": ["push"]}
    >>> task = {"data": {"csv": "/data/upload/1/0a1b2c3d-run1.csv"}, "annotations": [{"result": [{"value": mark}]}]}
    >>> regions_in([task])
    [{'file': 'run1.csv', 'track': 'label', 'label': 'push', 'start': 0.5, 'end': 1.0}]
    >>> regions_in([{"csv": "run1.csv", "label": [mark]}]) == regions_in([task])
    True
    """
    tasks = [task for task in content if isinstance(task, dict)] if isinstance(content, list) else []
    found: list[dict[str, str | float]] = []
    people = Counter[str]()
    for task in tasks:
        data = task["data"] if isinstance(task.get("data"), dict) else task
        texts = (one for one in data.values() if isinstance(one, str))
        file = next((name for text in texts if (name := _file_in(text))), "")
        annotations = task.get("annotations", [task])
        for annotation in annotations if file and isinstance(annotations, list) else []:
            if regions := list(_regions(annotation)):
                people[file] += 1
                track = "label" if people[file] == 1 else f"label_{people[file]}"
                found += [{"file": file, "track": track, **row} for row in regions]
    return found


def _file_in(text: str) -> str:
    """The name of the file that an address ends in; "" = none."""
    paths = map(PurePosixPath, _QUERY.split(text))
    return next((_UPLOAD.sub("", path.name) for path in paths if path.suffix), "")


def _regions(value: Any, depth: int = 0) -> Iterator[dict[str, str | float]]:
    """Label, start and end of every region within a value."""
    if depth > 2 * DEPTH:
        return
    if isinstance(value, list):
        for one in value:
            yield from _regions(one, depth + 1)
    elif isinstance(value, dict) and value.get("was_cancelled") is not True:
        labels = next((one for key, one in value.items() if key.endswith("labels") and isinstance(one, list)), [])
        times = [value.get("start"), value.get("end")]
        if labels and all(isinstance(time, int | float | str) and not isinstance(time, bool) for time in times):
            start, end = (time if isinstance(time, str) else float(time) for time in times if time is not None)
            for label in (one for one in labels if isinstance(one, str | int | float)):
                yield {"label": str(label), "start": start, "end": end}
            return
        for key, one in value.items():
            if key not in _UNFINISHED:
                yield from _regions(one, depth + 1)
