"""``rcbht demo``."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax._util.printable import plural
from rcbht_jax.cli.command import Command, Folder, announce, unset
from rcbht_jax.cli.drawn import SAYS, drawn_words
from rcbht_jax.cli.encode import Encode
from rcbht_jax.cli.learning import Evaluate, Train
from rcbht_jax.cli.store import ImportHiro
from rcbht_jax.errors import InputError
from sim_mjx.cli.simulate import Simulate

if TYPE_CHECKING:
    from rcbht_jax.types import Recordings

PRESET: Literal["hooked-B"] = "hooked-B"  # its hooks catch, and let go seconds into mating
WINDOW = 5
# Enough to choose from in a demonstration; "rcbht evaluate" searches ten costs and three kernels.
KERNELS: tuple[Literal["linear", "rbf"], ...] = ("linear", "rbf")
COSTS, REPEATS = (0.1, 1.0, 10.0, 100.0), 2
STEPS = 5
TITLE = "rcbht demo"
WRITTEN = (
    "trials.zarr", "hiro.zarr", "states.model", "outcome.model", "success.png", "failure.png", "label-map.png",
    "summary.txt",
)  # fmt: skip
RECORDED = "REAL_HIRO_ONE_SA_SUCCESS"


@dataclass(frozen=True)
class Demo(Command):
    """Run the whole chain on simulated trials: simulate, encode, train, evaluate, plot, summarise.

    Half of the simulated trials are nominal, half have a fault. With --data the chain runs on the authors' recorded
    trials instead.

    Example: rcbht demo --out demo-out
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT"), Folder(grows=True)] = Path("demo-out")
    """Folder for stores, models, pictures and the summary; those of an earlier demo are replaced."""
    data: Annotated[Path | None, unset(metavar="DIR")] = None
    """Folder of the authors' data sets, to use in place of a simulation."""
    trials: int = 100
    """Trials to simulate."""
    seed: int = 0
    """Seed of the random numbers."""
    rule: Literal["fit", "paper"] = "fit"
    """Rule of the words in the pictures: fit, whose words follow the signal, or paper."""

    def run(self) -> dict[str, Any]:
        if self.data is not None:
            return _run_recorded(self.data, self.out, self.rule)
        if self.trials < 40:
            raise InputError(f"--trials is {self.trials}; expected at least 40, to train and test on.")
        from rcbht_jax.io.store import read_recordings

        start = time.perf_counter()
        _begin(self.out)
        store = self.out / "trials.zarr"
        cores = plural(os.cpu_count() or 1, "core")
        announce(1, STEPS, f"simulate {plural(self.trials, 'trial')} of the preset {PRESET} on {cores}")
        simulated = Simulate(store, preset=PRESET, trials=self.trials, seed=self.seed, overwrite=True).run()
        announce(2, STEPS, f"encode them with the streaming encoder, windows of {WINDOW} samples")
        encoded = Encode(store, window=WINDOW).run()
        announce(3, STEPS, "train a classifier of states and one of outcomes")
        models = [self._train(store, task) for task in ("states", "outcome")]
        announce(4, STEPS, f"evaluate both by {REPEATS} x 5-fold cross-validation")
        scores = {
            task: Evaluate(store, task=task, kernels=KERNELS, costs=COSTS, repeats=REPEATS).run()
            for task in ("states", "outcome")
        }
        announce(5, STEPS, "plot")
        pictures = self._draw(store)
        recordings = read_recordings(store)
        result = {
            "simulated": simulated,
            "seconds_per_trial": float(recordings.length.mean() * recordings.dt),
            "labels": encoded["labels"],
            "evaluation": scores,
            "models": models,
            "pictures": [str(path) for path in pictures],
            "words of the pictures": self.rule,
            "seconds": time.perf_counter() - start,
        }
        summary = self.out / "summary.txt"
        with atomic_write(summary) as draft:
            draft.write_text(_summary(result))
        return {**result, "summary": str(summary)}

    def text(self, result: dict[str, Any]) -> str:
        return Path(result["summary"]).read_text().rstrip()

    def _train(self, store: Path, task: Any) -> str:
        path = self.out / f"{task}.model"
        path.unlink(missing_ok=True)
        return str(Train(store, task=task, kernels=KERNELS, costs=COSTS, out=path).run()["model"])

    def _draw(self, store: Path) -> list[Path]:
        from rcbht_jax.io.simulation import recordings_with_faults
        from rcbht_jax.plots import label_map, save
        from sim_mjx.plots.trial_overview import trial_overview
        from sim_mjx.validation.replay import events, simulated

        recordings, (_, tracks, _) = recordings_with_faults(store), drawn_words(store, "", self.rule)
        paths = []
        for name, fault in (("success", "none"), ("failure", "jamming")):
            row = _first(recordings, store, fault, name)
            if row is not None:
                paths.append(self.out / f"{name}.png")
                replay = simulated(store, recordings, row)
                times = events(replay, recordings, row)
                save(trial_overview(replay, recordings, tracks, row, times, SAYS[self.rule]), paths[-1])
        paths.append(self.out / "label-map.png")
        rows = recordings.outcome == "success"
        title = f"simulated trials that succeeded, {SAYS[self.rule]}"
        figure = label_map(recordings, tracks, "llb", select=rows, by="state", title=title)
        save(figure, paths[-1])
        return paths


