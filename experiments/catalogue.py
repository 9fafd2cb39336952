"""Every experiment: what makes it, what it takes, and a shorter form of those that take hours."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

DATA = Path(os.environ.get("RCBHT_DATA", "../shared/data/hiro"))
GOLDEN = Path(os.environ.get("RCBHT_GOLDEN", "../shared/golden"))
STORE, MODEL, SETS = "{work}/hiro.zarr", "{work}/online.model", "{work}/sets"
# What experiments share, and the command that makes it.
SHARED = {
    STORE: ("rcbht", "import", "hiro", str(DATA), STORE),
    MODEL: ("rcbht", "train-online", STORE, "--source", "REAL_HIRO_ONE_SA_SUCCESS", "-o", MODEL),
}


@dataclass(frozen=True)
class Experiment:
    """A module that writes results, and what it takes; minutes are about those of an idle CPU core."""

    module: str
    minutes: float
    options: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()  # "data", "golden", "peers"
    results: tuple[str, ...] = ()  # names of the files; empty = that of the module
    elsewhere: str = ""  # why it is not run here
    alone: bool = False  # it measures speed, so nothing else may run meanwhile
    shorter: tuple[str, ...] = ()  # options beside the others, of a form that takes less
    shorter_minutes: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        return self.results or (self.module,)


GPU = "needs a GPU"
EXPERIMENTS = (
    Experiment("table1_published", 2, needs=("golden",)),
    Experiment("table1_ours", 14, (SETS,), ("data",)),
    Experiment("peers", 14, needs=("data", "peers")),
    Experiment("grammar", 8, needs=("data",)),
    Experiment("probes", 3, needs=("data",)),
    Experiment("curves", 2, needs=("data",)),
    Experiment("table2", 36, needs=("data",)),
    Experiment("confidence", 2, needs=("data",)),
    Experiment("abnormal_real", 3, needs=("data",)),
    Experiment("failure_types_online", 10, needs=("data",)),
    Experiment("detected_starts", 2, needs=("data",)),
    Experiment("online_agreement", 1, needs=("data", "golden")),
    Experiment("two_arm", 2, needs=("data",)),
    Experiment("two_arm_states", 2, needs=("data",)),
    Experiment("sim_sessions", 1, needs=("golden",)),
    Experiment("sim_success", 14, needs=("data",)),
    Experiment("recovery", 2, ("--trials", "16")),
    Experiment("engines", 8, alone=True),
    Experiment("parity_floor", 1),
    Experiment("kill_resume", 3, alone=True),
    Experiment("bench", 1, alone=True),
    Experiment(
        "stream_speed", 30, (MODEL,), ("data",), alone=True, shorter_minutes=3,
        shorter=("--samples", "1000000", "--messages", "200000", "--requests", "2000"),
    ),
    Experiment("sim_to_real", 60, (SETS,), ("data",), shorter=("--only", "main"), shorter_minutes=5),
    Experiment(
        "faults_online", 35, ("--folder", "{work}/faults", "--preset", "B", "C", "A", "--seed", "2"), shorter_minutes=6,
        shorter=("--preset", "C", "--repeats", "2", "--nominal", "300", "300", "--per-kind", "40"),
    ),
    Experiment(
        "faults_across", 45, ("--folder", "{work}/across", "--preset", "B", "C", "A", "--repeats", "1", "--seed", "2"),
        shorter_minutes=25, shorter=("--nominal", "300", "300", "--per-kind", "40"),
    ),
    Experiment(
        "calibration", 180, (STORE,), ("data",), shorter_minutes=4,
        shorter=("--tasks", "sim1-to-real", "--candidates", "128", "--repeats", "1"),
    ),
    Experiment(
        "calibration_curves", 120, (STORE,), ("data",), shorter_minutes=4,
        shorter=("--methods", "random", "halving"),
    ),
    Experiment("calibration_near", 6, (STORE, "--simulated", SETS), ("data",)),
    Experiment("calibration_bank", 8, (STORE,), ("data",)),
    Experiment("calibration_transfer", 1, (STORE,), ("data",)),
    Experiment("calibration_speed", 3, (STORE,), ("data",), ("calibration_speed_cpu",), alone=True),
    Experiment(
        "calibration_device", 10, ("--engine", "warp"), (), ("calibration_device_warp_failure_type",), GPU
    ),
    Experiment("engines_gpu", 10, ("--engine", "warp", "--out", "{work}/engines_gpu.json"), elsewhere=GPU),
)  # fmt: skip
