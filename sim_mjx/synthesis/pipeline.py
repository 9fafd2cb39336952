"""Simulate trials into a store: in shards, resumable, with the same bytes however often it was interrupted.

Each shard is simulated and saved in a work folder beside the target (``sim_mjx.synthesis.shards``); when all are there
they are joined into one store. A trial depends on seed and index alone, so the shard size decides only how much an
interruption costs. The store holds no date. Its group ``simulation/`` has one row per recording: index, fault,
failed_in, seated [4], noise_key [2] and the drawn parameters (``Scenario.parameters``). A two-arm trial is two
recordings, right arm and left arm, as the importer stores them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.atomic import flush_tree
from rcbht_jax._util.digest import files_hash
from rcbht_jax.encoding import thresholds
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.label_store import write_tracks
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines.common import blocks
from sim_mjx.randomization.trials import DomainRandomization, Fault
from sim_mjx.registry import Scenario, get_scenario, own_files
from sim_mjx.synthesis import records, shards, tables

Simulate = Callable[[Any], Rollouts]  # a batch of trials of the scenario
Labelled = tuple[Rollouts, LabelTracks | None]
Drawn = tuple[Any, list[Fault]]  # parameters of a shard's trials, and their faults
# Default trials per shard: what an interruption costs at most. A GPU needs many to be busy.
SHARD = {"native": 256, "mjx": 8192, "warp": 16384}
ROBOT = "hiro"  # its threshold preset labels the trials
MOST = 10**9  # trials: more would fill any disk
CREATED = "undated"  # a date would make every store different


@dataclass(frozen=True)
class SynthesisConfig:
    """What to simulate."""

    preset: str  # see ``sim_mjx.registry``
    trials: int
    seed: int = 0
    engine: str = "native"
    shard: int = 256  # trials per shard
    spec: Any = field(default_factory=DomainRandomization)  # or the assembly's own distributions
    window: int | None = None  # samples per window of the labels; None = no labels


@dataclass(frozen=True)
class SynthesisProgress:
    """Progress of a synthesis."""

    done: int  # trials, those of earlier runs included
    total: int  # trials
    per_minute: float  # trials simulated per minute in this run, 0 before the first shard
    seconds_left: float | None  # None before the first shard


@dataclass(frozen=True)
class SynthesisReport:
    """Outcome of a synthesis."""

    stored: int  # trials
    seated: int  # stored trials with all four tabs seated
    diverged: list[int]  # indices of trials that are not stored
    resumed: int  # trials simulated by an earlier run
    faults: dict[str, tuple[int, int]]  # kind -> stored and seated trials


def synthesise(
    target: Path,
    job: SynthesisConfig,
    *,
    overwrite: bool = False,
    simulate: Simulate | None = None,
    progress: Callable[[SynthesisProgress], None] | None = None,
) -> SynthesisReport:
    """Simulate a set of trials into a store; an interrupted run resumes from its finished shards.

    Args:
        target: store to create, for example trials.zarr; the work folder is trials.zarr.work beside it.
        job: what to simulate.
        overwrite: replace an existing store, once the new one is complete.
        simulate: what simulates a batch; default ``job.engine``. A trial's result must not depend on its batch.
        progress: called at the start and after each shard.

    Raises:
        InputError: impossible options, the target exists, the work folder belongs to other options, or all trials
            diverged.
    """
    scenario = check(job)
    folder = shards.folder_of(target)
    manifest = _manifest(job)
    finished = folder.is_dir() and _is_result(target, manifest)
    store.check_target(target, overwrite or finished)
    with shards.working(folder, manifest):
        resumed = job.trials
        if not finished:
            drawn = _simulate_missing(folder, job, scenario, _labelled(job, scenario, simulate), progress)
            resumed -= sum(len(faults) for _, faults in drawn.values())
            draft = _assemble(folder, job, scenario, manifest, drawn)
            store.check_target(target, overwrite)  # again: something may have appeared there meanwhile
            if target.exists():
                target.rename(folder / f"replaced-{time.time_ns()}.zarr")
            draft.rename(target)
            flush_tree(target)  # before the shards are deleted
        shards.remove(folder)
    return _report(target, len(scenario.arms), resumed)


def check(job: SynthesisConfig) -> Scenario:
    """The scenario of a job that can be simulated.

    Raises:
        InputError: unknown preset or engine, a count below one, a bad seed or distribution.
    """
    for name, value in (("number of trials", job.trials), ("shard's number of trials", job.shard)):
        if value < 1:
            raise InputError(f"The {name} is {value}; expected 1 or more.")
    if job.trials > MOST:
        raise InputError(f"The number of trials is {job.trials}; expected at most {MOST}.")
    engines.check(job.engine)
    if job.window is not None:
        _encoder(job)
    scenario = get_scenario(job.preset)
    scenario.draw(job.seed, 0, job.spec)
    return scenario


def _encoder(job: SynthesisConfig) -> EncoderConfig:
    return EncoderConfig(window=job.window or 0, dt=CONTROL_PERIOD)


def _manifest(job: SynthesisConfig) -> dict[str, Any]:
    """Everything that determines a shard, as JSON values."""
    versions = {"rcbht_jax": rcbht_jax.__version__, "jax": jax.__version__, "mujoco": mujoco.__version__}
    made = {"job": asdict(job), "versions": {**versions, "numpy": np.__version__, "sim_mjx_sha256": code_hash()}}
    if own := own_files(job.preset):
        made["versions"]["own_sha256"] = [files_hash(path.absolute().parent, [path.absolute()]) for path in own]
    if job.window is not None:  # what else the labels depend on
        made["versions"]["encoding_sha256"] = encoding_hash()
        made["thresholds"] = _limits().tolist()
    return made


@cache  # the code that runs is the one read at the start, whatever is edited later
def code_hash() -> str:
    """Digest of the simulation's sources: shards made by different code must not be mixed."""
    root = Path(__file__).parents[2]
    return files_hash(root, sorted([*(root / "sim_mjx").rglob("*.py"), *(root / "rcbht_jax/robots").glob("*.py")]))


