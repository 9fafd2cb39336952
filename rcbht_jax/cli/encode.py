"""``rcbht encode``."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from tqdm import tqdm  # type: ignore[import-untyped]

from rcbht_jax.cli.command import Command
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset, read_thresholds
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import list_tracks, write_tracks
from rcbht_jax.io.store import read_recordings
from rcbht_jax.labels import LAYERS
from rcbht_jax.reference.dataset import encode_dataset
from rcbht_jax.types import LabelTracks, Recordings


@dataclass(frozen=True)
class Encode(Command):
    """Label every recording of a store and keep the label tracks in it.

    Online is the streaming encoder of this library (paper semantics); offline is the authors' program.

    Example: rcbht encode hiro.zarr --mode online --window 5
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store to label."""
    mode: Literal["online", "offline"] = "online"
    """Streaming encoder, or the authors' offline taxonomy."""
    window: int = 5
    """Samples per straight-line fit (online)."""
    robot: Literal["hiro", "baxter", "pa10"] = "hiro"
    """Whose gradient thresholds to use."""
    thresholds: Path | None = None
    """Calibrated thresholds to use instead, a file of "rcbht calibrate" (online)."""
    scale: float = 1.0
    """Factor on all thresholds; small ones hear what happens before contact (online)."""
    gate: bool = True
    """Pair only primitives of similar size (online)."""
    adj_exempt: bool = True
    """Keep repeated adjustments apart (online)."""
    contact_first: bool = False
    """Impulses only lead pairs (online)."""
    pipe: Literal["two-slot", "one-slot"] = "two-slot"
    """Filter pipe (online)."""
    rule: Literal["paper", "similar"] = "paper"
    """Time-amplitude rule: the paper's, or the reference's older one (online)."""
    latency_cap: float | None = None
    """Publish a waiting label after at most this many seconds (online)."""
    version: Literal["master", "a642c8b", "a1ca1d1", "wip"] = "master"
    """Variant of the authors' program (offline)."""
    clean: bool = False
    """With our fixes of the authors' mistakes (offline)."""
    name: str | None = None
    """Name of the label tracks; default online-W5, offline-master, ... after the choices made."""

    def run(self) -> dict[str, Any]:
        name = self.name or self._default_name()
        if (self.thresholds is not None or self.scale != 1) and self.mode == "offline":
            raise InputError(
                "--thresholds and --scale are for the online encoder; leave them out, or use --mode online."
            )
        if not 0 < self.scale < float("inf"):
            raise InputError(f"--scale is {self.scale}; expected a positive number.")
        if name in list_tracks(self.store):
            raise InputError(f"{self.store} has label tracks {name} already; choose another --name.")
        recordings = read_recordings(self.store)
        start = time.perf_counter()
        tracks, how = self._online(recordings) if self.mode == "online" else self._offline(recordings)
        seconds = time.perf_counter() - start
        write_tracks(self.store, name, tracks, how)
        counts = {layer: int(np.count_nonzero(getattr(tracks, layer).label)) for layer in LAYERS}
        samples = int(recordings.length.sum()) * 6
        return {"store": str(self.store), "name": name, "labels": counts, "samples": samples, "seconds": seconds, **how}

    def text(self, result: dict[str, Any]) -> str:
        counts = ", ".join(f"{count} {layer}" for layer, count in result["labels"].items())
        speed = result["samples"] / result["seconds"] / 1e6
        return (
            f"{result['name']}: {counts} labels in {result['seconds']:.1f} s with compilation ({speed:.1f} M samples/s)"
        )

    def _default_name(self) -> str:
        if self.mode == "offline":
            return f"offline-{'clean' if self.clean else self.version}"
        options = {"ungated": not self.gate, "merged-a": not self.adj_exempt, "contact-first": self.contact_first}
        words = [word for word, used in options.items() if used]
        words += [word for word in (self.pipe, self.rule) if word not in ("two-slot", "paper")]
        words += [] if self.latency_cap is None else [f"cap{self.latency_cap:g}"]
        words += [] if self.robot == "hiro" else [self.robot]
        words += [] if self.thresholds is None else [self.thresholds.stem]
        words += [] if self.scale == 1 else [f"x{self.scale:g}"]
        return "-".join([f"online-W{self.window}", *words])

    def _online(self, recordings: Recordings) -> tuple[LabelTracks, dict[str, Any]]:
        config = EncoderConfig(
            self.window, recordings.dt, self.gate, self.adj_exempt, self.contact_first, self.pipe, self.rule,
            self.latency_cap,
        )  # fmt: skip
        thresholds, source = self._thresholds()
        total = int(recordings.length.sum())
        with tqdm(total=total, desc="encode", unit=" samples", unit_scale=True, file=sys.stderr, disable=None) as bar:
            tracks = encode_batch(
                config, thresholds, recordings.wrench, recordings.length, progress=lambda n: bar.update(n)
            )
        how = {"semantics": "online", "window": self.window, "config": asdict(config)}
        return tracks, {**how, "thresholds": thresholds.limits.tolist(), "thresholds_from": source}

    def _thresholds(self) -> tuple[GradientThresholds, dict[str, Any]]:
        if self.thresholds is None:
            chosen, source = preset(self.robot), {"method": "preset", "robot": self.robot}
        else:
            chosen, source = read_thresholds(self.thresholds)
        if self.scale == 1:
            return chosen, source
        return GradientThresholds(np.asarray(chosen.limits) * self.scale), {**source, "scale": self.scale}

    def _offline(self, recordings: Recordings) -> tuple[LabelTracks, dict[str, Any]]:
        def bar(indices: Iterable[int]) -> Iterable[int]:
            wrapped: Iterable[int] = tqdm(indices, desc="encode", unit=" trials", file=sys.stderr, disable=None)
            return wrapped

        tracks = encode_dataset(recordings, robot=self.robot, version=self.version, clean=self.clean, progress=bar)
        choices = {"robot": self.robot, "version": self.version, "clean": self.clean}
        return tracks, {"semantics": "offline", "config": choices}
