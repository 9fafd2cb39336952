"""``rcbht encode``."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.cli import common
from rcbht_jax.cli.command import Flag, MadeBy, option, progress_bar, unset
from rcbht_jax.cli.rules import RuleCommand, checked_tolerance
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.encoding.rules import AnyConfig, AnyLimits
    from rcbht_jax.types import LabelTracks, Recordings


USUAL_SPAN = 0.025  # s, of the paper's windows: 5 samples at 200 Hz
_ONLINE = ("thresholds", "window", "scale", "gate", "adj_exempt", "contact_first", "pipe", "rule", "latency_cap")
RESTLESS = 1 / 3  # of the time at rest, beyond which the thresholds do not fit


@dataclass(frozen=True)
class Encode(RuleCommand):
    """Encode every recording of a store as labels and add the label tracks to the store.

    The online mode is the streaming encoder of this library, as the paper defines it. The offline mode is the authors'
    published program, which sees the whole trial. A store may be larger than memory: thresholds or tolerances that are
    found from the recordings (--robot auto, --rule fit) then come from recordings spread evenly over the store.

    Example: rcbht encode hiro.zarr --mode online --window 5
    """

    store: common.Store
    """Store to label."""
    mode: Literal["online", "offline"] = "online"
    """Streaming encoder, or the authors' offline program."""
    scale: float = 1.0
    """Factor on all thresholds; below 1, smaller gradients get labels of their own (online)."""
    gate: Flag = True
    """Combine any two primitives; by default amplitudes must agree within a factor of 2, durations of 5 (online)."""
    adj_exempt: Flag = True
    """Merge repeated adjustments; by default they stay separate, which distinguishes AL from SH (online)."""
    contact_first: Flag = False
    """Allow an impulse as the first of a pair, never as the second of a pair that another primitive begins (online)."""
    pipe: Literal["two-slot", "one-slot"] = "two-slot"
    """Filter of each layer; one-slot compares a new label only with the accumulated one (online)."""
    robot: Annotated[
        common.RobotName | None,
        option(
            "Robot whose preset gives the gradient thresholds; auto = from rest and contacts in what is encoded, which "
            "only the online encoder can.",
            "hiro for recordings of HIRO and simulated ones, and offline; else auto",
        ),
    ] = field(default=None, kw_only=True)
    thresholds: Annotated[
        Path | None,
        option(
            'File of "rcbht calibrate" to use instead of the preset: gradient thresholds and, if it was made for '
            '--rule fit, tolerances; or a model of "rcbht train", for the limits of the labels that it reads; of '
            "several, those of the name with which --name begins.",
            "",
            metavar="FILE",
        ),
        MadeBy('"rcbht calibrate STORE.zarr -o {path}"'),
    ] = field(default=None, kw_only=True)
    rule: Annotated[
        Literal["paper", "similar", "fit"],
        option(
            "Rule of durations and amplitudes for merging: paper, or similar, that of the authors' older program; "
            "or fit, where a word is a run of windows that one straight line explains (online)."
        ),
    ] = field(default="paper", kw_only=True)  # type: ignore[assignment]  # one more
    latency_cap: Annotated[
        float | None,
        option(
            "Time in s for which a label may be held back (online); it leaves up to two windows later, with --rule fit "
            "up to four. Default: none, with --rule fit 0.2. Other rules limit primitives only: compositions and "
            "behaviours also wait for the next word of the layer below.",
            "",
        ),
    ] = None
    version: Literal["master", "a642c8b", "a1ca1d1", "wip"] = "master"
    """Revision of the authors' program (offline)."""
    clean: Flag = False
    """Correct the known errors of the authors' program (offline)."""
    name: Annotated[str | None, unset()] = None
    """Name of the label tracks; default: composed of the options, such as online-W5 or offline-master."""

    def run(self) -> dict[str, Any]:
        from rcbht_jax.io.label_parts import joined
        from rcbht_jax.io.label_store import list_tracks, write_batches
        from rcbht_jax.io.zarr import check_writable

        check_writable(self.store)
        name = self.name or self._default_name()
        other, theirs = ("offline", ("version", "clean")) if self.mode == "online" else ("online", _ONLINE)
        self.refuse(theirs, f"is for --mode {other}; leave it out, or use that mode.")
        checked_tolerance(self.rule, self.tolerance)
        if not 0 < self.scale < float("inf"):
            raise InputError(f"--scale is {self.scale}; expected a positive number.")
        if name in list_tracks(self.store):
            raise InputError(f"{self.store} has label tracks {name} already; choose another --name.")
        run = self._online() if self.mode == "online" else self._offline()
        write_batches(self.store, name, run.tracks(self.store), run.how)
        restless, hidden = {}, []
        if run.training is not None:
            labels = joined(run.of_training)
            restless = _restless(run.training, labels, self.window, self.rule)
            hidden = _hidden(run.training, labels, self.window)
        facts = {
            "labels": run.counts,
            "samples": run.samples,
            "seconds": run.seconds,
            "rest_not_constant": restless,
            "changes_all_constant": hidden,
        }
        return {"store": str(self.store), "name": name, **facts, **run.how}

    def made_now(self) -> tuple[str, LabelTracks, dict[str, Any]]:
        """Name, labels and attributes of the online words of a store; nothing is written."""
        from rcbht_jax.io.label_parts import joined

        run = self._online()
        return self._default_name(), joined(list(run.tracks(self.store))), run.how

    def text(self, result: dict[str, Any]) -> str:
        counts = ", ".join(f"{count} {layer}" for layer, count in result["labels"].items())
        speed = result["samples"] / result["seconds"]
        text = (
            f"{result['name']}: {counts} labels in {result['seconds']:.1f} s with compilation ({speed:,.0f} samples/s)"
        )
        if restless := [axis for axis, share in result["rest_not_constant"].items() if share > RESTLESS]:
            learned = self.thresholds is None and result["thresholds_from"]["method"] == "auto"
            text += (
                f"\nMore than a third of the time at rest is not labelled constant on {', '.join(restless)}: the "
                f"thresholds do not fit these recordings{'' if learned else '; try --robot auto'}."
            )
        if hidden := result["changes_all_constant"]:
            dt = result["config"]["dt"]
            longer = max(4 * self.window, round(USUAL_SPAN / dt))
            other = "" if self.rule == "fit" else ", or the fit rule, whose lines are longer (--rule fit)"
            text += (
                f"\nIn most recordings, everything on {', '.join(hidden)} is labelled constant, although the values "
                f"change: within a window of {self.window} samples ({1e3 * self.window * dt:.3g} ms), noise may be "
                f"steeper than they are; try a longer one (--window {longer}, {1e3 * longer * dt:.3g} ms){other}."
            )
        return text

    def _default_name(self) -> str:
        if self.mode == "offline":
            version = "" if self.clean and self.version == Encode.version else f"-{self.version}"
            return f"offline{'-clean' * self.clean}{version}"
        options = {"ungated": not self.gate, "merged-a": not self.adj_exempt, "contact-first": self.contact_first}
        words = [word for word, used in options.items() if used]
        words += [word for word in (self.pipe, self.rule) if word not in ("two-slot", "paper")]
        words += [f"tol{value:g}" for value in self.tolerance]
        words += [] if self.latency_cap is None else [f"cap{self.latency_cap:g}"]
        words += [] if self.robot in (None, "hiro") else [self.robot]
        words += [] if self.thresholds is None else [self.thresholds.stem]
        words += [] if self.scale == 1 else [f"x{self.scale:g}"]
        name = "-".join([f"online-W{self.window}", *words])
        return re.sub(r"[^A-Za-z0-9._-]+", "-", name.replace("e+", "e"))  # 2e+06 is not to become 2e-06

    def _online(self) -> _Run:
        from rcbht_jax.encoding.batch import encode_batch
        from rcbht_jax.encoding.rules import made_by
        from rcbht_jax.io.store import read_lengths, read_sample

        training, rows = read_sample(self.store)
        thresholds, source = self.read_limits(training, self.store, self.scale)
        config = self.config(training.dt)
        limits = self.limits(config, thresholds, training)
        how = {"semantics": "online", "window": self.window, **made_by(config, limits), "thresholds_from": source}
        total = int(read_lengths(self.store).sum())
        bar = progress_bar("encode", "samples", total, unit_scale=True)

        def encode(batch: Recordings) -> LabelTracks:
            return encode_batch(config, limits, batch.wrench, batch.length, progress=bar.update)

        return _Run(encode, how, bar, training, rows)

    def limits_in_file(self, file: Path, recordings: Recordings, store: Path) -> tuple[AnyLimits, dict[str, Any]]:
        from rcbht_jax.learning.model_io import load
        from rcbht_jax.learning.predict import limits_in

        if is_zipfile(file):
            return limits_in(load(file), self.window, recordings, str(store), self.name or "")
        return super().limits_in_file(file, recordings, store)

    def config(self, dt: float) -> AnyConfig:
        from rcbht_jax.encoding.encoder import EncoderConfig
        from rcbht_jax.encoding.fit import FitConfig

        pairs = (self.gate, self.adj_exempt, self.contact_first)
        if self.rule != "fit":
            return EncoderConfig(self.window, dt, *pairs, self.pipe, self.rule, self.latency_cap)
        if self.pipe != "two-slot":
            raise InputError("--pipe is for the paper's rule; --rule fit has no filter. Leave it out.")
        cap = FitConfig.latency_cap if self.latency_cap is None else self.latency_cap
        return FitConfig(self.window, dt, *pairs, cap)

    def _offline(self) -> _Run:
        from rcbht_jax.io.store import count_recordings
        from rcbht_jax.reference.dataset import encode_dataset

        bar = progress_bar("encode", "trials", count_recordings(self.store))

        def counted(indices: Iterable[int]) -> Iterator[int]:
            for index in indices:
                yield index
                bar.update(1)

        choices: dict[str, Any] = {"robot": self.robot or "hiro", "version": self.version, "clean": self.clean}

        def encode(batch: Recordings) -> LabelTracks:
            return encode_dataset(batch, **choices, progress=counted)

        return _Run(encode, {"semantics": "offline", "config": choices}, bar)


