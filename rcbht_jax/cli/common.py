"""The options that several commands have; one without a text is described by the docstring of its field."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from rcbht_jax.cli.command import Folder, MadeBy, option

STORE = MadeBy('"rcbht simulate {path}", or from files of yours with "rcbht import auto FOLDER {path}"')
ONLINE_MODEL = MadeBy('"rcbht train-online STORE.zarr -o {path}"')
Store = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr"), STORE]
OutStore = Annotated[Path, tyro.conf.Positional, option("Store to create.", metavar="STORE.zarr"), Folder()]
Overwrite = Annotated[bool, option("Replace an existing store, once the new one is complete.", "")]
Trial = Annotated[str, tyro.conf.Positional, option("Name of the trial.", metavar="TRIAL")]
Tracks = Annotated[str, option("Label tracks to use, if the store has several.", "")]
Sources = Annotated[tuple[str, ...], option("Data sets to use.", "all")]
SourcePrefix = Annotated[str, option("Data set, or the start of its name, if several have a trial of this name.", "")]
Sessions = Annotated[tuple[str, ...], option("Recording sessions to use, for example A B.", "all")]
Outcomes = Annotated[
    tuple[str, ...], option("Outcomes to use.", "for a track, successes if there are any; for a column, all")
]
Arm = Annotated[str, option("Arm whose wrench to use, if the store has several.", "the last by name, as the right one")]
RobotName = Literal["auto", "hiro", "baxter", "pa10"]  # whose preset gives thresholds
ONLY_TRACK = "the only track of the store, else states; the outcome if there is nothing else"
Task = Annotated[str, option("Track of annotations, or column, whose classes to distinguish.", ONLY_TRACK)]
Boundaries = Annotated[
    str,
    option(
        "Variant of the track, for example of states: merged = states-merged; recorded = states itself, which is also "
        "used if there is no states-harmonised."
    ),
]
NewWindow = Annotated[
    int | None, option("Encode now with this many samples per linear fit.", "use the stored labels", metavar="INT")
]
OutModel = Annotated[Path, option("Model file to write: arrays and JSON, no code.", aliases=["-o"], metavar="MODEL")]
OutFigure = Annotated[
    Path,
    option("Figure to write: .png, .svg or .pdf; an existing one is replaced.", aliases=["-o"], metavar="OUT.png"),
]
CompileCache = Annotated[
    Path | None, option("Folder for compiled programs, which shortens the next start.", "user's cache", metavar="DIR")
]
Starts = Annotated[
    str,
    option(
        "Track of annotations whose intervals begin the sub-tasks of a recorded trial; recorded = that of the model's "
        "task, or the first track, harmonised = its corrected variant if there is one, none = no sub-tasks, detected = "
        "found by the model (train-online --detect)."
    ),
]
OneArm = Annotated[str | None, option("Arm to show, if the trial has both.", "", metavar="STR")]
BeliefRate = Annotated[float | None, option("Beliefs per second; 0 = one per window.", "about 10")]
WordRule = Annotated[
    Literal["paper", "fit"],
    option("Rule of the words: paper; or fit, where a word is a run of windows that one straight line explains."),
]
TOLERANCE = (
    "Largest root-mean-square difference of line and signal that --rule fit allows: one number in the unit of the "
    "axes, or one for each axis."
)
AUTO_TOLERANCE = "1.5 % of an axis's usual range, or more if its noise requires it"
Tolerance = Annotated[tuple[float, ...], option(TOLERANCE, AUTO_TOLERANCE)]
Weighing = Annotated[
    tuple[Literal["count", "time", "change"], ...],
    option(
        "Weights of labels in the families histogram and ngram: 1 each, their duration, or their change of value.",
        "time and count in histogram, count in ngram",
    ),
]
StreamFamily = Literal[  # of features that a stream can keep up to date
    "histogram", "ngram", "duration", "attributes", "offset", "course", "edges", "parts", "spread", "together", "order",
    "levels", "elapsed",
]  # fmt: skip


def belief_rate(chosen: float | None) -> float | Literal["auto"] | None:
    """The rate of beliefs as an introspector takes it: of an option that is 0 for every window, None for about 10."""
    return "auto" if chosen is None else chosen or None
