"""``rcbht calibrate``."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from tqdm import tqdm  # type: ignore[import-untyped]

from rcbht_jax._util.digest import data_hash
from rcbht_jax.calibration import contextual
from rcbht_jax.calibration.dataset import CalibrationData, calibration_data
from rcbht_jax.calibration.gradient import GradientOptions
from rcbht_jax.calibration.gradient import calibrate as train
from rcbht_jax.calibration.objective import SCORES, Objective
from rcbht_jax.calibration.search import SearchOptions, SearchSpace, score_candidates, search
from rcbht_jax.cli.command import Command
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import LIMITS, GradientThresholds, preset, write_thresholds
from rcbht_jax.errors import InputError
from rcbht_jax.io.store import read_recordings
from rcbht_jax.labels import AXES
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from rcbht_jax.plots import save
from rcbht_jax.plots.thresholds import threshold_figure
from rcbht_jax.types import Recordings

_GROUPS = {"axis": (0, 1, 2, 3, 4, 5), "kind": (0, 0, 0, 1, 1, 1), "all": (0,) * 6}


@dataclass(frozen=True)
class Calibrate(Command):
    """Find gradient thresholds on some trials of a store and write them to a file.

    Context is the authors' rule: the impulse limit from the insertion, the constant limit from the rotation.
    Search tries thousands of thresholds and keeps those whose labels tell the classes apart best. Gradient trains
    thresholds and a linear classifier together. Give it training trials only: scores on the trials that chose
    the thresholds are too good.

    Example: rcbht calibrate hiro.zarr --method search --session B -o thresholds.json
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store with the trials."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT.json")]
    """File of thresholds to write; an existing one is replaced."""
    method: Literal["context", "search", "gradient"] = "search"
    """How to find them."""
    task: Literal["states", "outcome", "failure-type"] = "states"
    """What the labels shall tell apart."""
    boundaries: Literal["recorded", "harmonised", "merged"] = "harmonised"
    """States: where rotation ends; merged joins rotation and insertion."""
    arm: Literal["R", "L"] = "R"
    """Arm to calibrate on."""
    source: tuple[str, ...] = ()
    """Data sets; default all."""
    session: tuple[str, ...] = ()
    """Recording sessions; default all."""
    window: int = 5
    """Samples per straight-line fit."""
    robot: Literal["hiro", "baxter", "pa10"] = "hiro"
    """Whose preset to start from."""
    own_axes: bool = False
    """Context: every axis keeps its own limits, instead of copying them as the authors do."""
    groups: Literal["axis", "kind", "all"] = "kind"
    """Search: thresholds per axis, one set for forces and one for moments, or one for all."""
    candidates: int = 1024
    """Search: thresholds to try first, a power of two."""
    generations: int = 20
    """Search: rounds of CMA-ES around the best."""
    rungs: tuple[float, ...] = (1.0,)
    """Search: shares of the trials for successive halving, for example 0.25 1."""
    objective: tuple[Literal["accuracy", "fit", "fisher", "information", "agreement"], ...] = ("accuracy", "fit")
    """Search: scores that count, with equal weights."""
    ledger: Path | None = None
    """Search: file that keeps the scores, so that an interrupted search goes on from there."""
    steps: int = 150
    """Gradient: steps of the training."""
    loss: Literal["logistic", "hinge", "fit"] = "logistic"
    """Gradient: loss of the classifier."""
    straight_through: bool = False
    """Gradient: hard labels forward."""
    plot: Path | None = None
    """Figure to write: the thresholds over the gradients of each axis and state."""
    seed: int = 0
    """Of the random numbers."""

    def run(self) -> dict[str, Any]:
        if not self.out.parent.is_dir():
            raise InputError(f"{self.out.parent} is not a folder; make it, or choose another file.")
        recordings = read_recordings(self.store)
        spec = TaskSpec(self.task, self.boundaries, self.arm, self.source, self.session)
        config = EncoderConfig(self.window, recordings.dt)
        data = calibration_data(recordings, labelled_intervals(recordings, spec), config)
        start = time.perf_counter()
        thresholds, found = getattr(self, f"_{self.method}")(recordings, data, config)
        seconds = time.perf_counter() - start
        base = np.asarray(preset(self.robot).limits)
        weights = Objective.of(dict.fromkeys(self.objective, 1.0)).weights()
        both = score_candidates(data, config, np.stack([base, np.asarray(thresholds.limits)]))
        result = {
            "method": self.method,
            "trials": len(data),
            "classes": list(data.classes),
            "value": float(both[1] @ weights),
            "preset_value": float(both[0] @ weights),
            "scores": dict(zip(SCORES, both[1].tolist(), strict=True)),
            "preset_scores": dict(zip(SCORES, both[0].tolist(), strict=True)),
            **found,
        }
        provenance = {
            **result,
            "task": asdict(spec),
            "config": asdict(config),
            "robot": self.robot,
            "seed": self.seed,
            "data_hash": data_hash(recordings),
            "trial_names": data.trial.tolist(),
        }
        write_thresholds(self.out, thresholds, provenance)
        if self.plot is not None:
            save(threshold_figure(data, thresholds, preset(self.robot)), self.plot)
        limits = np.asarray(thresholds.limits).tolist()
        return {"thresholds": str(self.out), "limits": limits, "seconds": seconds, **result}

    def text(self, result: dict[str, Any]) -> str:
        lines = [
            f"{result['thresholds']}: {result['method']} on {result['trials']} trials in {result['seconds']:.1f} s; "
            f"objective {result['value']:.3f}, with the preset {result['preset_value']:.3f}"
        ]
        lines.append("      " + "".join(f"{name:>10}" for name in LIMITS))
        lines += [
            f"{axis:6}" + "".join(f"{limit:10.3f}" for limit in row)
            for axis, row in zip(AXES, result["limits"], strict=True)
        ]
        return "\n".join([*lines, "These trials chose the thresholds: measure on others."])

    def _context(
        self, recordings: Recordings, data: CalibrationData, config: EncoderConfig
    ) -> tuple[GradientThresholds, dict[str, Any]]:
        rows = np.flatnonzero(np.isin(recordings.trial, data.trial) & (recordings.arm == self.arm))
        copy = contextual.OWN if self.own_axes else contextual.AUTHORS_COPY
        found = contextual.calibrate(recordings, rows, config, self.robot, copy)
        return found.thresholds, {"trials_per_limit": found.trials.tolist(), "own_axes": self.own_axes}

    def _search(
        self, recordings: Recordings, data: CalibrationData, config: EncoderConfig
    ) -> tuple[GradientThresholds, dict[str, Any]]:
        options = SearchOptions(
            space=SearchSpace(np.asarray(preset(self.robot).limits, np.float64), _GROUPS[self.groups]),
            objective=Objective.of(dict.fromkeys(self.objective, 1.0)),
            candidates=self.candidates,
            rungs=self.rungs,
            generations=self.generations,
            seed=self.seed,
        )
        with tqdm(desc="search", unit=" candidates", file=sys.stderr, disable=None) as bar:
            found = search(data, config, options, ledger=self.ledger, progress=lambda n: bar.update(n))
        plain = {key: value for key, value in asdict(options).items() if key != "space"}
        return found.thresholds, {"evaluations": found.evaluations, "groups": self.groups, "options": plain}

    def _gradient(
        self, recordings: Recordings, data: CalibrationData, config: EncoderConfig
    ) -> tuple[GradientThresholds, dict[str, Any]]:
        options = GradientOptions(
            steps=self.steps, loss=self.loss, straight_through=self.straight_through, seed=self.seed
        )
        with tqdm(total=self.steps, desc="train", unit=" steps", file=sys.stderr, disable=None) as bar:
            trained = train(data, config, preset(self.robot), options, progress=lambda n: bar.update(n))
        losses = [trained.history[0][1], trained.history[-1][1]]
        return trained.thresholds, {"loss_first_last": losses, "options": asdict(options)}
