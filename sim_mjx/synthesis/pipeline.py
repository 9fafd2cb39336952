"""Trials by the thousand into a store: sharded, resumable, and the same bytes however often it was interrupted.

Each shard of trials is simulated and kept in a work folder beside the target (``sim_mjx.synthesis.shards``); when all are
there they become one store. A trial depends on seed and index alone, so that shards only decide how much a kill
can cost. The store holds no date, and its group ``simulation/`` what only a simulation knows, one row per recording:
index, fault, failed_in, seated [4], noise_key [2] and the drawn parameters (``kinds``). A two-arm trial is two
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
from rcbht_jax._util.digest import files_hash
from rcbht_jax.encoding import thresholds
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.label_store import write_tracks
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.engines.common import blocks
from sim_mjx.presets.sessions import CONTROL_PERIOD, STATES
from sim_mjx.randomization.trials import DomainRandomization, Fault
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis import records, shards

Simulate = Callable[[Any], Rollouts]  # a batch of trials of the preset's kind
Drawn = tuple[Any, list[Fault]]  # parameters of a shard's trials, and what is wrong with each
# Trials per shard, unless said otherwise: what a kill costs at most. A GPU needs many to be busy.
SHARD = {"native": 256, "mjx": 8192, "warp": 16384}
ROBOT = "hiro"  # whose thresholds label the trials
CREATED = "undated"  # a date would make every store different


@dataclass(frozen=True)
class SynthesisConfig:
    """What is to be simulated."""

    preset: str
    trials: int
    seed: int = 0
    engine: str = "native"
    shard: int = 256  # trials per shard: what a kill costs at most
    spec: DomainRandomization = field(default_factory=DomainRandomization)
    window: int | None = None  # samples per line of the labels; None = no labels


@dataclass(frozen=True)
class SynthesisProgress:
    """How far a synthesis is."""

    done: int  # trials, with those of earlier runs
    total: int  # trials
    per_minute: float  # trials simulated per minute in this run, 0 before the first shard
    seconds_left: float | None  # None before the first shard


@dataclass(frozen=True)
class SynthesisReport:
    """What a synthesis came to."""

    stored: int  # trials
    seated: int  # of them with all four tabs
    diverged: list[int]  # indices of trials that are not stored
    resumed: int  # trials that an earlier run had done
    faults: dict[str, tuple[int, int]]  # kind -> stored trials, of them seated


def synthesise(
    target: Path,
    job: SynthesisConfig,
    *,
    overwrite: bool = False,
    simulate: Simulate | None = None,
    progress: Callable[[SynthesisProgress], None] | None = None,
) -> SynthesisReport:
    """Simulate a set of trials into a store; a run that was interrupted goes on where it stopped.

    Args:
        target: store to create, for example trials.zarr; the work folder is trials.zarr.work beside it.
        job: what to simulate.
        overwrite: replace an existing store, once the new one is complete.
        simulate: what simulates a batch; default the engine that ``job`` names. Must give a trial the same bytes in
            whatever batch.
        progress: called at the beginning and after each shard.

    Raises:
        InputError: impossible options, the target is taken, the work folder belongs to other options, or no
            trial is left to store.
    """
    check(job)
    folder = shards.folder_of(target)
    manifest = _manifest(job)
    finished = folder.is_dir() and _is_result(target, manifest)
    store.check_target(target, overwrite or finished)
    with shards.working(folder, manifest):
        resumed = job.trials
        if not finished:
            drawn = _simulate_missing(folder, job, simulate, progress)
            resumed -= sum(len(faults) for _, faults in drawn.values())
            _assemble(folder, target, job, manifest, drawn)
        shards.remove(folder)
    return _report(target, job, resumed)


def check(job: SynthesisConfig) -> None:
    """Refuse what cannot be simulated.

    Raises:
        InputError: unknown preset or engine, a count below one, a bad seed or distribution.
    """
    for name, value in (("number of trials", job.trials), ("shard's number of trials", job.shard)):
        if value < 1:
            raise InputError(f"The {name} is {value}; expected 1 or more.")
    engines.check(job.engine)
    if job.window is not None:
        _encoder(job)
    get_scenario(job.preset).draw(job.preset, job.seed, 0, job.spec)


def engine(name: str, preset: str) -> Simulate:
    """A preset's scene in an engine, one of ``engines.ENGINES``."""
    return partial(engines.simulate, get_scenario(preset).scene(), engine=name)


def _encoder(job: SynthesisConfig) -> EncoderConfig:
    return EncoderConfig(window=job.window or 0, dt=CONTROL_PERIOD)


def _manifest(job: SynthesisConfig) -> dict[str, Any]:
    """Everything that determines a shard, as JSON values."""
    versions = {"rcbht_jax": rcbht_jax.__version__, "jax": jax.__version__, "mujoco": mujoco.__version__}
    return {"job": asdict(job), "versions": {**versions, "numpy": np.__version__, "sim_mjx_sha256": code_hash()}}


