"""Versions, devices and speed of a machine, and checks of stores: the library behind ``rcbht doctor``."""

from __future__ import annotations

import os
import platform
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

from rcbht_jax._util import compile_cache
from rcbht_jax._util.printable import plural
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.rules import encoder_of
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.label_store import (
    copy_tracks,
    list_tracks,
    own_attrs,
    replace_batches,
    uncollected_tracks,
    verify_tracks,
)
from rcbht_jax.io.store_schema import HASH, LABELS
from rcbht_jax.reference.dataset import encode_dataset
from rcbht_jax.types import LabelTracks, Recordings
from sim_mjx import engines
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis import shards
from sim_mjx.synthesis.draft import CREATED
from sim_mjx.synthesis.plan import SynthesisConfig, job_of, label_attrs, manifest_of, provenance
from sim_mjx.synthesis.status import check_finished

PACKAGES = ("rcbht-jax", "jax", "jaxlib", "numpy", "mujoco", "mujoco-mjx", "warp-lang", "zarr")
LITTLE_DISK = 2 * 2**30  # bytes
SECONDS = 1.0  # that a measurement takes at least, a first run besides
TRIALS = 64


@dataclass(frozen=True)
class StoreHealth:
    """What was found in a store."""

    recordings: int  # number of recordings, by its lengths
    damage: list[str]  # what is damaged or missing, in sentences
    notes: list[str]  # what is no damage, but good to know, in sentences
    repairable: bool  # the installed code makes the same trials from the seed
    tracks: dict[str, dict[str, Any]]  # how the damaged label tracks are made, of those whose attributes say so
    intact: bool  # the recordings and their simulation are not damaged
    unknown: list[str]  # damaged label tracks of which it is not known how they are made
    uncollected: list[str]  # label tracks that are whole, but that xarray misses


def machine(folder: Path) -> dict[str, Any]:
    """Versions, devices, folder of compiled programs and free disk, as JSON values.

    Args:
        folder: on the disk whose free space is measured.
    """
    cache = compile_cache.default_folder()
    files = [path for path in cache.rglob("*") if path.is_file()] if cache.is_dir() else []
    return {
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in PACKAGES},
        "cores": os.cpu_count(),
        "devices": [str(device) for device in jax.devices()],
        "compile_cache": {
            "folder": str(cache),
            "files": len(files),
            "bytes": sum(path.stat().st_size for path in files),
        },
        "free_disk_bytes": shutil.disk_usage(folder).free,
    }


def problems(found: dict[str, Any]) -> list[str]:
    """Problems that the result of :func:`machine` shows, in sentences."""
    versions, sentences = found["versions"], []
    if versions["mujoco"] != versions["mujoco-mjx"]:
        sentences.append(
            f"MuJoCo is {versions['mujoco']} and mujoco-mjx {versions['mujoco-mjx']}; the device engines need the same "
            'version of both: pip install "rcbht-jax[sim]".'
        )
    if shutil.which("nvidia-smi") and not any("cuda" in device.lower() for device in found["devices"]):
        sentences.append('There is an NVIDIA GPU that JAX does not use; pip install "rcbht-jax[cuda]".')
    if found["free_disk_bytes"] < LITTLE_DISK:
        sentences.append(f"Only {found['free_disk_bytes'] / 2**30:.1f} GB of disk are free.")
    return sentences


def native_speed() -> float:
    """Physics steps per second of the native engine on this machine, in about a second."""
    scenario = get_scenario("B")
    scene = scenario.scene()
    params, _ = scenario.draw_batch(0, range(TRIALS), scenario.spec(longest=0.25))
    engines.simulate(scene, params)  # which compiles
    periods, start = 0, time.perf_counter()
    while (seconds := time.perf_counter() - start) < SECONDS:
        periods += int(engines.simulate(scene, params).length.sum())
    return periods * scene.substeps / seconds


