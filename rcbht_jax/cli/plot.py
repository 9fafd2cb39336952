"""``rcbht plot trial``, ``rcbht plot map`` and ``rcbht plot beliefs``."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from numpy.typing import NDArray

from rcbht_jax.cli.command import Command
from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import load
from rcbht_jax.introspection.session import Session
from rcbht_jax.io.label_store import choose_tracks
from rcbht_jax.io.playback import read_store
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning.tasks import STATES
from rcbht_jax.plots import label_map, save, trial_figure
from rcbht_jax.plots.beliefs import belief_map
from rcbht_jax.types import Recordings


@dataclass(frozen=True)
class PlotTrial(Command):
    """Draw one trial: its wrench, the fitted lines, the three layers of labels and the state boundaries.

    Example: rcbht plot trial hiro.zarr 20121127-HIROSA-S-05 -o trial.png
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store with label tracks, made by "rcbht encode"."""
    trial: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL")]
    """Name of the trial."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT.png")]
    """Figure to write: .png, .svg or .pdf; an existing one is replaced."""
    arm: Literal["R", "L"] | None = None
    """Which arm, where a trial has both."""
    source: str = ""
    """Data set, where several hold a trial of this name: the beginning of its name is enough."""
    tracks: str = ""
    """Label tracks to draw, where the store has several."""
    seconds: tuple[float, float] | None = None
    """First and last moment to show; default the whole trial."""

    def run(self) -> dict[str, Any]:
        recordings = read_recordings(self.store)
        index = find_recording(recordings, self.trial, self.arm, self.source)
        name, labels, attrs = choose_tracks(self.store, self.tracks)
        window = attrs.get("window")
        figure = trial_figure(
            recordings, labels, index, window=window if isinstance(window, int) else None, seconds=self.seconds
        )
        save(figure, self.out)
        found = {key: str(getattr(recordings, key)[index]) for key in ("trial", "arm", "source")}
        return {"figure": str(self.out), "tracks": name, **found}

    def text(self, result: dict[str, Any]) -> str:
        return (
            f"{result['figure']}: {result['source']} {result['trial']} arm {result['arm']}, labels {result['tracks']}"
        )


@dataclass(frozen=True)
class PlotMap(Command):
    """Draw the colour-coded label map of a store: a row per recording, a column per word, a colour per label.

    Example: rcbht plot map hiro.zarr -o map.png --layer llb --source REAL
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store with label tracks, made by "rcbht encode"."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT.png")]
    """Figure to write: .png, .svg or .pdf; an existing one is replaced."""
    layer: Literal["primitive", "mc", "llb"] = "llb"
    """Layer of labels."""
    by: Literal["word", "state"] = "word"
    """Columns: words of the sentence, or time normalised within each state."""
    words: int | None = None
    """Most words to show; default all."""
    source: tuple[str, ...] = ()
    """Data sets: the beginnings of their names, for example REAL; default all."""
    tracks: str = ""
    """Label tracks to draw, where the store has several."""

    def run(self) -> dict[str, Any]:
        recordings = read_recordings(self.store)
        select = _of_source(recordings, self.source)
        name, labels, _ = choose_tracks(self.store, self.tracks)
        title = " + ".join(self.source) or self.store.name
        figure = label_map(recordings, labels, self.layer, select=select, by=self.by, words=self.words, title=title)
        save(figure, self.out)
        return {"figure": str(self.out), "tracks": name, "layer": self.layer, "recordings": int(select.sum())}

    def text(self, result: dict[str, Any]) -> str:
        return f"{result['figure']}: {result['layer']} labels {result['tracks']} of {result['recordings']} recordings"


@dataclass(frozen=True)
class PlotBeliefs(Command):
    """Draw what a stream would have believed about one trial: a row per class, a column per look.

    The beliefs are worth what the trial was to the model: nothing if it was trained on it.

    Example: rcbht plot beliefs hiro.zarr 20121127-HIROSA-S-05 --model states.model -o beliefs.png
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store of recordings."""
    trial: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL")]
    """Name of the trial."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT.png")]
    """Figure to write: .png, .svg or .pdf; an existing one is replaced."""
    model: Annotated[Path, tyro.conf.arg(aliases=["-m"], metavar="MODEL")] = Path("online.model")
    """Model file made by "rcbht train-online"."""
    arm: Literal["R", "L"] = "R"
    """Which arm, where a trial has both."""
    starts: Literal["harmonised", "recorded", "detected"] = "harmonised"
    """Where the sub-tasks begin; detected = the model finds out (train-online --detect)."""
    rate: float = 10.0
    """Beliefs per second."""

    def run(self) -> dict[str, Any]:
        detect = self.starts == "detected"
        session = Session(Introspector(load(self.model), self.rate, detect=detect))
        messages = read_store(self.store, (self.trial,), self.arm, "none" if self.starts == "detected" else self.starts)
        events = list(session.run(messages))
        beliefs = sum(isinstance(event, Belief) for event in events)
        names = () if detect else STATES[1:]  # the first sub-task begins with the trial, and nobody says so
        save(belief_map(events, f"{self.trial}, arm {self.arm}, beginnings {self.starts}", names), self.out)
        return {"figure": str(self.out), "trial": self.trial, "arm": self.arm, "beliefs": beliefs}

    def text(self, result: dict[str, Any]) -> str:
        return f"{result['figure']}: {result['beliefs']} beliefs about {result['trial']} arm {result['arm']}"


def _of_source(recordings: Recordings, beginnings: tuple[str, ...]) -> NDArray[np.bool_]:
    """[recording] whether its data set's name begins with one of ``beginnings``; none given = all."""
    select = np.full(len(recordings), not beginnings)
    for beginning in beginnings:
        found = np.char.startswith(recordings.source, beginning)
        if not found.any():
            sources = ", ".join(dict.fromkeys(recordings.source.tolist()))
            raise InputError(f"No data set begins with {beginning!r}; the store holds: {sources}.")
        select |= found
    return select


def find_recording(recordings: Recordings, trial: str, arm: str | None, source: str) -> int:
    """Row of the one recording that is meant."""
    found = (recordings.trial == trial) & _of_source(recordings, (source,) if source else ())
    if arm is not None:
        found &= recordings.arm == arm
    rows = np.flatnonzero(found)
    if len(rows) == 1:
        return int(rows[0])
    if len(rows) > 1:
        meant = ", ".join(f"{recordings.source[row]} arm {recordings.arm[row]}" for row in rows)
        raise InputError(f"Several recordings are called {trial}; choose one with --arm or --source: {meant}.")
    close = get_close_matches(trial, dict.fromkeys(recordings.trial.tolist()), n=3, cutoff=0.0)
    which = f"{trial} of arm {arm}" if arm else trial
    raise InputError(f"There is no trial {which}; names like it: {', '.join(close)}.")
