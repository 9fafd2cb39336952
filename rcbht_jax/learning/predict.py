"""A trained model applied to label tracks: the class of every sentence, and the accuracy where classes are known.

The classifier gives no probabilities: its decision values, one per pair of classes, show how clear each choice was.
For probabilities during a stream, see :mod:`rcbht_jax.introspection`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.arms import BOTH, title_of
from rcbht_jax._util.digest import among
from rcbht_jax._util.printable import reasons_of
from rcbht_jax._util.signals import check_axes
from rcbht_jax._util.untrusted import checked_fields
from rcbht_jax._util.values import expect
from rcbht_jax.encoding.rules import AnyLimits, checked_limits, config_fields, encoder_of
from rcbht_jax.errors import InputError
from rcbht_jax.learning.model_io import TrainedModel
from rcbht_jax.learning.svm import pairs, vote
from rcbht_jax.learning.tasks import (
    UNKNOWN,
    TaskSpec,
    TrackBatches,
    UnlabelledIntervals,
    extract_features,
    unlabelled_intervals,
)
from rcbht_jax.learning.wrench_facts import WrenchFacts
from rcbht_jax.types import LabelTracks, Recordings

MADE_BY = ("semantics", "config", "thresholds")  # what must be the same of two label tracks
_CHOICES = ("gate", "adj_exempt", "contact_first", "pipe", "latency_cap")  # of an encoder, and options of rcbht encode


@dataclass(frozen=True)
class Classification:
    """The predictions of a model for every sentence."""

    classes: tuple[str, ...]  # of the model
    items: UnlabelledIntervals
    predicted: NDArray[np.str_]  # [item]
    decision: NDArray[np.float64]  # [item, pair] > 0 votes for the first of the pair
    seen: NDArray[np.bool_]  # [item] the model was trained on this very recording, or an exact copy

    @property
    def pairs(self) -> list[str]:
        """Names of the decision values, "first/second"."""
        return [f"{self.classes[i]}/{self.classes[j]}" for i, j in zip(*pairs(len(self.classes)), strict=True)]

    @property
    def known(self) -> NDArray[np.bool_]:
        """Items whose class the data set names, and the model knows ``[item]``."""
        return np.isin(self.items.name, self.classes)

    @property
    def not_learned(self) -> dict[str, int]:
        """Classes of the data set that the model does not know, and how many items they have; none counts as known."""
        strange = self.items.name[~self.known & (self.items.name != "")].tolist()
        return dict(sorted(Counter(strange).items()))

    def accuracy(self, seen: bool = False) -> float | None:
        """Share right of the known sentences that were not trained on (or those that were); None without any."""
        those = self.known & (self.seen == seen)
        return float((self.predicted == self.items.name)[those].mean()) if those.any() else None


def encoders_of(model: TrainedModel) -> dict[str, Mapping[str, Any]]:
    """Name of each label track that a model reads -> how its labels were made."""
    names = model.svm.spec.features.split("+")
    return {names[0]: model.encoder} if len(names) == 1 else {name: model.encoder.get(name, {}) for name in names}


def task_of(
    model: TrainedModel, sources: tuple[str, ...] = (), sessions: tuple[str, ...] = (), outcomes: tuple[str, ...] = ()
) -> TaskSpec:
    """The task that a model was trained for, on other data sets and sessions (empty = all).

    Outcomes are those of the training and unknown ones, unless others are named.

    Raises:
        InputError: the model does not state its task.
    """
    try:
        known = checked_fields(TaskSpec, {k: v for k, v in model.task.items() if k in TaskSpec.__dataclass_fields__})
        trained = known["outcomes"]
        old = known["arms"] == "R" and not model.axes  # version 0.1 names R, whatever the arm is called
        arms = "" if old else known["arms"]
        spec = TaskSpec(known["task"], known["boundaries"], arms, seconds=known.get("seconds", 0.0))
    except (KeyError, TypeError) as error:
        raise InputError(f"the model does not state its task: {error} is missing.") from error
    kept = outcomes or (trained and (*trained, UNKNOWN))
    return replace(spec, sources=sources, sessions=sessions, outcomes=kept)


def check_recordings(model: TrainedModel, recordings: Recordings, where: str) -> None:
    """Refuse recordings of another rate, other axes or units than those that a model was trained on.

    A model of offline labels has no rate, and an older one states no axes.

    Args:
        model: trained.
        recordings: to be classified, or encoded for that; no samples are needed.
        where: name of the recordings, which begins the error.

    Raises:
        InputError: names the first difference.
    """
    for made in encoders_of(model).values():
        config = made.get("config")
        dt = config.get("dt") if isinstance(config, dict) else None
        if isinstance(dt, float) and dt > 0 and dt != recordings.dt:
            rate = f"{1 / dt:.9g}"
            raise InputError(
                f"{where} has {1 / recordings.dt:.9g} samples per second, the model {rate}; import again with "
                f"--rate {rate}."
            )
    if model.axes:
        check_axes(recordings.axes, recordings.units, model.axes, model.units, where)


def check_encoders(model: TrainedModel, made: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse labels that were made in another way than those the model was trained on.

    Args:
        model: trained.
        made: how the labels were made, by the names that the model gives them.

    Raises:
        InputError: names the first difference.
    """
    for name, wanted in encoders_of(model).items():
        for key in MADE_BY:
            if key in wanted and made[name].get(key) != wanted[key]:
                what = _difference(wanted[key], made[name].get(key)) or key
                options = _options(wanted) + (f" --name {name}-model" if "+" in model.svm.spec.features else "")
                where = ", where MODEL is the model's file" if "MODEL" in options else ""
                raise InputError(
                    f"the model was trained on labels {name or 'of its own'} made otherwise ({what}); "
                    f'make such labels with "rcbht encode{options}" first{where}, and name them with --tracks.'
                )