def _begin(out: Path) -> None:
    """Make the folder of a demo, or take over that of an earlier one, which is recognised by its summary.

    Raises:
        InputError: the folder holds files of the demo's names that no demo made.
    """
    summary = out / "summary.txt"
    if out.is_dir() and any(path.name in WRITTEN for path in out.iterdir()):
        try:
            ours = summary.is_file() and summary.read_bytes().startswith(TITLE.encode())
        except OSError as error:
            raise InputError(f"{summary} cannot be read: {error.strerror}.") from error
        if not ours:
            raise InputError(f"{out} holds files of the same names that no demo made; choose another folder.")
    out.mkdir(parents=True, exist_ok=True)
    with atomic_write(summary) as draft:
        draft.write_text(f"{TITLE}: not complete\n")


def _first(recordings: Recordings, store: Path, fault: str, outcome: str) -> int | None:
    """Row of the first trial with a fault and an outcome."""
    from rcbht_jax.io.store import read_simulation

    rows = np.flatnonzero((read_simulation(store)["fault"] == fault) & (recordings.outcome == outcome))
    return int(rows[0]) if len(rows) else None


def _summary(result: dict[str, Any]) -> str:
    simulated = result["simulated"]
    labels = ", ".join(f"{count:,} {layer}" for layer, count in result["labels"].items())
    lines = [
        f"{TITLE}: {simulated['stored']} simulated trials in {result['seconds']:.0f} s",
        "",
        f"Simulated   {result['seconds_per_trial']:.1f} s a trial on average; all four tabs seated in "
        f"{simulated['seated']} of {simulated['stored']}",
        *(
            f"            {kind:14}{row['seated']:4d} of {row['trials']:3d} seated"
            for kind, row in simulated["faults"].items()
        ),
        f"Labelled    {labels}",
        "",
        *_score("States", result["evaluation"]["states"], "state from the labels within it"),
        *_score("Outcome", result["evaluation"]["outcome"], "success or failure from the labels of the whole trial"),
        "            Durations differ between states and between faults: compare with duration alone.",
        "",
        f"Models      {', '.join(result['models'])}",
        *(f"{'Pictures' if i == 0 else '':12}{path}" for i, path in enumerate(result["pictures"])),
        f"            {_caption(result['words of the pictures'])}",
    ]
    return "\n".join(lines) + "\n"


def _score(title: str, score: dict[str, Any], what: str) -> list[str]:
    rows = (("labels + SVM", "score"), ("duration alone", "duration_baseline"), ("most frequent", "majority_baseline"))
    lines = [f"{title:12}{what}: balanced accuracy on held-out trials"]
    return lines + [f"            {name:16}{score[key]['balanced_accuracy']['mean']:.3f}" for name, key in rows]


def _caption(rule: str) -> str:
    """What the pictures show, and what the classifiers read."""
    read = "" if rule == "paper" else "; the classifiers read those of the published rules"
    return f"They show {SAYS[rule]}{read}."


def _run_recorded(data: Path, out: Path, rule: Literal["fit", "paper"]) -> dict[str, Any]:
    """The chain on the authors' real trials: import, encode, evaluate, plot, summarise.

    Raises:
        InputError: ``data`` is not a folder of their data sets.
    """
    from rcbht_jax.io.hiro.importer import find_trials

    if not data.is_dir():
        raise InputError(f"{data} is not a folder; give the folder of the authors' data sets: --data DIR.")
    find_trials(data)  # a folder without one is reported before the work
    start = time.perf_counter()
    _begin(out)
    store, summary = out / "hiro.zarr", out / "summary.txt"
    announce(1, 4, f"import {data} into {store}")
    imported = ImportHiro(data, store, overwrite=True).run()
    announce(2, 4, "encode every recording with the streaming encoder")
    encoded = Encode(store, window=WINDOW).run()
    announce(3, 4, "evaluate a classifier of the states of the real trials by 5 x 5-fold cross-validation")
    evaluate = Evaluate(store, source=(RECORDED,), repeats=5)
    scores = evaluate.run()
    announce(4, 4, "plot")
    result = {
        "recordings": len(imported["imported"]),
        "left_out": len(imported["skipped"]),
        "labels": encoded["labels"],
        "evaluation": scores,
        "pictures": [str(path) for path in _draw_recorded(out, store, rule)],
        "words of the pictures": rule,
        "summary": str(summary),
        "seconds": time.perf_counter() - start,
    }
    labels = ", ".join(f"{count} {layer}" for layer, count in result["labels"].items())
    lines = [
        f"{TITLE}, {result['seconds']:.0f} s",
        f"{plural(result['recordings'], 'recording')} imported, {result['left_out']} left out",
        f"labels: {labels}",
        "",
        evaluate.text(scores),
        "",
        "pictures:",
        *(f"  {path}" for path in result["pictures"]),
        f"  {_caption(rule)}",
    ]
    with atomic_write(summary) as draft:
        draft.write_text("\n".join(lines) + "\n")
    return result


def _draw_recorded(out: Path, store: Path, rule: Literal["fit", "paper"]) -> list[Path]:
    from rcbht_jax.io.store import read_recordings
    from rcbht_jax.plots import label_map, save, trial_figure

    recordings, (_, tracks, _) = read_recordings(store), drawn_words(store, "", rule)
    paths = []
    for session in ("A", "B"):
        rows = np.flatnonzero(recordings.session == session)
        if rows.size:
            row = int(rows[rows.size // 2])
            paths.append(out / f"trial-{recordings.trial[row]}.png")
            save(trial_figure(recordings, tracks, row, window=WINDOW, rule=rule), paths[-1])
    paths.append(out / "label-map.png")
    select, title = recordings.source == RECORDED, f"{RECORDED}, {SAYS[rule]}"
    save(label_map(recordings, tracks, "llb", select=select, by="state", title=title), paths[-1])
    return paths