@cache
def encoding_hash() -> str:
    """Digest of the sources that label trials."""
    root = Path(rcbht_jax.__file__).parent
    return files_hash(root, sorted([*(root / "encoding").glob("*.py"), root / "labels.py", root / "types.py"]))


def _provenance(manifest: dict[str, Any]) -> dict[str, Any]:
    """The part of the manifest that determines the store: all but the shard size."""
    job = {name: value for name, value in manifest["job"].items() if name != "shard"}
    return {"job": job, "versions": manifest["versions"]}


def _is_result(target: Path, manifest: dict[str, Any]) -> bool:
    """Whether the target is complete, made by a run with these options that was killed before it deleted its folder."""
    if not target.exists():
        return False
    try:
        provenance = store.read_attrs(target).get("simulated")
        store.read_recordings(target)  # a damaged one is no result: its shards are still there
        store.read_simulation(target)
    except InputError:
        return False
    return provenance is not None and shards.as_json(provenance) == shards.as_json(_provenance(manifest))


def _indices(job: SynthesisConfig, shard: int) -> range:
    return range(shard * job.shard, min((shard + 1) * job.shard, job.trials))


def _simulate_missing(
    folder: Path,
    job: SynthesisConfig,
    scenario: Scenario,
    simulate: Callable[[Any], Labelled],
    progress: Callable[[SynthesisProgress], None] | None,
) -> dict[int, Drawn]:
    """Simulate and save the missing shards; returns what was drawn for each, by number."""
    count = -(-job.trials // job.shard)
    missing = [shard for shard in range(count) if shards.load(folder, shard) is None]
    left = sum(len(_indices(job, shard)) for shard in missing)
    resumed = done = job.trials - left
    drawn: dict[int, Drawn] = {}
    start = time.perf_counter()
    if progress is not None:
        progress(SynthesisProgress(done, job.trials, 0.0, None))
    for shard in missing:
        indices = _indices(job, shard)
        drawn[shard] = scenario.draw_batch(job.seed, indices, job.spec)
        out, tracks = simulate(drawn[shard][0])
        labels = {} if tracks is None else records.of_labels(tracks, len(out.length))
        shards.save(folder, shard, records.of_trials(out, scenario.recorded) | labels)
        done += len(indices)
        if progress is not None:
            rate = (done - resumed) / (time.perf_counter() - start)
            progress(SynthesisProgress(done, job.trials, 60.0 * rate, (job.trials - done) / rate))
    return drawn


def _labelled(job: SynthesisConfig, scenario: Scenario, simulate: Simulate | None) -> Callable[[Any], Labelled]:
    """What simulates a batch and, if the job has a window, labels it."""
    if simulate is None and job.window is not None:
        return partial(
            records.simulate_labelled, scenario.scene(), engine=job.engine, config=_encoder(job), limits=_limits()
        )
    run = simulate or partial(engines.simulate, scenario.scene(), engine=job.engine)

    def labelled(params: Any) -> Labelled:
        out = run(params)
        return out, None if job.window is None else records.label(out, _encoder(job), _limits())

    return labelled


def _limits() -> NDArray[np.float64]:
    """Thresholds that label the trials [6, 4]."""
    return np.asarray(thresholds.preset(ROBOT).limits)


def _assemble(
    folder: Path,
    job: SynthesisConfig,
    scenario: Scenario,
    manifest: dict[str, Any],
    drawn: dict[int, Drawn],
) -> Path:
    """Join the shards into a store in the work folder; ``drawn`` holds the trials of this run's shards."""
    loaded = [shards.load(folder, shard) for shard in range(-(-job.trials // job.shard))]
    parts = [part for part in loaded if part is not None]
    if len(parts) < len(loaded):
        raise InputError(f"A shard in {folder} was damaged just now; run the same command again.")
    diverged = np.concatenate([part["diverged"] for part in parts])
    stored = np.flatnonzero(~diverged)
    if len(stored) == 0:
        raise InputError(f"The physics diverged in all {job.trials} trials; nothing to store. Check the distributions.")
    batches = [
        drawn.get(shard) or scenario.draw_batch(job.seed, _indices(job, shard), job.spec) for shard in range(len(parts))
    ]
    params = jax.tree.map(lambda *leaves: np.concatenate(leaves)[stored], *(params for params, _ in batches))
    all_faults = [fault for _, faults in batches for fault in faults]
    faults = [all_faults[index] for index in stored]
    plain = [name for name in parts[0] if name != "wrench" and "." not in name]
    rows = {name: np.concatenate([part[name] for part in parts])[stored] for name in plain}
    recordings = tables.recordings_of(
        job.preset, scenario, rows, _wrench(parts, stored, rows["length"]), stored, faults
    )
    attrs = {
        "frames": tables.frames_of(scenario),
        "simulated": _provenance(manifest),
        "diverged": np.flatnonzero(diverged).tolist(),
    }
    if not scenario.recorded:
        attrs["importer"] = "simulation"  # so that thresholds come from the recordings, not from HIRO's preset
    draft = folder / "store.zarr"
    store.write_recordings(
        draft, recordings, attrs, overwrite=True, created=CREATED,
        simulation=tables.simulation_of(scenario, rows, stored, params, faults),
    )  # fmt: skip
    if job.window is not None:
        _write_labels(draft, job, parts, stored)
    return draft


def _write_labels(draft: Path, job: SynthesisConfig, parts: list[shards.Arrays], stored: NDArray[np.int64]) -> None:
    """Add the labels to the store, under the name and with the attributes of ``rcbht encode``."""

    def joined(name: str) -> NDArray[Any]:
        shapes = [part[name].shape for part in parts]
        out = np.zeros((len(stored), *shapes[0][1:-1], max(shape[-1] for shape in shapes)), parts[0][name].dtype)
        row = 0
        for rows, part in _stored_of(parts, stored):
            out[row : row + len(rows), ..., : part[name].shape[-1]] = part[name][rows]
            row += len(rows)
        return out.reshape(-1, 6, out.shape[-1])

    layers = {
        layer: LabelTrack(**{name: joined(f"{layer}.{name}") for name in records.LABEL_FIELDS}) for layer in LAYERS
    }
    config = _encoder(job)
    attrs = {"semantics": "online", "window": config.window, "config": asdict(config), "thresholds": _limits().tolist()}
    write_tracks(draft, f"online-W{config.window}", LabelTracks(*layers.values()), attrs, created=CREATED)


def _report(target: Path, arms: int, resumed: int) -> SynthesisReport:
    """What the finished store holds."""
    simulation = {name: rows[::arms] for name, rows in store.read_simulation(target).items()}
    seated, kinds = np.asarray(simulation["seated"].all(1)), simulation["fault"]
    faults = {str(k): (int((kinds == k).sum()), int(seated[kinds == k].sum())) for k in np.unique(kinds)}
    return SynthesisReport(len(seated), int(seated.sum()), store.read_attrs(target)["diverged"], resumed, faults)


def _wrench(parts: list[shards.Arrays], stored: NDArray[np.int64], length: NDArray[np.int32]) -> NDArray[np.float32]:
    """All stored trials [trial, time, 6K], padded to the longest of them."""
    out = np.zeros((len(stored), int(length.max()), parts[0]["wrench"].shape[2]), np.float32)
    row = 0
    for rows, part in _stored_of(parts, stored):
        samples = min(out.shape[1], part["wrench"].shape[1])
        for block in blocks(len(rows)):
            out[row + block.start : row + block.stop, :samples] = part["wrench"][rows[block], :samples]
        row += len(rows)
    return out


def _stored_of(
    parts: list[shards.Arrays], stored: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], shards.Arrays]]:
    """Each shard with the rows of its trials that are stored."""
    start = 0
    for part in parts:
        stop = start + len(part["diverged"])
        yield stored[(stored >= start) & (stored < stop)] - start, part
        start = stop