def limits_in(
    model: TrainedModel, window: int, recordings: Recordings, where: str, name: str = ""
) -> tuple[AnyLimits, dict[str, Any]]:
    """The limits of the labels that a model reads, and where they came from.

    Args:
        model: trained on labels of the online encoder.
        window: of these labels, where the model reads several.
        recordings: that shall be encoded.
        where: name of the recordings, which begins the error.
        name: of the labels to be made; where the model reads several, it begins with the name of those that are meant.

    Raises:
        InputError: it reads no labels of this window, several that differ in their limits and ``name`` begins with the
            name of none, or the recordings have another rate, other axes or units.
    """
    check_recordings(model, recordings, where)
    found: dict[str, tuple[AnyLimits, dict[str, Any]]] = {}
    different = set()
    for track, made in encoders_of(model).items():
        try:
            config, limits = encoder_of(made)
        except (InputError, KeyError, TypeError, ValueError):  # of the offline program
            continue
        if config.window != window:
            continue
        rows = np.asarray(checked_limits(config, limits))
        if len(rows) != (axes := len(recordings.axes)):
            raise InputError(f"the model has limits for {len(rows)} axes; the recordings have {axes}.")
        found[track] = limits, dict(made.get("thresholds_from", {}))
        different.add((rows.shape, rows.tobytes()))
    if not found:
        raise InputError(f"the model reads no online labels of window {window}.")
    meant = [track for track in found if name.startswith(track)]
    if not meant and len(different) > 1:
        raise InputError(
            f"the model reads labels {', '.join(found)} of window {window}, whose limits differ; let --name begin with "
            "the name of those to be made."
        )
    return found[max(meant or found, key=len)]


def _options(made: Mapping[str, Any]) -> str:
    """Options of ``rcbht encode`` that no store has by itself: choices of the encoder, and the limits of the model."""
    try:
        config = encoder_of(made)[0]
    except (InputError, KeyError, TypeError, ValueError):  # of the offline program, or a damaged file
        return _offline_options(made)
    values, usual = config_fields(config), config_fields(type(config)())
    words = [] if values["rule"] == "paper" else [f"--rule {values['rule']}"]
    words.append(f"--window {config.window}")
    if tolerance := made["config"].get("tolerance"):
        words.append(f"--tolerance {' '.join(map(repr, tolerance))}")
    for name in _CHOICES:
        value, option = values.get(name), name.replace("_", "-")
        if value is not None and value != usual[name]:
            words.append(f"--{'' if value else 'no-'}{option}" if isinstance(value, bool) else f"--{option} {value}")
    return "".join(f" {word}" for word in [*words, "--thresholds MODEL"])


