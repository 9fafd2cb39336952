"""The film on the README: one simulated assembly, and the words that its wrench becomes.

Run: rcbht simulate trials.zarr --preset B --trials 8
     python -m tools.readme_film trials.zarr sim-B-000003
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from numpy.typing import NDArray
from PIL import Image

import rcbht_jax as rj
from rcbht_jax._util.atomic import atomic_write
from rcbht_jax.cli.plot import find_recording
from rcbht_jax.labels import AXES, COLORS, LLB, MEANING
from rcbht_jax.plots.canvas import new_figure, text_color
from rcbht_jax.types import Recordings
from sim_mjx.plots.trial_overview import XYZ, still
from sim_mjx.validation.replay import Replay, simulated

OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "assembly.gif"
FIRST, LAST = 4.5, 7.6  # s of the trial: the end of the approach, contact, and settling before the parts snap
FRAMES, RATE = 63, 10  # pictures, pictures per second
HOLD = 3000  # ms, the last picture
WINDOW = 10  # samples
FORCE, MOMENT = (60.0, 30.0, 12.0, 3.0), (6.0, 3.0, 1.2, 0.3)  # N/s, Nm/s: above the noise of this sensor
SHOWN = ("Fx", "Fz")
WIDE, NARROW = 0.3, 0.13  # s, shortest spans into which a word, or its abbreviation, is written


class Panel:
    """One force above the behaviours that it became, both up to the present."""

    def __init__(self, figure: Figure, bottom: float, axis: str, wrench: NDArray[Any], words: Any, dt: float) -> None:
        force = figure.add_axes((0.43, bottom + 0.115, 0.555, 0.25))
        band = figure.add_axes((0.43, bottom, 0.555, 0.1))
        self.dt, self.values, color = dt, wrench[:, AXES.index(axis)], XYZ[AXES.index(axis)]
        shown = self.values[round(FIRST / dt) : round(LAST / dt)]
        force.set(xlim=(FIRST, LAST), ylim=(shown.min() - 1.5, shown.max() + 1.5), xticks=[])
        force.set_ylabel(f"{axis}, N", fontsize=10, color=color)
        force.tick_params(labelsize=8)
        band.set(xlim=(FIRST, LAST), ylim=(0, 1), yticks=[])
        band.tick_params(labelsize=8)
        (self.line,) = force.plot([], [], color=color, linewidth=1.5)
        self.word = force.text(0.012, 0.95, "", transform=force.transAxes, va="top", fontsize=12, weight="bold")
        chosen = words[(words["axis"] == axis) & (words["layer"] == "llb") & (words["t1"] * dt > FIRST)]
        self.bars = [self._bar(band, word) for word in chosen.itertuples()]

    def _bar(self, band: Axes, word: Any) -> tuple[float, float, str, Rectangle, Text]:
        code, start, end = LLB[word.label] - 1, word.t0 * self.dt, word.t1 * self.dt
        color, meaning = COLORS["llb"][code], MEANING["llb"][code]
        bar = band.add_patch(Rectangle((start, 0), end - start, 1, color=color, linewidth=0))
        left, right = max(start, FIRST), min(end, LAST)
        text = meaning if right - left > WIDE else word.label if right - left > NARROW else ""
        middle = band.text((left + right) / 2, 0.5, text, ha="center", va="center", fontsize=9, color=text_color(color))
        return start, end, meaning, bar, middle

    def show(self, seconds: float) -> None:
        """Draw the force and its words until ``seconds``; words grow, and their names appear half-way."""
        samples = np.arange(round(FIRST / self.dt), round(seconds / self.dt))
        self.line.set_data(samples * self.dt, self.values[samples])
        for start, end, meaning, bar, text in self.bars:
            bar.set_width(float(np.clip(seconds, start, end)) - start)
            text.set_visible(text.get_position()[0] <= seconds)
            if start <= seconds < end:
                color = bar.get_facecolor()
                style = {"facecolor": color, "linewidth": 0, "pad": 3}
                self.word.set(text=meaning, color=text_color(color), bbox=style)


def pictures(replay: Replay, recordings: Recordings, row: int) -> list[Image.Image]:
    """The trial at ``FRAMES`` times: arm and parts on the left, forces and words on the right."""
    wrench = recordings.wrench[row, : recordings.length[row]]
    limits = rj.GradientThresholds(np.array([FORCE] * 3 + [MOMENT] * 3))
    words = rj.encode(wrench, rate=1 / recordings.dt, window=WINDOW, thresholds=limits).to_frame()
    figure = new_figure((9.0, 4.2), 100)
    figure.text(0.02, 0.93, "Two parts meet", fontsize=13)
    figure.text(0.43, 0.93, "the force at the wrist, and its words", fontsize=13)
    drawings = still(
        (figure.add_axes((0.02, 0.48, 0.34, 0.42)), figure.add_axes((0.02, 0.03, 0.34, 0.42))), replay, 0.0
    )
    panels = [Panel(figure, 0.53 - 0.43 * n, axis, wrench, words, recordings.dt) for n, axis in enumerate(SHOWN)]
    canvas: Any = FigureCanvasAgg(figure)
    frames = []
    for seconds in np.linspace(FIRST + 0.05, LAST, FRAMES):
        sample = round(seconds / replay.dt)
        for drawing in drawings:
            drawing.show(replay.qpos[sample], replay.past[sample])
        for panel in panels:
            panel.show(seconds)
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))
    return frames


def main(store: Path, trial: str) -> None:
    """Simulate a stored trial again and write its film, with one palette: what does not move is stored once."""
    recordings = rj.read_recordings(store)
    row = find_recording(recordings, trial, "R", "")
    frames = pictures(simulated(store, recordings, row), recordings, row)
    palette = frames[-1].quantize(64)
    indexed = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [1000 // RATE] * (FRAMES - 1) + [HOLD]
    with atomic_write(OUT) as draft:
        indexed[0].save(
            draft, format="GIF", save_all=True, append_images=indexed[1:], duration=durations, loop=0, disposal=1
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