@cache  # a file that is edited while a run goes on is not the code that runs
def code_hash() -> str:
    """Of this package's sources: shards made by different code must not be mixed."""
    root = Path(__file__).parents[1]
    return files_hash(root, sorted(root.rglob("*.py")))


def _provenance(manifest: dict[str, Any]) -> dict[str, Any]:
    """What of the manifest determines the content: not the size of the shards."""
    job = {name: value for name, value in manifest["job"].items() if name != "shard"}
    return {"job": job, "versions": manifest["versions"]}


def _is_result(target: Path, manifest: dict[str, Any]) -> bool:
    """Whether the target was put in place by a run with these options that was killed before it could tidy up."""
    if not target.exists():
        return False
    try:
        found = store.read_attrs(target).get("simulated")
    except InputError:
        return False
    wanted = _provenance(manifest)
    return found is not None and shards.as_json(found) == shards.as_json(wanted)


def _indices(job: SynthesisConfig, shard: int) -> range:
    return range(shard * job.shard, min((shard + 1) * job.shard, job.trials))


def _simulate_missing(
    folder: Path, job: SynthesisConfig, simulate: Simulate | None, progress: Callable[[SynthesisProgress], None] | None
) -> dict[int, Drawn]:
    """Simulate the shards that are not there; returns what was drawn for them, by number."""
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
        drawn[shard] = _draw(job, indices)
        shards.save(folder, shard, _shard_of(job, drawn[shard][0], simulate))
        done += len(indices)
        if progress is not None:
            rate = (done - resumed) / (time.perf_counter() - start)
            progress(SynthesisProgress(done, job.trials, 60.0 * rate, (job.trials - done) / rate))
    return drawn


def _draw(job: SynthesisConfig, indices: range) -> Drawn:
    return get_scenario(job.preset).draw_batch(job.preset, job.seed, indices, job.spec)


def _shard_of(job: SynthesisConfig, params: Any, simulate: Simulate | None) -> shards.Arrays:
    """Simulate a batch and label it, if that is wanted."""
    if job.window is None:
        return records.of_trials((simulate or engine(job.engine, job.preset))(params))
    limits = np.asarray(thresholds.preset(ROBOT).limits)
    if simulate is None:
        scene = get_scenario(job.preset).scene()
        out, tracks = records.simulate_labelled(scene, params, job.engine, _encoder(job), limits)
    else:
        out = simulate(params)
        tracks = records.label(out, _encoder(job), limits)
    return records.of_trials(out) | records.of_labels(tracks, len(out.length))


