"""JSON beside recordings: ``run1.json`` of ``run1.csv``, ``meta.json`` of a folder, exports of Label Studio."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from rcbht_jax._util.untrusted import check_inside, read_json
from rcbht_jax.io.importing.find import Item
from rcbht_jax.io.importing.json_documents import annotations_in, intervals_in
from rcbht_jax.io.importing.table import Interval, Table, scalars_of

_UPLOAD = re.compile(r"^[0-9a-f]{8}-")  # that it puts before the names of uploaded files
_QUERY = re.compile(r"[?&]\w+=|#")  # of an address
_UNFINISHED = ("predictions", "prediction", "drafts")
DEPTH = 4  # of lists and objects in a task
MAX_FACTS, MAX_WORD = 64, 200  # of one object; characters of one text
Facts = dict[str, str | float]
Stated = tuple[Facts, tuple[Interval, ...]]


@dataclass(frozen=True)
class Sidecars:
    """What JSON objects state about recordings."""

    facts: dict[str, Facts]  # file of a recording -> name -> value
    intervals: dict[str, tuple[Interval, ...]]  # file of a recording -> its annotations
    tables: tuple[Table, ...]  # of annotations
    files: tuple[str, ...]  # that were read

    def described(self, table: Table) -> Table:
        """The table with the facts about its file, of which its own come first, and the annotations of that file."""
        rate, own = scalars_of({key: np.asarray(value) for key, value in self.facts.get(table.file, {}).items()})
        intervals = (*table.intervals, *self.intervals.get(table.file, ()))
        return replace(table, facts={**own, **table.facts}, rate=table.rate or rate, intervals=intervals)


def sidecars_of(source: Path, items: Iterable[Item], others: Iterable[str]) -> Sidecars:
    """The objects among other files of a folder: one named after a recording describes it, else one alone in a folder
    below the source all recordings there. ``run1_2.json`` is named after ``run1_2.csv``, or if there is none, after
    ``run1.csv``.

    Numbers, texts and truth values of an object count, those of objects within it, and lists of objects that are
    annotations, with a label and a start. A document that is such a list is a table of annotations.
    """
    files: defaultdict[str, list[str]] = defaultdict(list)
    stems: defaultdict[tuple[str, str], list[str]] = defaultdict(list)  # of recordings by folder and stem
    for item in items:
        path = PurePosixPath(item.name)
        files[str(path.parent)].append(item.name)
        stems[str(path.parent), path.stem].append(item.name)
    facts: defaultdict[str, Facts] = defaultdict(dict)
    intervals: defaultdict[str, tuple[Interval, ...]] = defaultdict(tuple)
    alone: defaultdict[str, list[tuple[str, Stated]]] = defaultdict(list)
    read, tables = list[str](), list[Table]()
    for name in others:
        path = PurePosixPath(name)
        folder = str(path.parent)
        near = folder in files or folder == "."  # there may be many elsewhere, about pictures
        if path.suffix.lower() != ".json" or not near or not (found := _stated(source, name)):
            continue
        if isinstance(found, Table):
            read.append(name)
            tables.append(found)
            continue
        own = next((stems[folder, stem] for stem in _stems(path.stem) if (folder, stem) in stems), [])
        if own:
            read.append(name)
            for file in own:
                facts[file] |= found[0]
                intervals[file] += found[1]
        elif folder in files and folder != ".":
            alone[folder].append((name, found))
    for folder, objects in alone.items():
        if len(objects) == 1:
            [(name, found)] = objects
            read.append(name)
            for file in files[folder]:
                facts[file] = {**found[0], **facts[file]}
                intervals[file] += found[1]
    return Sidecars(dict(facts), dict(intervals), tuple(tables), tuple(read))


def _stems(stem: str) -> Iterator[str]:
    """The stems of recordings that a file may be named after, its own first: run1_meta, run1."""
    yield stem
    yield from (stem[:place] for place in range(len(stem) - 1, 0, -1) if stem[place] in "_-.")


def _stated(source: Path, name: str) -> Stated | Table | None:
    """What a document states about recordings, or its table of annotations; None = nothing that can be used."""
    try:
        check_inside(source / name, source)
        content = read_json(source / name)
        if not isinstance(content, dict):
            return annotations_in(name, regions_in(content) or content)
        stated = _facts(content), intervals_in(content)
    except (OSError, ValueError, OverflowError):  # it is listed as a file that was not read
        return None
    return stated if any(stated) else None


def _facts(content: dict[str, Any]) -> Facts:
    """Numbers and texts of an object, and of those within it as "outer.inner"; {} = there are too many."""
    inner = ((f"{key}.{one}", value) for key, group in content.items() if isinstance(group, dict)
             for one, value in group.items())  # fmt: skip
    found: Facts = {}
    for key, value in [*content.items(), *inner]:
        if key.rpartition(".")[2].lower() in ("trial", "note"):  # names are those of files, notes those of the import
            continue
        if isinstance(value, bool):
            found[key] = str(value).lower()
        elif isinstance(value, int | float):
            found[key] = float(value)
        elif isinstance(value, str) and len(value) <= MAX_WORD and value.isprintable():
            found[key] = value
    return found if len(found) <= MAX_FACTS else {}


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
