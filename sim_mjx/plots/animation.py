"""A trial as a film: arm, parts and forces moving, as GIF (always) or MP4 (with the extra "video")."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES
from rcbht_jax.plots.canvas import new_figure, plain
from rcbht_jax.types import Recordings
from sim_mjx.plots.trial_overview import XYZ, headline, shade_states, still
from sim_mjx.validation.replay import Replay

INCHES, DPI = (9.6, 7.2), 100  # 960 x 720 pixels: even numbers, which video needs
RATE = {".gif": 10, ".mp4": 25}  # pictures per second
WIDE = 110  # letters that fit into a line of the title
SUFFIXES = tuple(RATE)


def check(path: Path) -> None:
    """Raise an error for a film that cannot be written, before it is computed.

    Raises:
        InputError: a suffix that is no film, or MP4 without its writer.
    """
    if path.suffix.lower() not in RATE:
        raise InputError(f"{path} is no film; its name must end in {' or '.join(RATE)}.")
    if path.suffix.lower() == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise InputError("MP4 needs imageio-ffmpeg: pip install 'rcbht-jax[video]'; or write a .gif.")


def film(
    path: Path,
    replay: Replay,
    recordings: Recordings,
    row: int,
    *,
    speed: float = 1.0,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Write a trial as a film, atomically; returns the number of pictures.

    Args:
        path: .gif or .mp4; an existing file is replaced when the new one is complete.
        replay: the motion. recordings: the trial's data set. row: of the trial in it.
        speed: seconds of the trial per second of film.
        progress: called with pictures done and in all.

    Raises:
        InputError: as :func:`check`.
    """
    check(path)
    rate = RATE[path.suffix.lower()]
    last = len(replay.qpos) - 1
    samples = np.append(np.arange(0, last, speed / rate / replay.dt), last).astype(int)  # also the end
    pictures = _pictures(replay, recordings, row, samples, progress)
    with atomic_write(path) as draft:
        (_write_gif if rate == RATE[".gif"] else _write_mp4)(draft, pictures, rate)
    return len(samples)


def _pictures(
    replay: Replay,
    recordings: Recordings,
    row: int,
    samples: NDArray[np.int64],
    progress: Callable[[int, int], None] | None,
) -> Iterator[NDArray[np.uint8]]:
    """Pictures [height, width, 3]."""
    figure = new_figure(INCHES, DPI)
    arm, close = figure.add_axes((0.03, 0.44, 0.45, 0.5)), figure.add_axes((0.52, 0.44, 0.45, 0.5))
    drawings = still((arm, close), replay, 0.0)
    cursor = _forces(figure, recordings, row)
    figure.suptitle(plain(fill(headline(replay, recordings, row), WIDE)), x=0.03, y=0.99, ha="left", fontsize=11)
    canvas: Any = FigureCanvasAgg(figure)
    shown, picture = -1, np.zeros((0, 0, 3), np.uint8)
    for count, sample in enumerate(samples.tolist()):
        if sample != shown:  # a slow film has several pictures of a sample
            for drawing in drawings:
                drawing.show(replay.qpos[sample], replay.past[sample])
            cursor.set_xdata([sample * replay.dt] * 2)
            canvas.draw()
            shown, picture = sample, np.asarray(canvas.buffer_rgba())[..., :3].copy()
        yield picture
        if progress is not None:
            progress(count + 1, len(samples))


def _forces(figure: Figure, recordings: Recordings, row: int) -> Any:
    """The forces under the pictures; returns the line that marks the present."""
    ax = figure.add_axes((0.08, 0.09, 0.89, 0.31))
    values = recordings.wrench[row, : recordings.length[row]]
    times = np.arange(len(values)) * recordings.dt
    for axis, color in enumerate(XYZ):
        ax.plot(times, values[:, axis], color=color, linewidth=1.1, label=AXES[axis])
    shade_states(ax, recordings, row, names=True)
    ax.set(xlim=(0, times[-1]), xlabel="time, s", ylabel="force, N")
    ax.legend(loc="lower right", ncols=3, fontsize=9, framealpha=0.8, edgecolor="none")
    return ax.axvline(0.0, color="black", linewidth=1.2)


def _write_gif(path: Path, pictures: Iterator[NDArray[np.uint8]], rate: int) -> None:
    first = Image.fromarray(next(pictures)).quantize(64)
    # with one palette for all, what does not move is stored once
    rest = (Image.fromarray(picture).quantize(palette=first, dither=Image.Dither.NONE) for picture in pictures)
    first.save(path, save_all=True, append_images=rest, duration=1000 // rate, loop=0)


def _write_mp4(path: Path, pictures: Iterator[NDArray[np.uint8]], rate: int) -> None:
    import imageio_ffmpeg

    first = next(pictures)
    writer = imageio_ffmpeg.write_frames(str(path), (first.shape[1], first.shape[0]), fps=rate)
    writer.send(None)
    try:
        writer.send(first)
        for picture in pictures:
            writer.send(picture)
    finally:
        writer.close()
