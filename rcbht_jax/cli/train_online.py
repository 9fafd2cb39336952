"""``rcbht train-online``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tqdm import tqdm  # type: ignore[import-untyped]

from rcbht_jax.cli.command import Command
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.introspection.model import save
from rcbht_jax.introspection.training import HeadSpec, train_model
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning.tasks import CONFOUNDS, TaskSpec


@dataclass(frozen=True)
class TrainOnline(Command):
    """Train the beliefs of a stream: one head per task, calibrated on trials that its machine did not see.

    Example: rcbht train-online hiro.zarr --source REAL_HIRO_ONE_SA_SUCCESS -o states.model
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store of recordings; no label tracks are needed."""
    tasks: tuple[Literal["states", "outcome", "failure-type"], ...] = ("states",)
    """Heads to train."""
    detect: bool = False
    """Also learn when a sub-task begins, for streams in which nobody says so."""
    false_alarms: float = 0.0
    """Set the outcome's alarm so that nominal trials raise it at most so often, such as 0.02; 0 = above k."""
    source: tuple[str, ...] = ()
    """Data sets; default all."""
    session: tuple[str, ...] = ()
    """Recording sessions; default all."""
    features: Literal["all", "relative"] = "all"
    """relative leaves out what absolute values give away, such as the bias of the sensor."""
    window: int = 5
    """Samples per straight-line fit."""
    robot: Literal["hiro", "baxter", "pa10"] = "hiro"
    """Whose gradient thresholds to use."""
    seed: int = 0
    """Of the folds."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="MODEL")] = Path("online.model")
    """Model file to write: arrays and JSON, no code."""

    def run(self) -> dict[str, Any]:
        recordings = read_recordings(self.store)
        tasks = [(task, False) for task in self.tasks] + [("states", True)] * self.detect
        specs = tuple(
            HeadSpec(
                TaskSpec(task, sources=self.source, sessions=self.session),
                relative=self.features == "relative",
                phase=phase,
                false_alarms=self.false_alarms,
            )
            for task, phase in tasks
        )
        config = EncoderConfig(window=self.window, dt=recordings.dt)
        with tqdm(desc="watch", unit=" looks", file=sys.stderr, disable=None) as bar:

            def progress(done: int, total: int) -> None:
                bar.total = total
                bar.update(done)

            model = train_model(recordings, specs, config, preset(self.robot), self.seed, progress)
        save(self.out, model)
        heads = {
            head.name: {
                "classes": list(head.classes),
                "kernel": head.machine.svm.spec.kernel,
                "cost": head.machine.svm.spec.cost,
                "features": int(head.machine.svm.center.size),
                "confounds": CONFOUNDS[spec.task.task],
            }
            for spec, head in zip(specs, model.heads, strict=True)
        }
        return {"model": str(self.out), "heads": heads, "data_hash": model.data_hash}

    def text(self, result: dict[str, Any]) -> str:
        lines = [f"{result['model']}: {len(result['heads'])} head(s)"]
        for name, head in result["heads"].items():
            classes = ", ".join(head["classes"])
            how = f"{head['kernel']} kernel, C = {head['cost']:g}, {head['features']} features"
            lines.append(f"{name}: {classes}; {how}")
            lines.append(f"  read with care: {head['confounds']}")
        return "\n".join(lines)
