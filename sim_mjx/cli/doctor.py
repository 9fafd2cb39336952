"""``rcbht doctor``."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from rcbht_jax._util.printable import plural
from rcbht_jax.cli.command import STORE, Command, Flag, option, progress_bar, unset
from rcbht_jax.errors import InputError

TRIALS, SAMPLES, WINDOW = 100, 2000, 5  # of the measurement, as "rcbht bench" makes it
USUAL = 0.084  # speed of the encoder in plain line fits on a CPU: the newest record of benchmarks/history.json
SLOW = 0.5  # of the usual ratio


@dataclass(frozen=True)
class Doctor(Command):
    """Check this machine: versions, devices, folder of compiled programs, disk, and speed in a few seconds.

    With a store: check every checksum, whether everything that its simulation made is there, and whether the installed
    versions are those that made it. The exit status is 2 if the store is damaged or not finished.

    Example: rcbht doctor

    Example: rcbht doctor trials.zarr --repair
    """

    store: Annotated[Path | None, tyro.conf.Positional, unset(metavar="[STORE.zarr]"), STORE] = None
    """Store to check, instead of the machine."""
    repair: Annotated[
        Flag,
        option(
            "Encode damaged label tracks again from the stored wrenches; if more is damaged, simulate the store again "
            'from its seed, if the installed versions are those that made it: label tracks of "rcbht encode" are lost '
            "then, and the result lists them."
        ),
    ] = False

    def check_inputs(self) -> None:
        """Refuse a store that its simulation has not finished as such, not as one that is missing."""
        from sim_mjx.synthesis.status import check_finished

        if self.store is not None:
            check_finished(self.store)
        super().check_inputs()

    def run(self) -> dict[str, Any]:
        from rcbht_jax.cli.bench import batch_encoder, signal
        from sim_mjx.validation import health

        if self.store is not None:
            return self._store(self.store)
        if self.repair:
            raise InputError("--repair needs a store: rcbht doctor STORE --repair.")
        found = health.machine(Path.cwd())
        print("measuring for a few seconds", file=sys.stderr, flush=True)
        encoder, ratio = batch_encoder(signal(TRIALS, SAMPLES), WINDOW)
        speed = {
            "encoder_samples_per_second": encoder[f"encode/W={WINDOW}"][0],
            "encoder_ratio": ratio,
            "native_steps_per_second": health.native_speed(),
        }
        return {**found, "benchmark": speed, "problems": health.problems(found) + _slow(found["devices"], ratio)}

    def _store(self, path: Path) -> dict[str, Any]:
        from sim_mjx.validation import health

        found = health.check_store(path)
        encoded, lost = list[str](), list[str]()
        repaired = self.repair and bool(found.damage)
        if repaired and found.tracks:
            encoded = _encode_again(path, found.tracks)
        elif repaired:
            lost = _simulate_again(path)
        if repaired:
            found = health.check_store(path)
        facts = {**asdict(found), "tracks": list(found.tracks)}
        return {"store": str(path), **facts, "repaired": repaired, "encoded_tracks": encoded, "lost_tracks": lost}

    def exit_status(self, result: dict[str, Any]) -> int:
        return 2 if result.get("damage") else 0

    def text(self, result: dict[str, Any]) -> str:
        return _store_text(result) if self.store is not None else _machine_text(result)


def _encode_again(path: Path, tracks: dict[str, dict[str, Any]]) -> list[str]:
    """Make damaged label tracks again; their names."""
    from rcbht_jax.io.store import read_lengths
    from sim_mjx.validation.label_repair import encode_again

    with progress_bar("encode", "samples", len(tracks) * int(read_lengths(path).sum()), unit_scale=True) as bar:
        for name, how in tracks.items():
            encode_again(path, name, how, bar.update)
    return list(tracks)


def _simulate_again(path: Path) -> list[str]:
    """Make a store again; the names of the label tracks that are lost."""
    from sim_mjx.cli.simulate import show
    from sim_mjx.synthesis.pipeline import synthesise
    from sim_mjx.validation import health

    job = health.repair_job(path)
    lost = health.other_tracks(path, job)
    with progress_bar("simulate", "trials", job.trials) as bar:
        synthesise(path, job, overwrite=True, progress=partial(show, bar))
    return lost


def _slow(devices: list[str], ratio: float) -> list[str]:
    """A sentence, if the encoder on a CPU is slower than its usual ratio to plain line fits allows."""
    if not devices[0].lower().startswith("cpu") or ratio > SLOW * USUAL:
        return []
    return [
        f"The encoder reaches {ratio:.2g} of the speed of plain line fits; {USUAL:.2g} is usual. Compare with other "
        'versions of jax by "rcbht bench".'
    ]


def _machine_text(result: dict[str, Any]) -> str:
    versions = ", ".join(f"{name} {number or 'not installed'}" for name, number in result["versions"].items())
    cache, speed = result["compile_cache"], result["benchmark"]
    usual = f", usually {USUAL:.2g}" if result["devices"][0].lower().startswith("cpu") else ""
    lines = [
        f"Python {result['python']}; {versions}",
        f"devices: {', '.join(result['devices'])}; {plural(result['cores'], 'core')}",
        f"compiled programs: {plural(cache['files'], 'file')}, {cache['bytes'] / 2**20:.0f} MB in {cache['folder']}",
        f"disk: {result['free_disk_bytes'] / 2**30:.0f} GB free here",
        f"encoder: {speed['encoder_samples_per_second'] / 1e6:.1f} M samples/s, {speed['encoder_ratio']:.2g} of the "
        f"speed of plain line fits{usual}",
        f"native physics: {speed['native_steps_per_second'] / 1e6:.3f} M steps/s",
        *result["problems"],
    ]
    return "\n".join([*lines, *([] if result["problems"] else ["no problem found"])])


def _store_text(result: dict[str, Any]) -> str:
    lines = [f"{result['store']}: {plural(result['recordings'], 'recording')}"]
    lines += [f"damaged: {sentence}" for sentence in result["damage"]] or [
        "every checksum is right, nothing is missing"
    ]
    if result["encoded_tracks"]:
        lines.append(f"label tracks were damaged and have been encoded again: {', '.join(result['encoded_tracks'])}")
    elif result["repaired"]:
        lines.append("it was damaged and has been simulated again")
        if result["lost_tracks"]:
            tracks = ", ".join(result["lost_tracks"])
            lines.append(
                f'label tracks that its simulation did not make are gone: {tracks}; make them with "rcbht encode"'
            )
    elif result["tracks"]:
        lines.append(f'"rcbht doctor {result["store"]} --repair" encodes the labels again from the stored wrenches')
    elif result["damage"] and result["repairable"]:
        lines.append(f'"rcbht doctor {result["store"]} --repair" makes it again from its seed')
    return "\n".join([*lines, *result["notes"]])
