"""The frozen method: the one that every headline is scored with, in a file that holds its own digest.

``experiments/frozen_method.json`` has the encoders, the families of features, the grid of hyper-parameters and the rule
for ties. Its SHA-256 is that of the canonical content (keys sorted, no spaces, UTF-8), so that a result can name the
method that made it. How it was chosen: ``experiments.classification.frozen_choice``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rcbht_jax._util.untrusted import load_json
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.errors import InputError
from rcbht_jax.features import ABSOLUTE, FeatureSpec
from rcbht_jax.learning.evaluation import candidates
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals
from rcbht_jax.learning.validation import Estimator, nested_svm
from rcbht_jax.types import LabelTracks, Recordings

FILE = Path(__file__).resolve().parents[1] / "frozen_method.json"
TIMED = ("duration", "elapsed")  # families that know how long something took

Grammars = dict[str, dict[str, LabelTracks]]


@dataclass(frozen=True)
class FrozenMethod:
    """Encoders, features and grid; inner folds choose one grammar and one set of families, ties go to the earlier."""

    content: Mapping[str, Any]  # as in the file

    @property
    def sha256(self) -> str:
        """Digest of the canonical content, in hexadecimal."""
        return digest(self.content)

    @property
    def grid(self) -> Grid:
        """Hyper-parameters that nested selection may choose from."""
        return _grid(self.content["grid"])

    @property
    def specs(self) -> dict[str, FeatureSpec]:
        """Features by name, those first to which ties go."""
        balance = self.content["balance"]
        return {one["name"]: FeatureSpec(tuple(one["families"]), balance=balance) for one in self.content["features"]}

    @property
    def relative(self) -> dict[str, FeatureSpec]:
        """The same without families that an offset or a duration changes; what becomes equal is left once."""
        left: dict[str, FeatureSpec] = {}
        for name, spec in self.specs.items():
            narrower = relative_of(spec)
            if narrower not in left.values():
                left[name] = narrower
        return left

    @property
    def streamed(self) -> Mapping[str, Any]:
        """What a stream has in place of nested selection: one encoder, and two heads."""
        return self.content["streamed"]

    def stream_encoder(self, dt: float) -> tuple[EncoderConfig, GradientThresholds]:
        """Encoder and thresholds of a stream with samples ``dt`` seconds apart."""
        name = self.streamed["encoder"]
        return self.config(name, dt), self.thresholds(name)

    def stream_spec(self, head: str, relative: bool = False) -> FeatureSpec:
        """Features of the head "state" (of a sub-task) or "phase" (of the trial so far)."""
        one = self.streamed[head]
        spec = FeatureSpec(tuple(one["families"]), balance=one["balance"])
        return relative_of(spec) if relative else spec

    def stream_learning(self, head: str) -> tuple[Grid, int]:
        """Grid of a head, and the snapshots that a complete interval counts for."""
        one = self.streamed[head]
        return _grid(one["grid"]), one["ends"]

    def thresholds(self, encoder: str) -> GradientThresholds:
        """Gradient limits ``[axis, 4]`` of an encoder, N/s and Nm/s."""
        scale = self.content["encoders"][encoder]["scale"]
        return GradientThresholds(np.asarray(preset(self.content["thresholds"]).limits) * scale)

    def config(self, encoder: str, dt: float) -> EncoderConfig:
        """An encoder for samples ``dt`` seconds apart."""
        return EncoderConfig(window=self.content["encoders"][encoder]["window"], dt=dt)

    def description(self) -> dict[str, Any]:
        """Arguments of ``StateClassifier``, which has one encoder: the first one, with the first families.

        Example:
            >>> import rcbht_jax as rj
            >>> rj.StateClassifier(rate=200, **load().description()).window
            5
        """
        first = self.content["grammars"][0]["encoders"][0]
        window = self.content["encoders"][first]["window"]
        return {"window": window, "thresholds": self.thresholds(first), "features": next(iter(self.specs.values()))}

    def grammars(self, recordings: Recordings) -> Grammars:
        """Labels of all recordings by grammar and encoder, as ``rcbht_jax.evaluate`` takes them."""
        labels = {
            name: encode_batch(
                self.config(name, recordings.dt), self.thresholds(name), recordings.wrench, recordings.length
            )
            for name in self.content["encoders"]
        }
        return {one["name"]: {name: labels[name] for name in one["encoders"]} for one in self.content["grammars"]}

    def learner(self, grammars: Grammars, items: LabelledIntervals, relative: bool = False) -> Estimator:
        """The method, or its ``relative`` features, on the rows of ``items``; all is selected on the training rows."""
        described = candidates(grammars, items, self.relative if relative else self.specs)
        matrices = {name: features.values for name, (features, _) in described.items()}
        weights = {name: weight for name, (_, weight) in described.items()}
        return nested_svm(matrices, items.y, items.trial, self.grid, weights)


def _grid(fields: Mapping[str, Any]) -> Grid:
    return Grid(**{key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()})


def relative_of(spec: FeatureSpec) -> FeatureSpec:
    """Without families that an offset or a duration changes."""
    return replace(spec, families=tuple(family for family in spec.families if family not in (*ABSOLUTE, *TIMED)))


def digest(content: Mapping[str, Any]) -> str:
    """SHA-256 of a JSON value in canonical form: keys sorted, no spaces, UTF-8.

    >>> digest({"b": 1, "a": [2]}) == digest({"a": [2], "b": 1})
    True
    """
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def load(path: Path = FILE) -> FrozenMethod:
    """The method of a file.

    Raises:
        InputError: there is no such file, it is not JSON, or its digest is not that of its content.
    """
    try:
        record = load_json(path)
        method = FrozenMethod(record["method"])
        right = record["sha256"] == method.sha256
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is no frozen method: {error}.") from error
    if not right:
        raise InputError(f"{path} was changed: its content has the digest {method.sha256}, not the one it names.")
    return method