def _assemble(
    folder: Path, target: Path, job: SynthesisConfig, manifest: dict[str, Any], drawn: dict[int, Drawn]
) -> None:
    """Turn the shards into the store and put it in its place; what was ``drawn`` in this run is not drawn again."""
    loaded = [shards.load(folder, shard) for shard in range(-(-job.trials // job.shard))]
    parts = [part for part in loaded if part is not None]
    if len(parts) < len(loaded):
        raise InputError(f"A shard in {folder} was damaged just now; run the same command again.")
    diverged = np.concatenate([part["diverged"] for part in parts])
    kept = np.flatnonzero(~diverged)
    if len(kept) == 0:
        raise InputError(f"The physics diverged in all {job.trials} trials; nothing to store. Check the distributions.")
    batches = [drawn.get(shard) or _draw(job, _indices(job, shard)) for shard in range(len(parts))]
    params = jax.tree.map(lambda *leaves: np.concatenate(leaves)[kept], *(params for params, _ in batches))
    every = [fault for _, faults in batches for fault in faults]
    faults = [every[index] for index in kept]
    plain = [name for name in parts[0] if name != "wrench" and "." not in name]
    rows = {name: np.concatenate([part[name] for part in parts])[kept] for name in plain}
    recordings = _recordings(job, rows, _wrench(parts, kept, rows["length"]), kept, faults)
    attrs = {"simulated": _provenance(manifest), "diverged": np.flatnonzero(diverged).tolist()}
    draft = folder / "store.zarr"
    store.write_recordings(
        draft, recordings, attrs, overwrite=True, created=CREATED,
        simulation=_simulation(job, rows, kept, params, faults),
    )  # fmt: skip
    if job.window is not None:
        _write_labels(draft, job, parts, kept)
    if target.exists():
        target.rename(folder / f"replaced-{time.time_ns()}.zarr")
    draft.rename(target)


def _write_labels(draft: Path, job: SynthesisConfig, parts: list[shards.Arrays], kept: NDArray[np.int64]) -> None:
    """Add the labels of the kept trials to the store, under the name and with the attributes of ``rcbht encode``."""

    def joined(name: str) -> NDArray[Any]:
        shapes = [part[name].shape for part in parts]
        out = np.zeros((len(kept), *shapes[0][1:-1], max(shape[-1] for shape in shapes)), parts[0][name].dtype)
        row = 0
        for rows, part in _kept_of(parts, kept):
            out[row : row + len(rows), ..., : part[name].shape[-1]] = part[name][rows]
            row += len(rows)
        return out.reshape(-1, 6, out.shape[-1])

    layers = {
        layer: LabelTrack(**{name: joined(f"{layer}.{name}") for name in records.LABEL_FIELDS}) for layer in LAYERS
    }
    config = _encoder(job)
    limits = np.asarray(thresholds.preset(ROBOT).limits)
    how = {"semantics": "online", "window": config.window, "config": asdict(config), "thresholds": limits.tolist()}
    write_tracks(draft, f"online-W{config.window}", LabelTracks(*layers.values()), how, created=CREATED)


def _report(target: Path, job: SynthesisConfig, resumed: int) -> SynthesisReport:
    """What the finished store holds."""
    arms = len(get_scenario(job.preset).arms)
    simulation = {name: rows[::arms] for name, rows in store.read_simulation(target).items()}
    seated, kinds = np.asarray(simulation["seated"].all(1)), simulation["fault"]
    faults = {str(k): (int((kinds == k).sum()), int(seated[kinds == k].sum())) for k in np.unique(kinds)}
    return SynthesisReport(len(seated), int(seated.sum()), store.read_attrs(target)["diverged"], resumed, faults)


def _wrench(parts: list[shards.Arrays], kept: NDArray[np.int64], length: NDArray[np.int32]) -> NDArray[np.float32]:
    """All kept trials [trial, time, 6K], padded to the longest of them."""
    out = np.zeros((len(kept), int(length.max()), parts[0]["wrench"].shape[2]), np.float32)
    row = 0
    for rows, part in _kept_of(parts, kept):
        samples = min(out.shape[1], part["wrench"].shape[1])
        for block in blocks(len(rows)):
            out[row + block.start : row + block.stop, :samples] = part["wrench"][rows[block], :samples]
        row += len(rows)
    return out


def _kept_of(parts: list[shards.Arrays], kept: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], shards.Arrays]]:
    """Each shard with the rows of its trials that are kept."""
    start = 0
    for part in parts:
        stop = start + len(part["diverged"])
        yield kept[(kept >= start) & (kept < stop)] - start, part
        start = stop


def _recordings(
    job: SynthesisConfig,
    rows: shards.Arrays,
    wrench: NDArray[np.float32],
    index: NDArray[np.int64],
    faults: list[Fault],
) -> Recordings:
    arms = get_scenario(job.preset).arms
    count, samples = wrench.shape[:2]

    def each(values: Any) -> NDArray[Any]:
        return np.repeat(np.asarray(values), len(arms), axis=0)

    return Recordings(
        wrench=wrench.reshape(count, samples, len(arms), 6).swapaxes(1, 2).reshape(-1, samples, 6),
        length=each(rows["length"]),
        dt=CONTROL_PERIOD,
        onset=each(rows["onset"]),
        onset_harmonised=each(rows["onset_harmonised"]),
        trial=each([f"sim-{job.preset}-{i:06d}" for i in index]),
        arm=np.tile(np.array(arms), count),
        source=np.full(count * len(arms), f"SIM_MJX_{job.preset}"),
        session=np.full(count * len(arms), f"sim-{job.preset}"),
        outcome=each(np.where(rows["seated"].all(1), "success", "failure")),
        failure_type=each(np.array([fault.failure_type for fault in faults], np.str_)),
        deviation=each(np.stack([fault.deviation for fault in faults])),
        note=each(rows["note"]),
    )


def _simulation(
    job: SynthesisConfig, rows: shards.Arrays, index: NDArray[np.int64], params: Any, faults: list[Fault]
) -> shards.Arrays:
    """The arrays of the group ``simulation/``."""
    last = np.array(STATES)[np.isfinite(rows["onset"]).sum(1) - 1]
    of_kind = get_scenario(job.preset)
    drawn = {
        f"{group}_{name}" if group == "hold" else name: getattr(getattr(params, group) if group else params, name)
        for group, name in of_kind.parameters
    }
    trials = {
        "index": index,
        "fault": np.array([fault.kind for fault in faults], np.str_),
        "failed_in": np.where(rows["seated"].all(1), "", last),
        "seated": rows["seated"],
        "command_delay": params.command_delay,
        "noise_key": params.seed,
        **drawn,
    }
    return {name: np.repeat(np.asarray(values), len(of_kind.arms), axis=0) for name, values in trials.items()}
