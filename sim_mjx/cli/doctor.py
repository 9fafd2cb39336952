"""``rcbht doctor``."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from rcbht_jax._util.optional import MissingPackage
from rcbht_jax._util.printable import plural
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, Flag, option, progress_bar, unset
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

    store: Annotated[Path | None, tyro.conf.Positional, unset(metavar="[STORE.zarr]"), common.STORE] = None
    """Store to check, instead of the machine."""
    repair: Annotated[
        Flag,
        option(
            "Encode damaged label tracks again from the stored wrenches, if they say how they were made. If the "
            "recordings or their simulation are damaged, simulate them again from their seed, if the installed "
            "versions are those that made them. All other label tracks are kept as they are."
        ),
    ] = False

    def check_inputs(self) -> None:
        """Refuse a store that its simulation has not finished as such, not as one that is missing."""
        try:
            from sim_mjx.synthesis.status import check_finished
        except MissingPackage as error:
            if self.store is None:
                raise
            raise InputError(
                f'{error} Without it, "rcbht info {self.store} --check" compares all checksums but those of label '
                "tracks; whether a simulation is complete and what can be repaired stay unknown."
            ) from error

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
        from rcbht_jax.io.label_store import collect
        from sim_mjx.validation import health

        found = health.check_store(path)
        encoded, again = list[str](), self.repair and not found.intact
        if again:
            _simulate_again(path)
            found = health.check_store(path)
        collected = found.uncollected if self.repair else []
        if collected:
            collect(path)
        if self.repair and found.tracks:
            encoded = _encode_again(path, found.tracks)
        if collected or encoded:
            found = health.check_store(path)
        facts = {**asdict(found), "tracks": list(found.tracks)}
        repaired = again or bool(encoded or collected)
        done = {"repaired": repaired, "simulated_again": again, "encoded_tracks": encoded, "collected": collected}
        return {"store": str(path), **facts, **done}

    def exit_status(self, result: dict[str, Any]) -> int:
        return 2 if result.get("damage") else 0

    def text(self, result: dict[str, Any]) -> str:
        return _store_text(result) if self.store is not None else _machine_text(result)


def _encode_again(path: Path, tracks: dict[str, dict[str, Any]]) -> list[str]:
    """Make damaged label tracks again; their names.

    Raises:
        InputError: some come out otherwise, and are left as they are; the others have been made.
    """
    from rcbht_jax.io.store import read_lengths
    from sim_mjx.validation.health import encode_again

    refused = list[str]()
    with progress_bar("encode", "samples", len(tracks) * int(read_lengths(path).sum()), unit_scale=True) as bar:
        for name, how in tracks.items():
            try:
                encode_again(path, name, how, bar.update)
            except InputError as error:
                refused.append(str(error))
    if refused:
        raise InputError(" ".join(refused))
    return list(tracks)


def _simulate_again(path: Path) -> None:
    """Make the recordings of a store and their simulation again; its label tracks are kept."""
    from sim_mjx.cli.simulate import show
    from sim_mjx.synthesis.pipeline import synthesise
    from sim_mjx.validation import health

    job = health.repair_job(path)
    with progress_bar("simulate", "trials", job.trials) as bar:
        synthesise(path, job, overwrite=True, progress=partial(show, bar), ready=partial(health.keep_tracks, path))


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
    repair, offers = f'"rcbht doctor {result["store"]} --repair"', list[str]()
    if not result["intact"] and result["repairable"]:
        offers.append("simulates it again from its seed, and keeps the label tracks")
    elif result["intact"] and result["tracks"]:
        offers.append(f"encodes the labels again from the stored wrenches: {', '.join(result['tracks'])}")
    if result["uncollected"]:
        offers.append(f"collects the metadata of {', '.join(result['uncollected'])}")
    lines = [f"{result['store']}: {plural(result['recordings'], 'recording')}"]
    lines += [f"damaged: {sentence}" for sentence in result["damage"]]
    if not result["damage"]:
        lines.append("every checksum is right, nothing is missing")
    if result["simulated_again"]:
        lines.append("it was damaged and has been simulated again")
    if result["encoded_tracks"]:
        lines.append(f"label tracks were damaged and have been encoded again: {', '.join(result['encoded_tracks'])}")
    if result["collected"]:
        lines.append(f"metadata of label tracks were not collected and now are: {', '.join(result['collected'])}")
    lines += [f"{repair} {what}" for what in offers]
    if result["unknown"]:
        lines.append(f"label tracks that cannot be made again as they were: {', '.join(result['unknown'])}")
    return "\n".join([*lines, *result["notes"]])
