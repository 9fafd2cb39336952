"""``rcbht segment``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from rcbht_jax._util.arms import learned_arm, rows_of_arm
from rcbht_jax._util.cells import table_text
from rcbht_jax._util.printable import plural
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, Flag, option, progress_bar, unset
from rcbht_jax.cli.rules import checked_tolerance
from rcbht_jax.errors import InputError


@dataclass(frozen=True)
class Segment(Command):
    """Label every sample of recordings whose intervals are unknown, and measure how well that works.

    Annotated recordings are labelled by a model trained on others, and scored; recordings without annotation are
    labelled by a model trained on all annotated ones. The table has a row per interval: recording (its number in
    the store), source, trial, arm, label, start and end in seconds, and whether the recording was annotated.

    Example: rcbht segment caps.zarr --task phase -o segments.csv
    """

    store: common.Store
    """Store of recordings; label tracks are not needed."""
    task: Annotated[str, option("Track of annotations whose labels to learn.", "the first")] = ""
    source: common.Sources = ()
    group: Annotated[str, option("Column whose groups are never split between training and test.")] = "trial"
    folds: Annotated[int, option("Parts, each labelled by a model of the others; 0 = one part per group.")] = 5
    one_shot: Flag = False
    """Train on one recording at a time and test on all others."""
    offline: Flag = False
    """Use later samples as well; by default no label depends on samples after it."""
    rule: common.WordRule = "paper"
    tolerance: common.Tolerance = ()
    seed: int = 0
    """Seed of trees and copies."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="SEGMENTS.csv")] = Path("segments.csv")
    """Table to write."""
    write_model: Annotated[Path | None, unset(metavar="SEGMENTER")] = None
    """Also write the segmenter trained on all annotated recordings, for "rcbht stream --segmenter"."""
    arm: common.Arm = ""

    def run(self) -> dict[str, Any]:
        from rcbht_jax._util.atomic import atomic_write
        from rcbht_jax.encoding.rules import AUTO
        from rcbht_jax.introspection.segmentation import Protocol, segment
        from rcbht_jax.introspection.segmenter import WrenchSegmenter
        from rcbht_jax.introspection.segmenter_file import SegmenterFile, save
        from rcbht_jax.io.store import read_recordings
        from rcbht_jax.learning.tasks import TaskSpec, chosen_recordings

        if self.write_model is not None and self.offline:
            raise InputError("A segmenter that reads later samples cannot follow a stream; leave out --offline.")
        if self.one_shot and self.folds != Segment.folds:
            raise InputError("--one-shot trains on one recording at a time, without folds; leave out --folds.")
        if self.out.suffix != ".csv":
            raise InputError(f"{self.out} must end in .csv.")
        recordings = read_recordings(self.store)
        chosen = np.flatnonzero(chosen_recordings(recordings, TaskSpec(sources=self.source, outcomes=())))
        rows, remarks = rows_of_arm(recordings.arm[chosen], self.arm)
        chosen = chosen[rows]
        protocol = Protocol(self.task, self.group, self.folds, self.one_shot)
        tolerance = checked_tolerance(self.rule, self.tolerance, len(recordings.axes))
        words = {"rule": self.rule, "tolerance": AUTO if tolerance is None else tolerance}
        segmenter = WrenchSegmenter(offline=self.offline, random_state=self.seed, **words)
        with progress_bar("segment", "models") as bar:
            keep = self.write_model is not None
            result = segment(recordings.take(chosen), segmenter, protocol, bar.update, keep)
        head = ("recording", "source", "trial", "arm", "label", "start", "end", "annotated")
        with atomic_write(self.out) as draft:
            intervals = ((int(chosen[row]), *rest) for row, *rest in result.rows())  # numbers in the store
            draft.write_text(table_text(head, *intervals), encoding="utf-8")
        if self.write_model is not None:
            arm = self.arm or learned_arm(str(recordings.arm[chosen[0]]), recordings.arm)
            save(self.write_model, SegmenterFile.of(result.model, result.protocol.track, result.classes, arm))
        model = {} if self.write_model is None else {"model": str(self.write_model)}
        missing = sum(not len(labels) for labels in result.predicted)
        how = {"causal": not self.offline, "rule": self.rule, "unlabelled": missing, "remarks": remarks}
        return {"out": str(self.out), **model, **how, **result.to_json()}

    def text(self, result: dict[str, Any]) -> str:
        how = "causal" if result["causal"] else "offline"
        lines = [
            f"{result['out']}: {plural(result['recordings'], 'recording')}, {result['annotated']} of them annotated "
            f"with {result['track']} ({', '.join(result['classes'])})"
        ]
        names = {"macro_f1": "macro F1", "edit": "edit score"}  # as the page has them
        for name, value in result["score"].items():
            unit = " s, median" if name == "delay" else ""
            shown = names.get(name, name).replace("f1@", "F1@")
            lines.append(f"  {shown:32}{_with_interval(value, *result['interval'][name])}{unit}")
        lines.append(f"  {'most frequent class':32}{result['majority']:.3f}")
        model = [f"{result['model']}: trained on all annotated recordings"] if "model" in result else []
        missing = result["unlabelled"]
        none = f"Not in the table: {plural(missing, 'recording')}, as none of another {self.group} has two classes."
        return "\n".join([*lines, f"{result['protocol']}, {how}", *model, *[none] * bool(missing), *result["remarks"]])


def _with_interval(value: float | None, low: float | None, high: float | None) -> str:
    """A score and its interval, if it has one of any width."""
    if value is None:
        return "-"
    limits = "" if low is None or high is None or low == high else f" ({low:.3f} to {high:.3f})"
    return f"{value:.3f}{limits}"
