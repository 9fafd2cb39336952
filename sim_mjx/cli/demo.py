"""``rcbht demo``."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from rcbht_jax.cli.command import Command
from rcbht_jax.cli.demo_recorded import DemoRecorded
from rcbht_jax.cli.encode import Encode
from rcbht_jax.cli.learning import Evaluate, Train
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.store import read_recordings, read_simulation
from rcbht_jax.plots import label_map, save
from rcbht_jax.types import Recordings
from sim_mjx.cli.simulate import Simulate
from sim_mjx.cli.view import View

PRESET: Literal["A"] = "A"
WINDOW = 5
# Enough to choose from in a demonstration; "rcbht evaluate" searches ten costs and three kernels.
KERNELS: tuple[Literal["linear", "rbf"], ...] = ("linear", "rbf")
COSTS, REPEATS = (0.1, 1.0, 10.0, 100.0), 2
STEPS = 5


@dataclass(frozen=True)
class Demo(Command):
    """The whole chain without any data: simulate, label, train, evaluate, draw pictures, sum up.

    Half of the simulated trials are nominal, half have a fault. With --data the chain runs on the authors' recorded
    trials instead.

    Example: rcbht demo --out demo-out
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")] = Path("demo-out")
    """Folder for stores, models, pictures and the summary; what an earlier demo left there is replaced."""
    data: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of the authors' data sets, to use instead of a simulation."""
    trials: int = 200
    """Trials to simulate."""
    seed: int = 0
    """Determines them."""

    def run(self) -> dict[str, Any]:
        if self.data is not None:
            return DemoRecorded(self.data, self.out).run()
        if self.trials < 40:
            raise InputError(f"{self.trials} trials are too few to train and test on; expected at least 40.")
        start = time.perf_counter()
        self.out.mkdir(parents=True, exist_ok=True)
        store = self.out / "trials.zarr"
        _say(1, f"simulate {self.trials} trials of session {PRESET}'s controller on {os.cpu_count()} cores")
        simulated = Simulate(store, preset=PRESET, trials=self.trials, seed=self.seed, overwrite=True).run()
        _say(2, f"label them with the streaming encoder, windows of {WINDOW} samples")
        encoded = Encode(store, window=WINDOW).run()
        _say(3, "train a classifier of states and one of outcomes")
        models = [self._train(store, task) for task in ("states", "outcome")]
        _say(4, f"evaluate both, {REPEATS} times five folds")
        scores = {
            task: Evaluate(store, task=task, kernels=KERNELS, costs=COSTS, repeats=REPEATS).run()
            for task in ("states", "outcome")
        }
        _say(5, "draw pictures")
        pictures = self._draw(store, encoded["name"])
        recordings = read_recordings(store)
        result = {
            "simulated": simulated,
            "seconds_per_trial": float(recordings.length.mean() * recordings.dt),
            "labels": encoded["labels"],
            "evaluation": scores,
            "models": models,
            "pictures": [str(path) for path in pictures],
            "seconds": time.perf_counter() - start,
        }
        summary = self.out / "summary.txt"
        summary.write_text(_summary(result))
        return {**result, "summary": str(summary)}

    def text(self, result: dict[str, Any]) -> str:
        return Path(result["summary"]).read_text().rstrip()

    def _train(self, store: Path, task: Any) -> str:
        path = self.out / f"{task}.model"
        path.unlink(missing_ok=True)
        return str(Train(store, task=task, kernels=KERNELS, costs=COSTS, out=path).run()["model"])

    def _draw(self, store: Path, tracks_name: str) -> list[Path]:
        recordings, (tracks, _) = read_recordings(store), read_tracks(store, tracks_name)
        paths = []
        for name, fault in (("success", "none"), ("failure", "jamming")):
            trial = _first(recordings, store, fault, name)
            if trial is not None:
                paths.append(self.out / f"{name}.png")
                View(store, trial, paths[-1]).run()
        paths.append(self.out / "label-map.png")
        rows = recordings.outcome == "success"
        figure = label_map(recordings, tracks, "llb", select=rows, by="state", title="simulated trials that succeeded")
        save(figure, paths[-1])
        return paths


def _first(recordings: Recordings, store: Path, fault: str, outcome: str) -> str | None:
    """Name of the first trial with a fault and an outcome."""
    found = np.flatnonzero((read_simulation(store)["fault"] == fault) & (recordings.outcome == outcome))
    return str(recordings.trial[found[0]]) if len(found) else None


def _summary(result: dict[str, Any]) -> str:
    simulated = result["simulated"]
    labels = ", ".join(f"{count:,} {layer}" for layer, count in result["labels"].items())
    lines = [
        f"rcbht demo: {simulated['stored']} simulated trials in {result['seconds']:.0f} s",
        "",
        f"Simulated   {result['seconds_per_trial']:.1f} s a trial on average; all four tabs seated in "
        f"{simulated['seated']} of {simulated['stored']}",
        *(
            f"            {kind:14}{row['seated']:4d} of {row['trials']:3d} seated"
            for kind, row in simulated["faults"].items()
        ),
        f"Labelled    {labels}",
        "",
        *_score("States", result["evaluation"]["states"], "which of the four states a sentence of labels comes from"),
        *_score("Outcome", result["evaluation"]["outcome"], "whether the whole trial's sentence ends in a snap"),
        "            States differ in length, faults in when they end a trial: compare with duration alone.",
        "",
        f"Models      {', '.join(result['models'])}",
        *(f"{'Pictures' if i == 0 else '':12}{path}" for i, path in enumerate(result["pictures"])),
    ]
    return "\n".join(lines) + "\n"


def _score(title: str, score: dict[str, Any], what: str) -> list[str]:
    rows = (("labels + SVM", "score"), ("duration alone", "duration_baseline"), ("most frequent", "majority_baseline"))
    lines = [f"{title:12}{what}: balanced accuracy on trials not trained on"]
    return lines + [f"            {name:16}{score[key]['balanced_accuracy']['mean']:.3f}" for name, key in rows]


def _say(step: int, what: str) -> None:
    print(f"[{step}/{STEPS}] {what}", file=sys.stderr, flush=True)