def check_store(path: Path) -> StoreHealth:
    """Read all of a store, part by part, and compare it with its checksums, and its provenance with the installed code.

    Raises:
        InputError: there is no store, or it is not finished, which is no damage.
    """
    check_finished(path)
    attrs = store.read_attrs(path)
    if not store.is_finished(path):
        store.verify(path)
    damage: list[InputError] = []
    notes: list[str] = []
    _read(partial(store.verify, path), damage)
    # damage of the lengths is already reported
    count = _read(partial(store.count_recordings, path), [] if damage else damage) or 0
    simulated = attrs.get("simulated")
    job, difference = (None, "") if simulated is None else _made_by(simulated)
    if job is not None and not damage:
        expected = (job.trials - len(attrs.get("diverged", []))) * len(get_scenario(job.preset).arms)
        if count != expected:
            damage.append(InputError(f"{path} has {plural(count, 'recording')}; its simulation made {expected}."))
    intact = not damage
    tracks = _damaged_tracks(path, job, not difference, damage)
    uncollected = [name for name in _read(partial(uncollected_tracks, path), []) or [] if name not in tracks]
    if uncollected:
        names = ", ".join(uncollected)
        damage.append(
            InputError(f"{path} lacks the metadata of {names} among those it has collected: xarray misses them.")
        )
    if (folder := shards.folder_of(path)).is_dir():
        notes.append(
            f"{folder} is of a simulation that goes on, or was interrupted."
            if shards.has_plan(folder)
            else f"{folder} is a leftover, not of a simulation that goes on or can be resumed; it may be deleted."
        )
    if difference:
        notes.append(difference)
    known = {name: how for name, how in tracks.items() if how is not None}
    unknown = [name for name in tracks if name not in known]
    repairable = job is not None and not difference
    mended = not unknown and (intact or repairable)  # by doctor, so that no reader's advice is needed
    sentences = [error.fault if mended else str(error) for error in damage]
    return StoreHealth(count, sentences, notes, repairable, known, intact, unknown, uncollected)


def _damaged_tracks(
    path: Path, job: SynthesisConfig | None, same: bool, damage: list[InputError]
) -> dict[str, dict[str, Any] | None]:
    """Label tracks that are damaged, or missing though the job makes them, and how they are made; None = not known.

    ``damage`` gets the error of each; ``same`` says whether the installed code makes what the job made.
    """
    found = dict[str, dict[str, Any] | None]()
    names = _read(partial(list_tracks, path), damage) or []
    for name in names:
        reasons = list[InputError]()
        _read(partial(verify_tracks, path, name), reasons)
        if reasons:
            found[name] = made_how(path, name)
            _add(reasons[0], damage)
    if job is not None and job.window is not None:
        own = f"online-W{job.window}"
        if own not in names:
            damage.append(InputError(f"{path} lacks its labels {own}."))
            found[own] = None
        if same and own in found and found[own] is None:
            found[own] = simulated_how(path, job)
    return found


