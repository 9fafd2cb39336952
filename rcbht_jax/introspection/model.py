"""Models for introspection: the encoder, its thresholds and one or more classifiers, in one file that runs no code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.signals import check_axes
from rcbht_jax._util.untrusted import checked_fields, checked_number, checked_texts
from rcbht_jax._util.url_path import as_path
from rcbht_jax.encoding.rules import (
    AnyConfig,
    AnyLimits,
    checked_limits,
    config_fields,
    config_from,
    gradients_of,
    limit_arrays,
    limits_from,
)
from rcbht_jax.encoding.thresholds import GradientThresholds, limits_of
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import check_online, names
from rcbht_jax.introspection.chain import FeatureView
from rcbht_jax.labels import AXES, UNIT_OF, UNITS
from rcbht_jax.learning.model_io import (
    NO_DIGESTS,
    check_finite,
    check_objects,
    read_digests,
    read_svm,
    reading,
    svm_members,
    write_archive,
)
from rcbht_jax.learning.probability import ProbabilisticSvm, SvmArrays, to_arrays
from rcbht_jax.learning.progress import ProgressArrays, ProgressCalibration, progress_arrays
from rcbht_jax.types import axis_names

FORMAT = "rcbht-introspection-1"

Scope = Literal["subtask", "trial"]
SCOPES: tuple[Scope, ...] = ("subtask", "trial")


@dataclass(frozen=True)
class Head:
    """The classifier of one question about the stream.

    Attributes:
        name: for example "states", "outcome" or "failure-type".
        scope: the interval it sees: since the sub-task began, or since the trial began.
        view: features of that interval.
        machine: gives a probability per class.
        alarm: the class that raises an anomaly; "" = none does.
        alarm_level: probability above which it does; 0 = the introspector's own level.
        progress: calibrates the probabilities by the time since the interval began; None = no such calibration.
        alarm_hold: s for which the probability must stay above ``alarm_level``.

    Raises:
        InputError: features that a stream cannot compute or that the classifier does not know, an unknown scope or
            class, or a level or time out of range.
    """

    name: str
    scope: Scope
    view: FeatureView
    machine: ProbabilisticSvm
    alarm: str = ""
    alarm_level: float = 0.0
    progress: ProgressCalibration | None = None
    alarm_hold: float = 0.1

    def __post_init__(self) -> None:
        check_online(self.view.spec)
        if self.scope not in SCOPES:
            raise InputError(f"head {self.name} has the scope {self.scope!r}; expected one of {', '.join(SCOPES)}.")
        if self.alarm and self.alarm not in self.classes:
            raise InputError(f"head {self.name} has no class {self.alarm}; it has {', '.join(self.classes)}.")
        if not 0 <= self.alarm_level < 1:
            raise InputError(f"head {self.name} has the alarm level {self.alarm_level:g}; expected 0 to 1.")
        if not 0 <= self.alarm_hold < float("inf"):
            raise InputError(f"head {self.name} holds its alarm for {self.alarm_hold:g} s; expected zero or more.")
        if self.progress is not None and len(self.progress.prior) != len(self.classes):
            raise InputError(
                f"head {self.name} has {len(self.classes)} classes; its calibration has {len(self.progress.prior)}."
            )

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the classes, in the order of the probabilities."""
        return self.machine.svm.classes

    def probability(
        self, x: Float[np.ndarray, "item feature"], seconds: Float[np.ndarray, " item"]
    ) -> Float[np.ndarray, "item class"]:
        """Calibrated class probabilities of features, ``seconds`` after the interval began."""
        p = self.machine.probability(x)
        return p if self.progress is None else self.progress(p, seconds)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HeadArrays:
    """A head in single precision, for a compiled stream."""

    machine: SvmArrays
    progress: ProgressArrays | None


def head_arrays(head: Head) -> HeadArrays:
    """A head for :func:`rcbht_jax.introspection.introspector.infer`."""
    return HeadArrays(to_arrays(head.machine), None if head.progress is None else progress_arrays(head.progress))


