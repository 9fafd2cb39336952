"""Pictures of labels, which the encoder itself assigned to synthetic signals.

Run: python -m tools.docs_pictures
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

import rcbht_jax as rj
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.io.export.dataset import words
from rcbht_jax.labels import COLORS, LAYERS, LLB, MEANING, name
from rcbht_jax.plots import save
from rcbht_jax.plots.canvas import new_figure, text_color
from rcbht_jax.plots.trial import fitted_lines
from rcbht_jax.types import LabelTrack, LabelTracks

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
CONFIG = EncoderConfig()
# Samples of a good example: long enough to see, short enough to show its lines.
SHOWN = {"primitive": (5, 40), "mc": (10, 60), "llb": (20, 120)}


def signals(trials: int = 40, samples: int = 2000, seed: int = 0) -> NDArray[np.float32]:
    """Forces ``[trial, time, 6]`` of rest, ramps, knocks and shaking, in N; all six channels are forces here."""
    rng = np.random.default_rng(seed)
    slopes = np.zeros((trials, samples, 6))
    for trial, axis in np.ndindex(trials, 6):
        at = 0
        while at < samples:
            length = int(rng.integers(5, 80))
            kind = rng.choice([0.0, 0.3, 2.0, 12.0, 30.0, 60.0, 120.0], p=[0.3, 0.1, 0.2, 0.15, 0.1, 0.1, 0.05])
            if kind >= 60:
                length = int(rng.integers(5, 11))
            slopes[trial, at : at + length, axis] = kind * rng.choice([-1, 1])
            at += length
    wrench = np.cumsum(slopes, 1) * CONFIG.dt + rng.normal(size=slopes.shape) * 0.004
    return wrench.astype(np.float32)


def examples(tracks: LabelTracks, layer: str) -> dict[int, tuple[int, int, dict[str, Any]]]:
    """Of every label that occurs, the example nearest to the middle of ``SHOWN``: code -> trial, axis, word."""
    low, high = SHOWN[layer]
    found: dict[int, tuple[float, tuple[int, int, dict[str, Any]]]] = {}
    for trial, axis in np.ndindex(tracks.llb.label.shape[:2]):
        lane = words(getattr(tracks, layer), trial, axis)
        for slot, code in enumerate(lane["label"].tolist()):
            word = {field: values[slot].item() for field, values in lane.items()}
            samples = word["t1"] - word["t0"]
            distance = abs(samples - (low + high) / 2) + (0 if low <= samples <= high else 1000)
            if word["t0"] > 50 and (code not in found or distance < found[code][0]):
                found[code] = distance, (trial, axis, word)
    return {code: example for code, (_, example) in sorted(found.items())}


def draw(ax: Axes, wrench: NDArray[np.float32], tracks: LabelTracks, layer: str, example: tuple[int, int, Any]) -> None:
    """One example: the signal, the fitted lines, the word's span."""
    trial, axis, word = example
    margin = max(10, (word["t1"] - word["t0"]) // 2)
    first, last = max(0, word["t0"] - margin), min(wrench.shape[1], word["t1"] + margin)
    color = COLORS[layer][word["label"] - 1]
    seconds = np.arange(first, last) * CONFIG.dt
    ax.axvspan(word["t0"] * CONFIG.dt, word["t1"] * CONFIG.dt, color=color, alpha=0.35, linewidth=0)
    ax.plot(seconds, wrench[trial, first:last, axis], color="0.55", linewidth=2.5)
    lane = words(tracks.primitive, trial, axis)
    seen = (lane["t1"] > first) & (lane["t0"] < last)
    for line in fitted_lines(LabelTrack(**{field: values[seen] for field, values in lane.items()}), CONFIG.dt):
        ax.plot(line[:, 0], line[:, 1], color="black", linewidth=1.1)
    title = f"{name(layer, word['label'])}  {MEANING[layer][word['label'] - 1]}"
    ax.set_title(title, fontsize=10, color=text_color(color), backgroundcolor=color)
    ax.set_xlim(seconds[0], seconds[-1])
    ax.locator_params(axis="x", nbins=5)
    ax.tick_params(labelsize=7)


def one_push_or_two() -> None:
    """Write the picture of the tutorial: two pushes of one duration, and their different behaviours."""
    time = np.arange(600) * CONFIG.dt
    shapes = [np.interp(time, [1, 2], [0, 8]), np.interp(time, [1, 1.25, 1.75, 2], [0, 4, 4, 8])]
    wrench = np.zeros((2, len(time), 6))
    wrench[:, :, 2] = shapes
    frame = rj.encode(wrench, rate=1 / CONFIG.dt).to_frame()
    figure = new_figure((9.0, 2.8), 90)
    for column, title in enumerate(("one push", "the same duration, two pushes")):
        ax = figure.add_subplot(1, 2, column + 1)
        ax.plot(time, shapes[column], color="black", linewidth=1.8)
        chosen = (frame["recording"] == column) & (frame["axis"] == "Fz") & (frame["layer"] == "llb")
        for word in frame[chosen].itertuples():
            color, middle = COLORS["llb"][LLB[word.label] - 1], (word.t0 + word.t1) / 2 * CONFIG.dt
            ax.axvspan(word.t0 * CONFIG.dt, word.t1 * CONFIG.dt, color=color, alpha=0.6, linewidth=0)
            ax.text(middle, -1.3, word.label, ha="center", va="center", fontsize=10, weight="bold")
        ax.set(xlim=(0, time[-1]), ylim=(-2.2, 9), title=title, xlabel="time, s", ylabel="Fz, N")
    figure.tight_layout()
    save(figure, IMAGES / "one-or-two.png")


def main() -> None:
    """Write one picture per layer, and the one of the tutorial."""
    one_push_or_two()
    wrench = signals()
    limits = preset("hiro")
    limits = type(limits)(np.repeat(limits.limits[:1], 6, 0))  # all channels are forces
    tracks = encode_batch(CONFIG, limits, wrench, np.full(len(wrench), wrench.shape[1], np.int32))
    for layer in LAYERS:
        found = examples(tracks, layer)
        rows = -(-len(found) // 4) if len(found) < 9 else 3
        columns = -(-len(found) // rows)
        figure = new_figure((10.0, 2.1 * rows + 0.3), 90)
        for place, example in enumerate(found.values()):
            draw(figure.add_subplot(rows, columns, place + 1), wrench, tracks, layer, example)
        figure.supxlabel("time, s", fontsize=9)
        figure.supylabel("force, N", fontsize=9)
        figure.tight_layout()
        save(figure, IMAGES / f"labels-{layer}.png")


if __name__ == "__main__":
    main()