def repair_job(path: Path) -> SynthesisConfig:
    """The job that simulates a store again, in shards of its parts' size.

    Raises:
        InputError: it was not simulated, or not by the installed versions.
    """
    attrs = store.read_attrs(path)
    simulated = attrs.get("simulated")
    if simulated is None:
        raise InputError(f"{path} was not simulated: it cannot be made again from a seed. Import or copy it again.")
    job, difference = _made_by(simulated)
    if job is None or difference:
        raise InputError(f"{path} cannot be made again: {difference}")
    rows = attrs.get("part_rows")  # recordings; stores of earlier versions have no parts
    return replace(job, shard=max(1, rows // len(get_scenario(job.preset).arms))) if isinstance(rows, int) else job


def made_how(path: Path, name: str) -> dict[str, Any] | None:
    """The attributes of damaged label tracks, if they say how to make them again and by which checksum to know them."""
    try:
        attrs = own_attrs(path, name)  # the checksum of labels of other recordings is of no use
        _encoder(attrs)
    except (InputError, KeyError, TypeError, ValueError):
        return None
    return attrs if {HASH, "rows", "part_rows", "created"} <= set(attrs) else None


def simulated_how(path: Path, job: SynthesisConfig) -> dict[str, Any] | None:
    """The attributes of the label tracks that a simulation makes, for a store that lacks them."""
    attrs = store.read_attrs(path)
    if not {"rows", "part_rows"} <= set(attrs):
        return None
    return {**label_attrs(job), "rows": attrs["rows"], "part_rows": attrs["part_rows"], "created": CREATED}


def encode_again(path: Path, name: str, attrs: dict[str, Any], progress: Callable[[int], object]) -> None:
    """Encode the recordings of a store again and put the labels in the place of damaged or missing ones.

    Args:
        path: of the store.
        name: of the label tracks.
        attrs: how they were made: of :func:`made_how` or :func:`simulated_how`.
        progress: called with the number of samples done since the last call.

    Raises:
        InputError: the installed versions make other labels than those whose checksum is kept.
    """
    encode = _encoder(attrs)

    def tracks() -> Iterator[LabelTracks]:
        for part in store.read_batches(path):
            yield encode(part)
            progress(int(part.length.sum()))

    replace_batches(path, name, tracks(), attrs)


def keep_tracks(path: Path, again: Path) -> None:
    """Copy the label tracks of a damaged store to its recordings that were simulated again.

    Damaged ones are copied too, unless the simulation has made them again.

    Args:
        path: of the damaged store.
        again: its recordings, simulated again.

    Raises:
        InputError: the recordings have come out otherwise, so that the label tracks would be lost.
    """
    names, made = list_tracks(path), list_tracks(again)
    if store.read_attrs(path)[HASH] == store.read_attrs(again)[HASH]:
        for name in names:
            if name not in made or _is_whole(path, name):
                copy_tracks(path, again, name)
    elif lost := [name for name in names if name not in made]:
        raise InputError(
            f"{path} is left as it is: its recordings come out otherwise when they are simulated again, and label "
            f"tracks {', '.join(lost)} would be lost; move these out of {path / LABELS} to have it made without them."
        )


def _is_whole(path: Path, name: str) -> bool:
    try:
        verify_tracks(path, name)
    except InputError:
        return False
    return True


def _encoder(attrs: dict[str, Any]) -> Callable[[Recordings], LabelTracks]:
    """What made labels of these attributes."""
    if attrs["semantics"] == "offline":
        return partial(encode_dataset, **attrs["config"])
    config, limits = encoder_of(attrs)
    return lambda part: encode_batch(config, limits, part.wrench, part.length)


def _made_by(simulated: dict[str, Any]) -> tuple[SynthesisConfig | None, str]:
    """The job of a store, and in a sentence how the installed code differs from its maker; "" = not at all."""
    try:
        job = job_of(simulated["job"])
        now = shards.as_json(provenance(manifest_of(job)))
    except InputError as error:
        return None, str(error)
    except (KeyError, TypeError, ValueError):
        return None, "Its options are not those of the installed version."
    made = simulated["versions"]
    differing = [
        f"another content of {shards.DIGESTS[name]} ({name})"
        if name in shards.DIGESTS
        else f"{name} {made.get(name)}, now {value}"
        for name, value in now["versions"].items()
        if made.get(name) != value
    ]
    if differing:
        return (
            job,
            f"It was made with other versions or code: {'; '.join(differing)}. Simulated again, its trials may differ.",
        )
    return (job, "") if now == simulated else (None, "Its options are not those of the installed version.")


def _read(part: Callable[[], Any], damage: list[InputError]) -> Any:
    """A part of a store; None if it is damaged, with the error added to ``damage``."""
    try:
        return part()
    except InputError as error:
        _add(error, damage)
        return None


def _add(error: InputError, damage: list[InputError]) -> None:
    if str(error) not in map(str, damage):  # several readers may meet the same
        damage.append(error)


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
