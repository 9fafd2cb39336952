"""The film on the README: a simulated assembly, its wrench as lines, words of the fit rule, and described in sentences.

Run: python -m tools.readme_film [trials.zarr], in make figures. Without a store (of preset A) it simulates one.
The first picture is the last one, so that the film tells its story where it is not played.
"""

from __future__ import annotations

import re
import sys
import tempfile
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from PIL import Image

import rcbht_jax as rj
from rcbht_jax._util.atomic import atomic_write
from rcbht_jax.cli.main import main as rcbht
from rcbht_jax.cli.plot import find_recording
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance
from rcbht_jax.introspection.description import describe_recording
from rcbht_jax.labels import COLORS, LLB, MEANING, name
from rcbht_jax.plots.canvas import new_figure, text_color
from rcbht_jax.plots.trial import fitted_lines
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings
from sim_mjx.assembly.task import STATES
from sim_mjx.plots.projection import SIDE, Drawing
from sim_mjx.plots.trial_overview import shade_states
from sim_mjx.validation.replay import Replay, simulated

OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "assembly.gif"
TRIAL, TRIALS = "sim-A-000004", 5
SHOWN = ("Fz", "Fx")
FIRST, LAST = 5.6, 20.4  # s of the trial: the end of the approach, until the parts rest
FRAMES, RATE = 75, 10  # pictures, pictures per second
HOLD = 4000  # ms, the complete picture
WIDE, NARROW = 0.75, 0.34  # s, shortest spans into which a word, or its abbreviation, is written
PALE = 0.35  # opacity of what is not published yet
LEFT, RIGHT = 0.068, 0.988
SIGNAL, LINES = "0.72", "black"
TOP, CELL, CAPTION = 0.988, 0.225, 0.752  # of the row of moments, in heights of the picture
BOTTOMS = ((0.355, 0.22), (0.112, 0.22))  # of the forces: bottom and height
STORY = "A robot snaps two\nparts together. What its\nwrist feels becomes\nlines, words, sentences."
NUMBERS = "①②③④⑤⑥"


@dataclass(frozen=True)
class Known:
    """What the encoder has published at one moment, and what it would publish if the stream ended: ``[slot]``."""

    published: dict[str, LabelTrack]
    provisional: dict[str, LabelTrack]


def one_trial(recordings: Recordings, row: int) -> Recordings:
    """The axes that are shown, of one recording."""
    columns = [recordings.axes.index(axis) for axis in SHOWN]
    wrench = recordings.wrench[row, : recordings.length[row], columns].T
    units = [recordings.units[column] for column in columns]
    return Recordings.from_arrays([wrench], 1 / recordings.dt, axes=SHOWN, units=units)


def streamed(trial: Recordings, times: list[float]) -> list[dict[str, Known]]:
    """Per moment, and per axis, what is known of primitives and behaviours."""
    config = FitConfig(dt=trial.dt)
    limits = FitLimits(
        np.asarray(rj.preset(axes=trial.axes).limits),
        auto_tolerance(trial.wrench, trial.length, config.needed),
    )
    encoder, out, published, done = rj.Encoder(config, limits), [], [], 0
    for seconds in times:
        now = round(seconds / trial.dt)
        published += encoder.push(trial.wrench[0, done:now])
        held, done = encoder.peek(), now
        out.append({axis: Known(_lanes(published, k), _lanes([held], k)) for k, axis in enumerate(trial.axes)})
    return out


def _lanes(parts: list[LabelTracks], axis: int) -> dict[str, LabelTrack]:
    """Primitives and behaviours of one axis in several tracks, without empty slots."""
    out = {}
    for layer in ("primitive", "llb"):
        found = [jax.tree.map(lambda values: np.asarray(values)[axis], getattr(part, layer)) for part in parts]
        whole = jax.tree.map(lambda *values: np.concatenate(values), *found)
        out[layer] = jax.tree.map(lambda values, used=whole.label > 0: values[used], whole)
    return out


