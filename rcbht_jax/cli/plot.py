"""``rcbht plot`` and ``rcbht describe``: recordings as pictures and in sentences."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import tyro
from numpy.typing import NDArray

from rcbht_jax._util.arms import chosen_arm, common_arm, title_among
from rcbht_jax._util.printable import plural
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, option, unset
from rcbht_jax.cli.drawn import SAYS, DrawnRule, drawn_words, made_now_note, rule_of
from rcbht_jax.cli.readers import SnapSize, detector_of
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.types import Recordings


@dataclass(frozen=True)
class PlotTrial(Command):
    """Plot one trial: its signals, the linear fits, the three layers of labels and the state boundaries.

    For a store without labels, only signals and boundaries are shown; "rcbht encode" makes labels.

    Example: rcbht plot trial hiro.zarr 20121127-HIROSA-S-05 -o trial.png
    """

    store: common.Store
    """Store of recordings, with labels or without."""
    trial: common.Trial
    out: common.OutFigure
    arm: common.OneArm = None
    source: common.SourcePrefix = ""
    tracks: common.Tracks = ""
    seconds: Annotated[tuple[float, float] | None, unset()] = None
    """Start and end of the interval to show, s; default the whole trial."""
    rule: DrawnRule = "fit"

    def run(self) -> dict[str, Any]:
        from rcbht_jax.io.label_store import list_tracks
        from rcbht_jax.io.simulation import recordings_with_faults
        from rcbht_jax.plots import save, trial_figure

        recordings = recordings_with_faults(self.store)
        index = find_recording(recordings, self.trial, self.arm, self.source)
        name, labels, attrs = None, None, dict[str, Any]()
        if self.tracks or list_tracks(self.store):
            name, labels, attrs = drawn_words(self.store, self.tracks, self.rule)
        window = attrs.get("window")
        figure = trial_figure(
            recordings,
            labels,
            index,
            window=window if isinstance(window, int) else None,
            rule=rule_of(attrs),
            seconds=self.seconds,
        )
        save(figure, self.out)
        recording = {key: str(getattr(recordings, key)[index]) for key in ("trial", "arm", "source")}
        title = title_among(recording["arm"], recordings.arm)
        return {"figure": str(self.out), "tracks": name, **recording, "arm_title": title}

    def text(self, result: dict[str, Any]) -> str:
        missing = f'no labels; make them with "rcbht encode {self.store}"'
        name = result["tracks"]
        labels = missing if name is None else f"labels {name}{made_now_note(self.store, name)}"
        what = ", ".join(filter(None, (f"{result['source']} {result['trial']}", result["arm_title"])))
        return f"{result['figure']}: {what}, {labels}"


@dataclass(frozen=True)
class PlotMap(Command):
    """Plot the labels of a store as a map: a row per recording, a column per word, a colour per label.

    Example: rcbht plot map hiro.zarr -o map.png --layer llb --source REAL
    """

    store: common.Store
    """Store with label tracks, made by "rcbht encode"."""
    out: common.OutFigure
    layer: Literal["primitive", "mc", "llb"] = "llb"
    """Layer of the labels."""
    by: Literal["word", "state"] = "word"
    """Columns: words of the sentence, or time normalised within the first interval of each state."""
    max_words: Annotated[int | None, option("Number of words to show; default all.", "")] = None
    source: Annotated[tuple[str, ...], unset()] = ()
    """Data sets to show, or the beginnings of their names, for example REAL; default all."""
    tracks: common.Tracks = ""
    rule: DrawnRule = "fit"

    FORMER: ClassVar[dict[str, str]] = {"--words": "--max-words"}

    def run(self) -> dict[str, Any]:
        from rcbht_jax.io.store import read_recordings
        from rcbht_jax.plots import label_map, save

        recordings = read_recordings(self.store)
        select = _of_source(recordings, self.source)
        name, labels, attrs = drawn_words(self.store, self.tracks, self.rule)
        title = f"{' + '.join(self.source) or self.store.name}, {SAYS[rule_of(attrs)]}"
        figure = label_map(recordings, labels, self.layer, select=select, by=self.by, words=self.max_words, title=title)
        save(figure, self.out)
        return {"figure": str(self.out), "tracks": name, "layer": self.layer, "recordings": int(select.sum())}

    def text(self, result: dict[str, Any]) -> str:
        count = plural(result["recordings"], "recording")
        name = result["tracks"]
        return f"{result['figure']}: {result['layer']} labels {name} of {count}{made_now_note(self.store, name)}"


@dataclass(frozen=True)
class PlotBeliefs(Command):
    """Plot the beliefs of a model over one replayed trial: a row per class, a column per belief.

    Beliefs over a trial that the model was trained on do not show how it performs on new ones.

    Example: rcbht plot beliefs hiro.zarr 20121127-HIROSA-S-05 --model states.model -o beliefs.png
    """

    store: common.Store
    """Store of recordings."""
    trial: common.Trial
    out: common.OutFigure
    model: Annotated[Path, tyro.conf.arg(aliases=["-m"], metavar="MODEL"), common.ONLINE_MODEL] = Path("online.model")
    """Model file of "rcbht train-online"."""
    arm: Annotated[str, unset("that of the model, else the last by name, as the right one")] = ""
    """Arm whose wrench to use, if the store has several."""
    source: common.SourcePrefix = ""
    starts: common.Starts = "harmonised"
    rate: common.BeliefRate = None

    def run(self) -> dict[str, Any]:
        from rcbht_jax._util.digest import among, wrench_digests
        from rcbht_jax.events import Belief
        from rcbht_jax.introspection.introspector import Introspector
        from rcbht_jax.introspection.model import load
        from rcbht_jax.introspection.session import Session
        from rcbht_jax.io.playback import NONE, play, track_of_starts
        from rcbht_jax.io.store import read_recordings
        from rcbht_jax.plots import save
        from rcbht_jax.plots.beliefs import belief_map

        detect = self.starts == "detected"
        model, recordings = load(self.model), read_recordings(self.store)
        model.check_axes(recordings.axes, recordings.units, str(self.store))
        names = recordings.arm.tolist()
        arm = chosen_arm(names, self.arm or common_arm(names, [model.arm]))
        title = title_among(arm, recordings.arm)
        recordings = recordings.take(np.array([find_recording(recordings, self.trial, arm, self.source)]))
        seen = None  # an older file does not say it
        if len(model.digests):
            seen = bool(among(wrench_digests(recordings.wrench, recordings.length), model.digests)[0])
        session = Session(Introspector(model, common.belief_rate(self.rate), detect=detect))
        starts = NONE if detect else self.starts
        events = list(session.run(play(recordings, (), arm, starts, str(self.store), model.subtasks)))
        beliefs = sum(isinstance(event, Belief) for event in events)
        track = "" if starts == NONE else track_of_starts(recordings.annotations, starts, model.subtasks)
        how = f"beginnings of the track {track}" if track else "beginnings detected" if detect else "no beginnings"
        shown = self.trial, title, how, "training data" if seen else ""
        save(belief_map(events, ", ".join(filter(None, shown))), self.out)
        about = {"trial": self.trial, "arm": arm, "arm_title": title, "beliefs": beliefs, "trained_on": seen}
        return {"figure": str(self.out), **about}

    def text(self, result: dict[str, Any]) -> str:
        about = ", ".join(filter(None, (result["trial"], result["arm_title"])))
        trained = {
            True: "The model was trained on this recording: its beliefs about it are optimistic.",
            None: "Whether the model was trained on this recording is not known.",
        }
        drawn = f"{result['figure']}: {result['beliefs']} beliefs about {about}"
        return "\n".join(filter(None, (drawn, trained.get(result["trained_on"]))))


@dataclass(frozen=True)
class Describe(Command):
    """Describe a trial in sentences: which axes rise, fall or ring, when, by how much and how fast, and what snaps.

    The store needs no labels: the lines of the fit rule are computed here. A rise or fall is given in full; its
    duration is the time from a tenth to nine tenths of it, and its sentence begins at the tenth.

    Without --snap, a snap is a force that falls within 40 ms by at least the smallest reported change of the force that
    changes most; at 12.5 samples per second or less, none can be seen. Its size is how far the force had fallen along
    the words that published it, which may be half of the fall; the sentence of the fall has all of it. Use "rcbht
    import --tare": a constant offset counts as a load, and a brief contact can look like its release. A size larger
    than the load is marked as such.

    Example: rcbht describe hiro.zarr 20121127-HIROSA-S-05
    """

    store: common.Store
    """Store of recordings; label tracks are not needed."""
    trial: common.Trial
    arm: common.OneArm = None
    source: common.SourcePrefix = ""
    task: Annotated[str, option("Track of annotations to name.", "the first, or its corrected variant")] = ""
    snap: SnapSize = ()
    least: Annotated[
        float,
        option(
            "Smallest change to report, as a share of the usual range of its axis; changes as small as its noise are "
            "never reported."
        ),
    ] = 0.2

    def run(self) -> dict[str, Any]:
        from rcbht_jax.introspection.description import describe_recording
        from rcbht_jax.io.store import read_recordings

        recordings = read_recordings(self.store)
        index = find_recording(recordings, self.trial, self.arm, self.source)
        snaps = detector_of(self.snap, 1 / recordings.dt)
        sentences = describe_recording(recordings, index, self.least, self.task, snaps)
        return {"trial": self.trial, "sentences": [{"seconds": seconds, "text": text} for seconds, text in sentences]}

    def text(self, result: dict[str, Any]) -> str:
        rows = result["sentences"]
        if not rows:
            return f"{result['trial']}: nothing changes."
        return "\n".join(f"{row['seconds']:7.2f} s  {row['text']}" for row in rows)


def _of_source(recordings: Recordings, beginnings: tuple[str, ...]) -> NDArray[np.bool_]:
    """[recording] whether its data set's name begins with one of ``beginnings``; none given = all."""
    select = np.full(len(recordings), not beginnings)
    for beginning in beginnings:
        matches = np.char.startswith(recordings.source, beginning)
        if not matches.any():
            sources = ", ".join(dict.fromkeys(recordings.source.tolist()))
            raise InputError(f"No data set begins with {beginning!r}; the store has: {sources}.")
        select |= matches
    return select


def find_recording(recordings: Recordings, trial: str, arm: str | None, source: str) -> int:
    """Row of the one recording of a trial."""
    matches = (recordings.trial == trial) & _of_source(recordings, (source,) if source else ())
    if arm is not None:
        matches &= recordings.arm == arm
    rows = np.flatnonzero(matches)
    if len(rows) == 1:
        return int(rows[0])
    if len(rows) > 1:
        choices = ", ".join(f"{recordings.source[row]} arm {recordings.arm[row]}" for row in rows)
        raise InputError(f"Several recordings are called {trial}; choose one with --arm or --source: {choices}.")
    close = get_close_matches(trial, dict.fromkeys(recordings.trial.tolist()), n=3, cutoff=0.0)
    which = f"{trial} of arm {arm}" if arm else trial
    raise InputError(f"There is no trial {which}; similar names: {', '.join(close)}.")