def _offline_options(made: Mapping[str, Any]) -> str:
    """Options of ``rcbht encode`` for labels of the offline program; none where the file does not state them."""
    config = made.get("config")
    if made.get("semantics") != "offline" or not isinstance(config, dict):
        return ""
    chosen = "".join(f" --{name} {config[name]}" for name in ("robot", "version") if name in config)
    return f" --mode offline{chosen}{' --clean' if config.get('clean') else ''}"


def _difference(wanted: Any, items: Any) -> str:
    """The first option that differs, in words."""
    if not (isinstance(wanted, dict) and isinstance(items, dict)):
        return ""
    key = next(key for key in {**wanted, **items} if wanted.get(key) != items.get(key))
    return f"{key} {wanted.get(key)}, here {items.get(key)}"


def classify(
    model: TrainedModel,
    recordings: Recordings,
    tracks: Mapping[str, LabelTracks] | TrackBatches,
    spec: TaskSpec,
    facts: WrenchFacts | None = None,
) -> Classification:
    """Classify every sentence of a data set with a trained model.

    Args:
        model: made by :func:`rcbht_jax.learning.fitting.train`.
        recordings: the data set.
        tracks: its labels by the names that the model gives them, arrays ``[recording, axis, slot]``, or batches of
            them; see :func:`check_encoders`.
        spec: made by :func:`task_of`.
        facts: facts about the wrenches, if the recordings have no samples.

    Raises:
        InputError: an argument of another class, recordings of another rate, other axes or units, no sentence that
            passes the filters, or labels that give other features than the model reads.

    Example:
        >>> import rcbht_jax as rj
        >>> recordings = rj.Recordings.example()  # four failures, four successes
        >>> tracks = rj.encode(recordings.wrench, rate=200)
        >>> model = rj.train(recordings, tracks, rj.TaskSpec("outcome"), rj.FeatureSpec(("histogram",)))
        >>> classify(model, recordings, {"": tracks}, task_of(model)).predicted[[0, -1]].tolist()
        ['failure', 'success']
    """
    expect("The model", model, TrainedModel)
    check_recordings(model, recordings, "The data set")
    items = unlabelled_intervals(recordings, spec, whole=model.task.get("whole") is True)
    if not len(items.row):
        why = (
            ", ".join(f"{what}: {reason}" for what, reason in reasons_of(items.dropped))
            or "no trial passes the filters"
        )
        raise InputError(f"there is no sentence to classify ({why}).")
    features = extract_features(tracks, items, model.feature_spec, len(recordings))
    if features.names != model.feature_names:
        arms = " and the ".join(title_of(part.arm) or "one without a name" for part in items.intervals)
        # Names begin with that of an arm; those of an older version may differ otherwise.
        given, learned = ({name.partition(".")[0] for name in one} for one in (features.names, model.feature_names))
        other = spec.arms == BOTH and given != learned
        why = f"it learned other arms than the {arms}" if other else "train it anew"
        raise InputError(
            f"the labels give {len(features.names)} features and the model of version {model.version} reads "
            f"{len(model.feature_names)} others; {why}."
        )
    decision = model.svm.decision(features.values)
    if not np.isfinite(decision).all():
        raise InputError(
            "the model's decision values are not finite on these recordings; values of the recordings or of the model "
            "are too large."
        )
    predicted = np.array(model.svm.classes)[vote(decision, len(model.svm.classes))]
    seen = _seen(model, recordings, facts or WrenchFacts.of(recordings))[items.row]
    return Classification(model.svm.classes, items, predicted, decision, seen)


def _seen(model: TrainedModel, recordings: Recordings, facts: WrenchFacts) -> NDArray[np.bool_]:
    """Recordings that the model was trained on ``[recording]``, as far as its file states."""
    if len(model.digests):
        return among(facts.digests, model.digests)
    seen = np.full(len(recordings), facts.data_hash == model.data_hash)  # an older model
    for values, kept in ((recordings.source, "sources"), (recordings.session, "sessions")):
        if model.task.get(kept):
            seen &= np.isin(values, model.task[kept])
    return seen