@dataclass
class _Run:
    """Label tracks of a store, batch by batch; what is counted on the way."""

    encode: Callable[[Recordings], LabelTracks]
    how: dict[str, Any]
    bar: Any
    training: Recordings | None = None  # in which the share of rest that is constant is measured
    rows: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))  # their numbers
    samples: int = 0
    seconds: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    of_training: list[LabelTracks] = field(default_factory=list)  # the labels of these recordings

    def tracks(self, store: Path) -> Iterator[LabelTracks]:
        """Encode the batches of a store."""
        from rcbht_jax.io.label_parts import taken
        from rcbht_jax.io.store import read_batches
        from rcbht_jax.labels import LAYERS

        first = 0
        with self.bar:
            for batch in read_batches(store):
                start = time.perf_counter()
                tracks = self.encode(batch)
                self.seconds += time.perf_counter() - start
                self.samples += int(batch.length.sum()) * len(batch.axes)
                for layer in LAYERS:
                    used = int(np.count_nonzero(getattr(tracks, layer).label))
                    self.counts[layer] = self.counts.get(layer, 0) + used
                mine = self.rows[(self.rows >= first) & (self.rows < first + len(batch))] - first
                if len(mine):
                    self.of_training.append(taken(tracks, mine))
                first += len(batch)
                yield tracks


def _hidden(recordings: Recordings, tracks: LabelTracks, window: int) -> list[str]:
    """The axes that change, although all their labels are constant in most recordings."""
    from rcbht_jax.calibration.rest import hidden_changes

    hidden = hidden_changes(recordings, tracks.primitive, window)
    return [axis for axis, one in zip(recordings.axes, hidden.tolist(), strict=True) if one]


def _restless(recordings: Recordings, tracks: LabelTracks, window: int, rule: str) -> dict[str, float]:
    """By axis, the share of the time at rest that is not labelled constant; empty where rest cannot be seen."""
    from rcbht_jax.calibration.rest import rest_not_constant, rest_thresholds
    from rcbht_jax.labels import Primitive

    try:
        rest = rest_thresholds(recordings, window, rule).rest
    except InputError:
        return {}
    share = rest_not_constant(tracks.primitive, rest, window, Primitive.CONS)
    return dict(zip(recordings.axes, share.round(4).tolist(), strict=True))
