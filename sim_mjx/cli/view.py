"""``rcbht view``."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from tqdm import tqdm  # type: ignore[import-untyped]

from rcbht_jax.cli.command import Command
from rcbht_jax.cli.plot import find_recording
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import choose_tracks, list_tracks
from rcbht_jax.io.store import read_attrs, read_recordings
from rcbht_jax.plots import save
from rcbht_jax.types import LabelTracks, Recordings
from sim_mjx.plots import animation
from sim_mjx.plots.trial_overview import trial_overview
from sim_mjx.validation.replay import Replay, moments, recorded, simulated

WINDOW = 5  # samples, of the encoder that labels a store without labels


@dataclass(frozen=True)
class View(Command):
    """Look at one trial: how arm and parts moved, the wrench, the labels.

    A simulated trial is simulated again from its store, physics and all; a recorded one leads the arm through its
    recorded joint angles (--data names the folder that was imported). Opens MuJoCo's viewer where there is a
    display; otherwise, or with -o, writes pictures: .png, .svg or .pdf a strip of the moments that matter above
    wrench and labels, .gif or .mp4 a film.

    Example: rcbht view trials.zarr sim-B-000003 -o trial.png
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store made by "rcbht simulate" or "rcbht import hiro"."""
    trial: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL")]
    """Name of the trial, for example sim-B-000003 or 20121127-HIROSA-S-35."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="OUT")] = None
    """File to write; default: the viewer, or without a display TRIAL.png."""
    data: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder that a recorded trial was imported from; it holds the joint angles."""
    arm: Literal["R", "L"] = "R"
    """Whose wrench to draw, where a trial has two arms."""
    source: str = ""
    """Data set, where several hold a trial of this name: the beginning of its name is enough."""
    tracks: str = ""
    """Label tracks to draw, where the store has several; a store without any is labelled for the picture."""
    speed: float = 1.0
    """Seconds of the trial per second in viewer and film."""

    def run(self) -> dict[str, Any]:
        out = self.out if self.out is not None or has_display() else Path(f"{self.trial}.png")
        self._check(out)
        recordings = read_recordings(self.store)
        row = find_recording(recordings, self.trial, self.arm, self.source)
        replay = self._replay(recordings, row)
        result = {"trial": str(recordings.trial[row]), "how": replay.how, "picture": None if out is None else str(out)}
        found = moments(replay, recordings.onset_harmonised[row])
        if out is None:
            show(replay, self.speed)
        elif out.suffix.lower() in animation.SUFFIXES:
            with tqdm(desc="film", unit=" pictures", file=sys.stderr, disable=None) as bar:
                animation.film(out, replay, recordings, row, speed=self.speed, progress=lambda n, of: _show(bar, n, of))
        else:
            save(trial_overview(replay, *self._labelled(recordings, row), found), out)
        return {**result, "moments": found}

    def text(self, result: dict[str, Any]) -> str:
        lines = [f"{result['trial']}: {result['how']}"]
        lines += [f"  {seconds:7.2f} s  {name}" for name, seconds in result["moments"].items()]
        return "\n".join([*lines, *([result["picture"]] if result["picture"] else [])])

    def _labelled(self, recordings: Recordings, row: int) -> tuple[Recordings, LabelTracks, int]:
        """The store's labels; of a store without any, this trial's own."""
        if self.tracks or list_tracks(self.store):
            return recordings, choose_tracks(self.store, self.tracks)[1], row
        alone = _only(recordings, row)
        config = EncoderConfig(WINDOW, recordings.dt)
        return alone, encode_batch(config, preset("hiro"), alone.wrench, alone.length), 0

    def _check(self, out: Path | None) -> None:
        if not 0.01 <= self.speed <= 100.0:
            raise InputError(f"The speed is {self.speed}; expected 0.01 to 100.")
        if out is not None and not out.absolute().parent.is_dir():
            raise InputError(f"{out.parent} is not a folder; create it first, or choose another place.")
        if out is not None and out.suffix.lower() in animation.SUFFIXES:
            animation.check(out)

    def _replay(self, recordings: Recordings, row: int) -> Replay:
        if "simulated" in read_attrs(self.store):
            return simulated(self.store, recordings, row)
        if self.data is None:
            raise InputError("A recorded trial needs its joint angles: name the folder that was imported, --data DIR.")
        return recorded(self.data, recordings, row)


def has_display() -> bool:
    """Whether windows can be opened here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def show(replay: Replay, speed: float) -> None:
    """Play a trial in MuJoCo's viewer, again and again, until its window is closed.

    Raises:
        InputError: the viewer cannot be opened.
    """
    import mujoco.viewer

    data = mujoco.MjData(replay.model)
    try:
        window = mujoco.viewer.launch_passive(replay.model, data)
    except Exception as error:  # whatever a graphics driver throws
        raise InputError(f"MuJoCo's viewer cannot be opened ({error}); write a picture with -o OUT.png.") from error
    with window:
        start = time.monotonic()
        while window.is_running():
            sample = int((time.monotonic() - start) * speed / replay.dt) % len(replay.qpos)
            data.qpos[:] = replay.qpos[sample]
            mujoco.mj_forward(replay.model, data)
            window.sync()
            time.sleep(1 / 60)


def _only(recordings: Recordings, row: int) -> Recordings:
    """A data set of one recording, without padding."""
    one = {f.name: getattr(recordings, f.name)[row : row + 1] for f in fields(Recordings) if f.name != "dt"}
    return replace(recordings, **one | {"wrench": np.ascontiguousarray(one["wrench"][:, : int(one["length"][0])])})


def _show(bar: Any, done: int, total: int) -> None:
    bar.total = total
    bar.update(done - bar.n)