class Force:
    """One axis with its fitted lines, above the words that they became."""

    def __init__(self, figure: Figure, place: tuple[float, float], trial: Recordings, axis: str) -> None:
        bottom, height = place
        band = 0.05
        self.signal = figure.add_axes((LEFT, bottom + band, RIGHT - LEFT, height - band))
        self.band = figure.add_axes((LEFT, bottom, RIGHT - LEFT, band), sharex=self.signal)
        self.dt, self.values = trial.dt, trial.wrench[0, :, trial.axes.index(axis)]
        shown = self.values[round(FIRST / self.dt) : round(LAST / self.dt)]
        margin = 0.12 * float(np.ptp(shown))
        self.signal.set(xlim=(FIRST, LAST), ylim=(shown.min() - margin, shown.max() + margin))
        self.signal.set_ylabel(f"{axis}, N", fontsize=11)
        self.signal.tick_params(labelbottom=False, bottom=False, labelsize=9)
        self.signal.locator_params(axis="y", nbins=4)
        self.band.set(ylim=(0, 1), yticks=[])
        self.band.set_ylabel("words", fontsize=9.5, rotation=0, ha="right", va="center")
        self.band.tick_params(labelsize=9)
        (self.line,) = self.signal.plot([], [], color=SIGNAL, linewidth=3.2, solid_joinstyle="round")
        self.now = [ax.axvline(LAST, color="0.2", linewidth=1.0) for ax in (self.signal, self.band)]
        self.drawn: list[Any] = []

    def show(self, known: Known, seconds: float) -> None:
        """Draw all that is known at a moment."""
        for artist in self.drawn:
            artist.remove()
        samples = np.arange(round(FIRST / self.dt), round(seconds / self.dt))
        self.line.set_data(samples * self.dt, self.values[samples])
        for line in self.now:
            line.set(xdata=[seconds, seconds], visible=seconds < LAST)
        self.drawn = []
        for lanes, alpha in ((known.published, 1.0), (known.provisional, PALE)):
            lines = list(fitted_lines(lanes["primitive"], self.dt))
            fits = LineCollection(lines, colors=LINES, linewidths=1.4, alpha=(1 + alpha) / 2, capstyle="round")
            self.drawn.append(self.signal.add_collection(fits, autolim=False))
            spans = (np.asarray(getattr(lanes["llb"], field)).tolist() for field in ("label", "t0", "t1"))
            for code, first, end in zip(*spans, strict=True):
                self._word(code, first * self.dt, end * self.dt, alpha)

    def _word(self, code: int, start: float, end: float, alpha: float) -> None:
        color, width = COLORS["llb"][code - 1], min(end, LAST) - max(start, FIRST)
        bar = Rectangle((start, 0), end - start, 1, facecolor=color, alpha=alpha, edgecolor="white")
        bar.set_linewidth(0.8 if width > 0.1 else 0)
        self.drawn.append(self.band.add_patch(bar))
        text = MEANING["llb"][code - 1] if width > WIDE else name("llb", code) if width > NARROW else ""
        if text:
            middle = (max(start, FIRST) + min(end, LAST)) / 2
            ink = "black" if alpha < 1 else text_color(color)
            self.drawn.append(self.band.text(middle, 0.46, text, ha="center", va="center", fontsize=9.5, color=ink))


class Moment:
    """The parts while one sentence comes true, and the sentence."""

    def __init__(self, figure: Figure, left: float, width: float, replay: Replay, text: str) -> None:
        self.ax = figure.add_axes((left, TOP - CELL, width, CELL))
        self.replay, self.drawing = replay, Drawing(self.ax, replay.model, SIDE)
        frame(self.ax)
        self.text = figure.text(left, CAPTION, text, fontsize=10, va="top", linespacing=1.2)

    def show(self, seconds: float, begun: bool, told: bool) -> None:
        """The parts at a moment, and the sentence once it is known."""
        self.ax.set_visible(begun)
        self.text.set_visible(told)
        self.drawing.show(*at_moment(self.replay, seconds))
        x, y = self.drawing.place("MOUNT")
        look_at(self.ax, x - 0.02, y + 0.016, 0.026)


def at_moment(replay: Replay, seconds: float) -> tuple[Any, Any]:
    """Positions, and which tabs are past their lips."""
    sample = min(round(seconds / replay.dt), len(replay.qpos) - 1)
    return replay.qpos[sample], replay.past[sample]


def frame(ax: Axes) -> None:
    ax.set(xticks=[], yticks=[])
    for spine in ax.spines.values():
        spine.set_color("0.75")


def look_at(ax: Axes, x: float, y: float, half: float) -> None:
    """Show what lies within ``half`` metres above and below a point."""
    box = ax.get_window_extent()
    wide = half * box.width / box.height
    ax.set(xlim=(x - wide, x + wide), ylim=(y - half, y + half))


