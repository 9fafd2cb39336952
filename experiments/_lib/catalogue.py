"""All experiments: command, duration, requirements, and a shorter form of those that take hours."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

DATA = Path(os.environ.get("RCBHT_DATA", "../shared/data/hiro"))
EXTERNAL = Path(os.environ.get("RCBHT_EXTERNAL", "../shared/data/external"))
GOLDEN = Path(os.environ.get("RCBHT_GOLDEN", "../shared/golden"))
STORE, MODEL, SETS = "{work}/hiro.zarr", "{work}/online.model", "{work}/sets"
# What experiments share, and the command that makes it.
SHARED = {
    STORE: ("rcbht", "import", "hiro", str(DATA), STORE),
    MODEL: ("rcbht", "train-online", STORE, "--source", "REAL_HIRO_ONE_SA_SUCCESS", "-o", MODEL),
}


@dataclass(frozen=True)
class Experiment:
    """A module that writes results, and its cost; minutes are about those of an idle CPU core."""

    name: str  # also that of its result
    module: str  # below experiments
    minutes: float
    options: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()  # "data", "external", "golden", "peers"
    results: tuple[str, ...] = ()  # names of the files; empty = the name
    elsewhere: str = ""  # why it is not run here
    alone: bool = False  # it measures speed, so nothing else may run meanwhile
    shorter: tuple[str, ...] = ()  # options beside the others, of a form that takes less
    shorter_minutes: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        return self.results or (self.name,)


GPU = "needs a GPU"
EXPERIMENTS = (
    Experiment("table1_published", "classification.table1_published", 2, needs=("golden",)),
    Experiment(
        "table1_ours", "classification.table1_ours", 14, (SETS,), ("data",), shorter=("--only", "online"),
        shorter_minutes=7,
    ),
    Experiment(
        "peers", "classification.peers", 14, needs=("data", "peers"), shorter_minutes=8,
        shorter=("--only", "alone", "majority", "words", "SAX", "statistics", "MiniRocket"),  # not MultiRocketHydra
    ),
    Experiment(
        "grammar", "classification.grammar", 8, needs=("data",), shorter_minutes=3,
        shorter=("--only", "SIM1", "A to B", "B to A"),
    ),
    Experiment(
        "frozen_choice", "classification.frozen_choice", 4, needs=("data",), shorter=("--only", "untimed"),
        shorter_minutes=2,
    ),
    Experiment("frozen_stream_choice", "online.frozen_stream_choice", 2, needs=("data",)),
    Experiment(
        "headline", "classification.headline", 5, needs=("data",), shorter=("--only", "REAL states"), shorter_minutes=2
    ),
    Experiment(
        "causal", "online.causal", 9, needs=("data",), shorter=("--only", "A to B", "B to A"), shorter_minutes=4
    ),
    Experiment(
        "failure_calibration", "online.failure_calibration", 6, needs=("data",), shorter=("--only", "/ 256"),
        shorter_minutes=3,
    ),
    Experiment("zero_shot", "classification.zero_shot", 3, (SETS,), ("data",)),
    Experiment(
        "zero_shot_stream", "online.zero_shot_stream", 30, (SETS,), ("data",), shorter=("--only", "alone"),
        shorter_minutes=4,
    ),
    Experiment("fit_quality", "words.fit_quality", 2, needs=("data",)),
    Experiment("external_rest", "words.external_rest", 1, needs=("external",)),
    Experiment("fit_latency", "words.latency", 1, needs=("data",)),
    Experiment(
        "fit_foretold", "words.foretold", 3, needs=("data",), shorter=("--sets", "two-arm"), shorter_minutes=0.8
    ),
    Experiment(
        "fit_classification", "classification.fitted_words", 5, needs=("data",), shorter=("--only", "REAL"),
        shorter_minutes=2,
    ),
    Experiment(
        "fit_tried", "words.tried", 7, needs=("data",), shorter=("--only", "clean"), shorter_minutes=1
    ),
    Experiment(  # before sim_to_real, which finds its sets of two presets here
        "fit_sim_to_real", "classification.sim_to_real_fit", 5, (SETS,), ("data",), shorter=("--only", "paper"),
        shorter_minutes=3,
    ),
    Experiment(
        "simulated_draws", "classification.simulated_draws", 35, (SETS,), ("data",), shorter_minutes=4,
        shorter=("--only", "draw 0"),
    ),
    Experiment(
        "snaps", "words.snaps", 15, needs=("data",), shorter=("--trials", "20"), shorter_minutes=1.5
    ),
    Experiment("rate_distortion", "words.rate_distortion", 6, needs=("data", "external", "peers")),
    Experiment("probes", "classification.probes", 3, needs=("data",)),
    Experiment("curves", "classification.curves", 2, needs=("data",)),
    Experiment("table2", "online.table2", 36, needs=("data",), shorter=("--repeats", "10"), shorter_minutes=9),
    Experiment("confidence", "online.confidence", 2, needs=("data",)),
    Experiment("abnormal_real", "online.abnormal_real", 3, needs=("data",)),
    Experiment(
        "failure_types_online", "online.failure_types", 10, needs=("data",), shorter=("--only", "/ 256"),
        shorter_minutes=3,
    ),
    Experiment(
        "detected_starts", "online.detected_starts", 18, needs=("data",), shorter=("--only", "paper"), shorter_minutes=2
    ),
    Experiment("online_agreement", "online.agreement", 1, needs=("data", "golden")),
    Experiment("kitting", "external.kitting", 5, needs=("external",)),
    Experiment("external_choice", "external.choice", 5, needs=("data",)),
    Experiment("kitting_more", "external.kitting_more", 2, needs=("external",)),
    Experiment(
        "external_early", "external.early", 18, needs=("external", "peers"), shorter_minutes=3,
        shorter=("--repeats", "1", "--only", "lp1"),
    ),
    Experiment(
        "external_failures", "external.failures", 11, needs=("external", "peers"), shorter=("--repeats", "1"),
        shorter_minutes=2,
    ),
    Experiment(
        "external_caps", "external.caps", 9, needs=("external", "peers"), shorter=("--only", "without words", "trees"),
        shorter_minutes=4,
    ),
    Experiment("two_arm", "classification.two_arm", 2, needs=("data",)),
    Experiment("two_arm_states", "classification.two_arm_states", 2, needs=("data",)),
    Experiment(
        "fidelity_gate", "simulation.fidelity_gate", 3, needs=("data",), shorter=("--session", "hooked-B"),
        shorter_minutes=1.5,
    ),
    Experiment("separability", "simulation.separability", 1.5, needs=("data",)),
    Experiment("sim_success", "simulation.success", 14, needs=("data",)),
    Experiment("recovery", "online.recovery", 6, shorter=("--faulty", "6", "--in-place", "2"), shorter_minutes=2),
    Experiment(
        "retry", "online.retry", 10, shorter=("--trials", "4", "--repeats", "1", "--attempts", "2"), shorter_minutes=2
    ),
    Experiment(
        "learn_setpoints", "simulation.learn_setpoints", 40, shorter_minutes=2.5,
        shorter=("--generations", "1", "--trials", "6", "--tests", "4"),
    ),
    Experiment(
        "engines", "simulation.engines", 15, alone=True, shorter_minutes=4,
        shorter=("--parity", "8", "--speed", "64", "--longest", "9"),
    ),
    Experiment("parity_floor", "simulation.parity_floor", 1),
    Experiment("hook_bench", "simulation.hook_bench", 1),
    Experiment("snap_needs", "simulation.snap_needs", 1, shorter=("--trials", "2"), shorter_minutes=0.3),
    Experiment(
        "snap_creep", "simulation.snap_creep", 9, needs=("data",), shorter_minutes=1.5,
        shorter=("--trials", "1", "--seeds", "1", "--only", "the preset"),
    ),
    Experiment("joint_fit", "simulation.joint_fit", 20, ("--engine", "warp"), ("data",), elsewhere=GPU),
    Experiment("driven_fit", "simulation.driven_fit", 25, ("--engine", "warp"), ("data",), elsewhere=GPU),
    Experiment("driven_starts", "simulation.driven_starts", 10, ("--engine", "warp"), ("data",), elsewhere=GPU),
    Experiment("derivatives", "simulation.derivatives", 8, shorter=("--seconds", "4"), shorter_minutes=4),
    Experiment(
        "kill_resume", "simulation.kill_resume", 6, alone=True, shorter=("--trials", "1000", "--kills", "4"),
        shorter_minutes=2,
    ),
    Experiment(
        "large_store", "simulation.large_store", 12, ("{work}",), alone=True, shorter_minutes=0.5,
        shorter=("--sizes", "10000", "--worked", "1000"),
    ),
    Experiment("stream_speed", "online.stream_speed", 1, (MODEL,), ("data",), alone=True),
    Experiment(
        "endurance", "online.endurance", 60, alone=True, shorter_minutes=1.5,
        shorter=("--hours", "0.1", "--messages", "5000", "--page-hours", "0.1"),
    ),
    Experiment(
        "sim_to_real", "classification.sim_to_real", 60, (SETS,), ("data",), shorter=("--only", "main"),
        shorter_minutes=3,
    ),
    Experiment(
        "faults_online", "online.faults", 80, ("--folder", "{work}/faults", "--seed", "2"), shorter_minutes=9,
        shorter=("--preset", "hooked-C", "--repeats", "1", "--per-kind", "10"),
    ),
    Experiment(
        "faults_across", "online.faults_across", 100,
        ("--folder", "{work}/across", "--nominal", "300", "400", "200", "--repeats", "1", "--seed", "2"),
        shorter_minutes=25, shorter=("--preset", "hooked-C", "hooked-A", "--per-kind", "10"),
    ),
    Experiment("faults_outcome", "online.faults_outcome", 0.1),
    Experiment(
        "will_it_seat", "online.will_it_seat", 40, ("--folder", "{work}/seat"), shorter_minutes=2,
        shorter=("--per-kind", "5", "--repeats", "1", "--only", "trials"),
    ),
    Experiment(
        "types_across", "classification.types_across", 8, ("--folder", "{work}/types"), ("data",), shorter_minutes=0.5,
        shorter=("--only", "records"),
    ),
    Experiment(
        "calibration", "calibration.methods", 180, (STORE,), ("data",), shorter_minutes=4,
        shorter=("--tasks", "sim1-to-real", "--candidates", "128", "--repeats", "1"),
    ),
    Experiment(
        "calibration_curves", "calibration.curves", 120, (STORE,), ("data",), shorter_minutes=4,
        shorter=("--methods", "random", "halving"),
    ),
    Experiment("calibration_near", "calibration.near_preset", 6, (STORE, SETS), ("data",)),
    Experiment("calibration_bank", "calibration.bank", 8, (STORE,), ("data",)),
    Experiment(
        "fit_calibration", "calibration.fit_rule", 5, needs=("data",), shorter=("--only", "default", "rest"),
        shorter_minutes=2,
    ),
    Experiment("calibration_transfer", "calibration.transfer", 1, (STORE,), ("data",)),
    Experiment(
        "calibration_speed", "calibration.speed", 3, (STORE,), ("data",), ("calibration_speed_cpu",), alone=True
    ),
    Experiment(
        "calibration_device", "calibration.on_device", 10, ("--engine", "warp"), (),
        ("calibration_device_warp_failure_type_hooked_b", "calibration_device_warp_failure_type_openhrp"), GPU,
    ),
    Experiment(
        "environment_speed", "simulation.environment_speed", 4, ("--engine", "mjx", "warp"), elsewhere=GPU
    ),
    Experiment("encoder_speed", "words.encoder_speed", 3, elsewhere=GPU),
    Experiment("repeatability", "simulation.repeatability", 2, elsewhere=GPU),
    Experiment("step_profile", "simulation.step_profile", 2, ("--engine", "warp"), elsewhere=GPU),
    Experiment("step_profile_fused", "simulation.step_profile", 2, ("--engine", "fused"), elsewhere=GPU),
    Experiment("engines_gpu", "simulation.engines_gpu", 10, ("--engine", "warp"), elsewhere=GPU),
    Experiment(
        "learn_setpoints_gpu", "simulation.learn_setpoints", 18,
        ("--engine", "warp", "--population", "128", "--trials", "32", "--generations", "15", "--tests", "256"),
        elsewhere=GPU,
    ),
    Experiment("simulate_gpu", "simulation.simulate_gpu", 8, ("{work}",), elsewhere=GPU),
    Experiment("native_cores", "simulation.native_cores", 7, elsewhere="needs many cores"),
    Experiment("scaling", "simulation.scaling", 8, ("{work}",), elsewhere="needs several GPUs"),
)  # fmt: skip
