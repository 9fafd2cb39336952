"""Share of time in which the online encoder and the authors' online program give the same label.

Run: python -m experiments.online.agreement
Reads the recorded output of the authors' program (RCBHT_GOLDEN) and their trials (RCBHT_DATA).
"""

from __future__ import annotations

import json

import numpy as np

from experiments._lib.benchmarks import published_words, recorded, rounded
from experiments._lib.catalogue import GOLDEN
from experiments._lib.results_io import write_result
from rcbht_jax.labels import AXES, LAYERS, MC
from rcbht_jax.types import LabelTrack, LabelTracks

WINDOWS = (5, 10, 20)


def painted(label: np.ndarray, t0: np.ndarray, t1: np.ndarray, samples: int) -> np.ndarray:
    """Label of every sample; spans are half-open sample numbers in time order, 0 where none."""
    edges = np.zeros(samples, np.int64)
    for code, start, stop in zip(label, t0, t1, strict=True):
        edges[start:stop] = code
    return edges


def ours(track: LabelTrack, row: int, axis: int, samples: int) -> np.ndarray:
    used = track.label[row, axis] > 0
    label, begin, end = (getattr(track, name)[row, axis][used] for name in ("label", "t0", "t1"))
    return painted(label, begin, end, samples)


def reference(source: str) -> tuple[dict[str, np.ndarray], dict[tuple[str, str], int]]:
    trials = json.loads((GOLDEN / "online_reference/trials.json").read_text())
    table = dict(np.load(GOLDEN / f"online_reference/{source}.npz"))
    return table, {(t["trial"], t["arm"]): t["id"] for t in trials}


def main() -> None:
    recordings = recorded()
    tables = {source: reference(source) for source in np.unique(recordings.source)}
    result = {}
    for window in WINDOWS:
        tracks = published_words(recordings, window)
        shares: dict[str, list[list[list[float]]]] = {}
        for row, source in enumerate(recordings.source):
            table, ids = tables[source]
            samples = int(recordings.length[row])
            mine = table["trial"] == ids[str(recordings.trial[row]), str(recordings.arm[row])]
            shares.setdefault(str(source), []).append(
                [
                    [agreement(table, mine, tracks, row, layer, axis, samples, recordings.dt) for axis in range(6)]
                    for layer in range(3)
                ]
            )
        everything = [trial for trials in shares.values() for trial in trials]
        result[f"W={window}"] = {source: report(trials) for source, trials in {"all": everything, **shares}.items()}
    note = "mean over trials (and axes) of the share of samples with the same label; pc, nc and c count as one contact"
    write_result("online_agreement", "python -m experiments.online.agreement", {"measure": note, **result})


def agreement(
    table: dict[str, np.ndarray], mine: np.ndarray, tracks: LabelTracks, row: int, layer: int, axis: int,
    samples: int, dt: float,
) -> float:  # fmt: skip
    """Share of samples that both programs label, and alike; NaN where one has no label at all."""
    pick = mine & (table["layer"] == layer) & (table["axis"] == axis)
    t0, t1 = (np.rint(table[k][pick] / dt).astype(int) for k in ("t_start", "t_end"))
    theirs = painted(table["label"][pick], t0, t1, samples)
    own = ours(getattr(tracks, LAYERS[layer]), row, axis, samples)
    if layer == 1:
        theirs, own = (np.where((x >= MC.PC) & (x <= MC.C), MC.C, x) for x in (theirs, own))
    known = (theirs > 0) & (own > 0)
    return float((theirs == own)[known].mean()) if known.any() else float("nan")


def report(trials: list[list[list[float]]]) -> dict[str, dict[str, float]]:
    """Mean agreement per layer, over all axes and per axis, of shares [trial, layer, axis]."""
    shares = np.array(trials)
    out = {}
    for layer, name in enumerate(LAYERS):
        axes = np.nanmean(shares[:, layer], axis=0)
        mean = float(np.nanmean(shares[:, layer]))
        out[name] = {"all axes": mean, **dict(zip(AXES, axes.tolist(), strict=True))}
    return rounded(out)


if __name__ == "__main__":
    main()
