"""``rcbht view``."""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from rcbht_jax._util.arms import chosen_arm
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, check_place, progress_bar, unset
from rcbht_jax.cli.drawn import SAYS, DrawnRule, rule_of, stored_by
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.types import LabelTracks, Recordings
    from sim_mjx.validation.replay import Replay

WINDOW = 5  # samples, of the encoder that labels a store without labels


@dataclass(frozen=True)
class View(Command):
    """Show one trial: the motion of arm and parts, the wrench, the labels.

    A simulated trial is simulated again from its store; a recorded one moves the arm through the recorded joint
    angles (--data is the folder that was imported). On a display the trial opens in MuJoCo's viewer. Without one, or
    with -o, it is written to a file: key frames above wrench and labels (.png, .svg, .pdf), or a film (.gif, .mp4).

    Example: rcbht view trials.zarr sim-hooked-B-000003 -o trial.png
    """

    store: common.Store
    """Store made by "rcbht simulate" or "rcbht import hiro"."""
    trial: common.Trial
    out: Annotated[Path | None, unset(aliases=["-o"], metavar="OUT")] = None
    """File to write; default the viewer, without a display TRIAL.png."""
    data: Annotated[Path | None, unset(metavar="DIR")] = None
    """Folder that a recorded trial was imported from, which has the joint angles."""
    arm: common.Arm = ""
    source: common.SourcePrefix = ""
    tracks: common.Tracks = ""
    speed: float = 1.0
    """Playback speed in viewer and film: 1 = real time."""
    rule: DrawnRule = "fit"

    def run(self) -> dict[str, Any]:
        from rcbht_jax.cli.plot import find_recording
        from rcbht_jax.io.simulation import recordings_with_faults
        from rcbht_jax.plots import save
        from rcbht_jax.plots.trial import outcome_of
        from sim_mjx.plots import animation
        from sim_mjx.plots.trial_overview import trial_overview
        from sim_mjx.validation.replay import events

        out = self.out if self.out is not None or has_display() else Path(f"{self.trial}.png")
        if self.out is None and out is not None:
            if out.name != f"{self.trial}.png":
                raise InputError(f"The trial {self.trial!r} has no name for a file; choose one with -o.")
            check_place(out, None)
        self._check(out)
        motion = self._motion()
        recordings = recordings_with_faults(self.store)
        arm = chosen_arm(recordings.arm.tolist(), self.arm)
        row = find_recording(recordings, self.trial, arm, self.source)
        film = out is not None and out.suffix.lower() in animation.SUFFIXES
        drawn = None if out is None or film else self._labelled(recordings, row)  # refused before the simulation
        replay = motion(recordings, row)
        result = {"trial": str(recordings.trial[row]), "outcome": outcome_of(recordings, row), "how": replay.how}
        picture = None if out is None else str(out)
        times = events(replay, recordings, row)
        if out is None:
            show(replay, self.speed)
        elif drawn is None:
            with progress_bar("film", "frames") as bar:
                animation.film(out, replay, recordings, row, speed=self.speed, progress=lambda n, of: _show(bar, n, of))
        else:
            labelled, tracks, at, rule = drawn
            save(trial_overview(replay, labelled, tracks, at, times, SAYS[rule]), out)
        return {**result, "picture": picture, "moments": times}

    def text(self, result: dict[str, Any]) -> str:
        lines = [f"{result['trial']}, {result['outcome']}: {result['how']}"]
        lines += [f"  {seconds:7.2f} s  {name}" for name, seconds in result["moments"].items()]
        return "\n".join([*lines, *([result["picture"]] if result["picture"] else [])])

    def _labelled(self, recordings: Recordings, row: int) -> tuple[Recordings, LabelTracks, int, str]:
        """Recordings, labels, row and rule: labels of the store by the rule; if it has none, of this trial alone."""
        from rcbht_jax.calibration.rest import auto_thresholds
        from rcbht_jax.encoding.batch import encode_batch
        from rcbht_jax.encoding.rules import config_of, limits_for
        from rcbht_jax.encoding.thresholds import preset
        from rcbht_jax.io.label_store import choose_tracks, list_tracks
        from rcbht_jax.io.store import read_sample
        from rcbht_jax.robots.snap_assembly import HARMONISED

        name = self.tracks or (stored_by(self.store, self.rule) if list_tracks(self.store) else "")
        if name:
            _, tracks, attrs = choose_tracks(self.store, name)
            return recordings, tracks, row, rule_of(attrs)
        alone = _only(recordings, row)
        config = config_of(self.rule, WINDOW, recordings.dt)
        known = HARMONISED in recordings.annotations.labels
        thresholds = preset("hiro") if known else auto_thresholds(recordings, WINDOW, self.rule)
        sampled = read_sample(self.store)[0]  # tolerances of one trial turn the noise of an axis at rest into words
        limits = limits_for(config, thresholds, None, sampled.wrench, sampled.length)
        return alone, encode_batch(config, limits, alone.wrench, alone.length), 0, self.rule

    def _motion(self) -> Callable[[Recordings, int], Replay]:
        """What moves arm and parts in a trial of the store."""
        from rcbht_jax.io.store import read_attrs
        from sim_mjx.validation.replay import recorded, simulated

        attrs = read_attrs(self.store)
        if "simulated" in attrs:
            if self.data is not None:
                raise InputError(f"{self.store} is simulated, and needs no recorded joint angles; leave out --data.")
            return partial(simulated, self.store)
        if self.data is None and "joined" in attrs:
            raise InputError(
                "A joined store keeps no parameters of simulations; view a simulated trial in the store that simulated "
                "it, and a recorded one of HIRO with the folder that was imported: --data DIR."
            )
        if self.data is None:
            raise InputError(
                "A recorded trial of HIRO needs its joint angles; give the folder that was imported: --data DIR. Of "
                "other robots only simulated trials can be seen."
            )
        return partial(recorded, self.data)

    def _check(self, out: Path | None) -> None:
        from rcbht_jax.plots.canvas import check_suffix
        from sim_mjx.plots import animation

        if not 0.01 <= self.speed <= 100.0:
            raise InputError(f"The speed is {self.speed}; expected 0.01 to 100.")
        if out is None:
            check_window()
        elif out.suffix.lower() in animation.SUFFIXES:
            animation.check(out)
        else:
            check_suffix(out, animation.SUFFIXES)


def has_display() -> bool:
    """Whether windows can be opened here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_window() -> None:
    """Raise an error if the display cannot be opened: MuJoCo would end the process.

    Raises:
        InputError: there is none.
    """
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # GLFW warns of what the error below states
        if not glfw.init():
            raise InputError("The display cannot be opened; write a picture instead: -o OUT.png.")


def show(replay: Replay, speed: float) -> None:
    """Play a trial in MuJoCo's viewer, repeatedly, until its window is closed.

    Raises:
        InputError: the viewer cannot be opened.
    """
    import mujoco.viewer

    data = mujoco.MjData(replay.model)
    try:
        window = mujoco.viewer.launch_passive(replay.model, data)
    except Exception as error:  # whatever a graphics driver throws
        raise InputError(f"MuJoCo's viewer cannot be opened ({error}); write a picture instead: -o OUT.png.") from error
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
    one = recordings.take([row])
    return replace(one, wrench=np.ascontiguousarray(one.wrench[:, : one.length[0]]))


def _show(bar: Any, done: int, total: int) -> None:
    bar.total = total
    bar.update(done - bar.n)