class Film:
    """The whole picture, at any moment."""

    def __init__(self, replay: Replay, recordings: Recordings, row: int) -> None:
        self.figure, self.replay, self.trial = new_figure((9.0, 6.0), 100), replay, one_trial(recordings, row)
        self.sentences = [one for one in describe_recording(self.trial, 0) if FIRST < one[0] < LAST]
        self.done = [start + longest(text) for start, text in self.sentences]
        cells = len(self.sentences) + 1
        gap, left = 0.012, 0.012
        width = (RIGHT - left - gap * (cells - 1)) / cells
        lefts = [left + (width + gap) * k for k in range(cells)]
        robot = self.figure.add_axes((lefts[0], TOP - CELL, width, CELL))
        self.robot = Drawing(robot, replay.model, SIDE)
        self.robot.show(replay.qpos[0], replay.past[0])
        frame(robot)
        look_at(robot, 0.2, self.robot.place("MOUNT")[1] + 0.22, 0.3)
        self.figure.text(left, CAPTION, STORY, fontsize=10, va="top", color="0.35", linespacing=1.2)
        self.moments = [
            Moment(self.figure, one, width, replay, f"{NUMBERS[k]} {start:.1f} s\n{wrapped(text)}")
            for k, (one, (start, text)) in enumerate(zip(lefts[1:], self.sentences, strict=True))
        ]
        self.forces = {axis: Force(self.figure, BOTTOMS[k], self.trial, axis) for k, axis in enumerate(SHOWN)}
        self.marks: list[tuple[float, Any]] = []  # when it appears, artist
        self._mark(recordings, row)
        _legend(self.figure)

    def _mark(self, recordings: Recordings, row: int) -> None:
        """States, and where the sentences begin."""
        upper, lower = self.forces.values()
        upper.band.tick_params(labelbottom=False, bottom=False)
        lower.band.set_xlabel("time, s", fontsize=9.5, labelpad=1)
        onset = recordings.starts(HARMONISED)[row]
        for ax in (upper.signal, lower.signal):
            shade_states(ax, recordings, row, names=False)
            for start, _ in self.sentences:
                line = ax.axvline(start, color="0.35", linewidth=0.8, linestyle=(0, (2, 2)))
                self.marks.append((start, line))
        ends = np.clip([*onset, LAST], FIRST, LAST)
        for state, middle in zip(STATES, (ends[:-1] + ends[1:]) / 2, strict=True):
            at = upper.signal.get_xaxis_transform()
            upper.signal.text(middle, 0.97, state, transform=at, ha="center", va="top", fontsize=9, color="0.4")
        for number, (start, _) in zip(NUMBERS, self.sentences, strict=False):
            at = upper.signal.get_xaxis_transform()
            text = upper.signal.text(start, 1.02, number, transform=at, ha="center", va="bottom", fontsize=11)
            self.marks.append((start, text))

    def picture(self, seconds: float, known: dict[str, Known]) -> Image.Image:
        """All that is known at one moment."""
        self.robot.show(*at_moment(self.replay, seconds))
        for moment, begun, done in zip(self.moments, [FIRST, *self.done], self.done, strict=False):
            moment.show(min(seconds, done), begun <= seconds, done <= seconds)
        for start, artist in self.marks:
            artist.set_visible(start <= seconds)
        for axis, force in self.forces.items():
            force.show(known[axis], seconds)
        canvas: Any = FigureCanvasAgg(self.figure)
        canvas.draw()
        return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _legend(figure: Figure) -> None:
    """Colours of the words, and what is pale."""
    handles: list[Any] = [
        Line2D([], [], color=SIGNAL, linewidth=3.2, label="wrench"),
        Line2D([], [], color=LINES, linewidth=1.4, label="its lines"),
    ]
    for code in (LLB.FX, LLB.CT, LLB.PS, LLB.PL, LLB.N):
        handles.append(Patch(facecolor=COLORS["llb"][code - 1], label=MEANING["llb"][code - 1]))
    handles.append(Patch(facecolor=COLORS["llb"][LLB.PS - 1], alpha=PALE, label="pale: not yet final"))
    figure.legend(
        handles=handles, loc="lower center", ncols=len(handles), fontsize=9, frameon=False, borderpad=0,
        bbox_to_anchor=(0.5, 0.003), handlelength=1.2, columnspacing=1.0, handletextpad=0.4,
    )  # fmt: skip


def longest(text: str) -> float:
    """Seconds after which a sentence has come true."""
    return max(float(seconds) for seconds in re.findall(r"(?:in|for) ([\d.]+) s", text))


def wrapped(text: str) -> str:
    """A sentence in lines of a cell's width, one part for each axis."""
    return "\n".join("\n".join(textwrap.wrap(part, 25)) for part in re.split(r"(?<=,) (?=F)", text))


def pictures(replay: Replay, recordings: Recordings, row: int) -> list[Image.Image]:
    """The trial at ``FRAMES`` times, after the complete picture."""
    film, times = Film(replay, recordings, row), np.linspace(FIRST + 0.2, LAST, FRAMES).tolist()
    frames = [film.picture(*moment) for moment in zip(times, streamed(film.trial, times), strict=True)]
    return [frames[-1], *frames[:-1]]


def made(folder: Path) -> Path:
    """A store with the trial of the film."""
    store = folder / "trials.zarr"
    if rcbht(["simulate", str(store), "--preset", "A", "--trials", str(TRIALS)]):
        raise SystemExit("The trial of the film cannot be simulated.")
    return store


def write(store: Path) -> None:
    """Simulate a stored trial again and write its film, with one palette: what does not move is stored once."""
    recordings = rj.read_recordings(store)
    row = find_recording(recordings, TRIAL, "R", "")
    frames = pictures(simulated(store, recordings, row), recordings, row)
    strip = np.concatenate([np.asarray(frames[k]) for k in (0, FRAMES // 4, -FRAMES // 5)])  # pale words too
    palette = Image.fromarray(strip).quantize(128)
    indexed = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in frames]
    durations = [HOLD] + [1000 // RATE] * (FRAMES - 1)
    with atomic_write(OUT) as draft:
        indexed[0].save(
            draft, format="GIF", save_all=True, append_images=indexed[1:], duration=durations, loop=0, disposal=1
        )


if __name__ == "__main__":
    if len(sys.argv) > 1:
        write(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            write(made(Path(folder)))