@dataclass(frozen=True)
class IntrospectionModel:
    """The encoder, its thresholds and the classifiers that turn a wrench into beliefs.

    Raises:
        InputError: thresholds of another shape or order, or classifiers without a name of their own.
    """

    encoder: AnyConfig  # its type chooses the rule
    limits: AnyLimits  # [axis, 4] gradient thresholds; of the fit rule FitLimits
    heads: tuple[Head, ...]
    data_hash: str  # of the training data
    version: str = rcbht_jax.__version__
    extra: dict[str, Any] = field(default_factory=dict)  # anything else worth keeping: JSON values
    digests: NDArray[np.uint8] = field(default_factory=lambda: NO_DIGESTS)  # [recording, byte] of the training set

    def __post_init__(self) -> None:
        limits = self.stacked_limits
        if limits.ndim != 2:
            raise InputError(f"thresholds have shape {(*limits.shape[:-1], 4)}; a stream expects [axis, 4].")
        if len(self.axes) != len(limits):
            raise InputError(f"a model has {len(self.axes)} names of axes and limits of {len(limits)}.")
        if not self.heads or len({head.name for head in self.heads}) < len(self.heads):
            found = ", ".join(head.name for head in self.heads) or "none"
            raise InputError(f"an introspection model has the heads {found}; expected one or more of different names.")
        for head in self.heads:
            count, trained = len(names(head.view.spec, len(limits))), head.machine.svm.center.size
            if trained != count:
                raise InputError(
                    f"head {head.name} was trained on {trained} features; its specification makes {count}."
                )

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(self.extra.get("axes") or axis_names(len(gradients_of(self.limits))))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the axes; "" = not stated."""
        return tuple(self.extra.get("units", [UNIT_OF.get(axis, "") for axis in self.axes]))

    @property
    def arm(self) -> str:
        """Whose wrench it learned; "" = the last by name, as the right one, or not known, as of older files."""
        return str(self.extra.get("arm", ""))

    @property
    def subtasks(self) -> str:
        """The task whose sub-tasks the classifiers see, the first if there are several; "" = whole trials alone."""
        return next((head.name for head in self.heads if head.scope == "subtask"), "")

    def check_axes(self, axes: Sequence[str], units: Sequence[str], where: str) -> None:
        """Check a signal's axes and units against the model's; see :func:`~rcbht_jax._util.signals.check_axes`."""
        check_axes(axes, units, self.axes, self.units, where)

    def check_wrench(self, where: str) -> None:
        """As :meth:`check_axes` for a wrench, Fx Fy Fz Mx My Mz in N and Nm; the model may name the axes otherwise."""
        named = len(self.axes) == len(AXES) and set(self.axes) != set(AXES)
        self.check_axes(self.axes if named else AXES, UNITS, where)

    @property
    def thresholds(self) -> GradientThresholds | FitLimits:
        """The limits as the encoder takes them."""
        return self.limits if isinstance(self.limits, FitLimits) else GradientThresholds(limits_of(self.limits))

    @property
    def stacked_limits(self) -> NDArray[np.floating]:
        """The limits ``[axis, number]`` as the functions of the rule take them."""
        return checked_limits(self.encoder, self.limits)


def save(path: Path | str, model: IntrospectionModel) -> None:
    """Write a model to ``path`` (a single file, any suffix), whole or not at all.

    Raises:
        InputError: the folder does not exist, or a description is not JSON.
    """
    arrays: dict[str, NDArray[Any]] = {**limit_arrays(model.limits), "digests": model.digests}
    heads = []
    for number, head in enumerate(model.heads):
        prefix = f"{number}."
        members, described = svm_members(head.machine.svm, prefix)
        arrays |= members | {prefix + "sigmoid": head.machine.sigmoid}
        plain = {name: getattr(head, name) for name in ("name", "scope", "alarm", "alarm_level", "alarm_hold")}
        progress = {} if head.progress is None else {"progress": asdict(head.progress)}
        heads.append({**plain, "view": asdict(head.view), **described, **progress})
    rest = {k: getattr(model, k) for k in ("data_hash", "version", "extra")}
    write_archive(path, {"format": FORMAT, "encoder": config_fields(model.encoder), "heads": heads, **rest}, arrays)


def load(path: Path | str) -> IntrospectionModel:
    """Read a file written by :func:`save`.

    Raises:
        InputError: the file is missing, damaged, or not a model of this format.
    """
    path = as_path(path)
    with reading(path, FORMAT) as (meta, archive):
        config = config_from(meta["encoder"])
        limits = limits_from(config, archive)
        axes = len(checked_limits(config, limits))
        heads = tuple(_read_head(head, archive, f"{n}.", axes) for n, head in enumerate(meta["heads"]))
        check_objects(meta, "extra")
        checked_texts("its digest, version and arm", [meta["data_hash"], meta["version"], meta["extra"].get("arm", "")])
        for name in ("axes", "units"):
            checked_texts(f"its {name}", meta["extra"].get(name, []))
        rest = {k: meta[k] for k in ("data_hash", "version", "extra")}
        return IntrospectionModel(config, limits, heads, **rest, digests=read_digests(archive))


def _read_head(meta: Mapping[str, Any], archive: Mapping[str, NDArray[Any]], prefix: str, axes: int) -> Head:
    seen = meta["view"] if "view" in meta else meta["sight"]  # as files before 0.2 call it
    spec = FeatureSpec.from_dict(seen["spec"])
    svm = read_svm(meta, archive, len(names(spec, axes)), prefix)
    sigmoid = archive[prefix + "sigmoid"]
    if sigmoid.shape != (svm.intercept.size, 2):
        raise InputError(f"sigmoid has the shape {sigmoid.shape}, not {(svm.intercept.size, 2)}")
    check_finite("sigmoid", sigmoid)
    view = FeatureView(spec, bool(seen["provisional"]))
    machine = ProbabilisticSvm(svm, sigmoid)
    name, alarm = checked_texts("a head's name and alarm", [meta["name"], meta["alarm"]])
    # Files older than alarm levels, their hold times and calibration by progress lack them.
    level, progress = checked_number("alarm_level", meta.get("alarm_level", 0.0)), meta.get("progress")
    calibration = progress and ProgressCalibration(**checked_fields(ProgressCalibration, progress))
    hold = checked_number("alarm_hold", meta.get("alarm_hold", 0.1))
    return Head(name, meta["scope"], view, machine, alarm, level, calibration, hold)
